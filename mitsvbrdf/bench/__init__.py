"""Error against run time: every method on known materials and real captures."""
