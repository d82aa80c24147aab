"""A fit while it runs, in a browser of this machine.

``watch`` reads the folder that a fit writes to and says what is there; ``server`` answers with that as JSON and pictures; the
page ``live.html`` asks every second and draws it. Nothing flows back to the fit.
"""

from .server import ADDRESS, PORT, make_server
from .watch import Watch

__all__ = ["ADDRESS", "PORT", "Watch", "make_server"]
