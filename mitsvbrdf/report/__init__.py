"""TODO doc of mitsvbrdf/report/__init__.py."""
