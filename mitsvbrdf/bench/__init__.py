"""Error against run time, of renderers, methods and captures."""
