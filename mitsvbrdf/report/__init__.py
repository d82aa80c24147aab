"""The page of a fit: what it says, its pictures and live viewer; live/ shows a fit while it runs."""
