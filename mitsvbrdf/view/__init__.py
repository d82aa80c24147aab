"""A live page of a fit: what its folder says now (:mod:`.watch`), served to this machine alone (:mod:`.server`)."""

from .server import ADDRESS, PORT, make_server
from .watch import Watch

__all__ = ["ADDRESS", "PORT", "Watch", "make_server"]
