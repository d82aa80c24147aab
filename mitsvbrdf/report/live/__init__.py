"""A fit while it runs."""

from .server import ADDRESS, PORT, make_server
from .watch import Watch

__all__ = ["ADDRESS", "PORT", "Watch", "make_server"]
