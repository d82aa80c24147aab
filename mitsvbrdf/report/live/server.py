"""The HTTP server of live pages: this machine alone, the addresses of one :class:`Site`, nothing to write
to.
"""

from __future__ import annotations

import hashlib
import os
import sys
from dataclasses import dataclass
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, Protocol

from ...errors import ConfigError

ADDRESS = "127.0.0.1"
PORT = 8350  # the same each time, so that an open tab or a forwarded port finds the next server too
# what this machine is called; forwarding a port may change its number
HOST_NAMES = ("127.0.0.1", "localhost", "[::1]")
LIVE_POLICY = "default-src 'none'; img-src 'self' data:; style-src 'unsafe-inline'; connect-src 'self'; frame-src 'self'; " \
       "script-src 'nonce-{nonce}'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
# A report is one file: whatever it holds, it asks nobody for anything.
REPORT_POLICY = "default-src 'none'; script-src 'unsafe-inline' blob:; style-src 'unsafe-inline'; img-src data: blob:; " \
          "media-src data: blob:; font-src data:; connect-src data: blob:; worker-src blob:; base-uri 'none'; " \
          "form-action 'none'; frame-ancestors 'self'"


HTML = "text/html; charset=utf-8"


@dataclass(frozen=True)
class Answer:
    """What is sent for an address.

    Args:
        content: of the answer.
        kind: its media type.
        policy: a content security policy; pages have one.
        again: whether it is asked for again and again, and sent only where it has changed.
    """

    content: bytes
    kind: str
    policy: str = ""
    again: bool = False

    @property
    def headers(self) -> dict[str, str]:
        """The headers that it has of its own."""
        headers = {"Content-Security-Policy": self.policy} if self.policy else {}
        return headers | ({"ETag": f'"{hashlib.sha256(self.content).hexdigest()[:32]}"'} if self.again
                          else {})


class Site(Protocol):
    """What a server shows."""

    def answer(self, path: str) -> Answer | None:
        """The answer to an address, without its query; None where there is none. No part of it may be used as
        a path.
        """
        ...


class Server(ThreadingHTTPServer):
    """Serves one :class:`Site`; made by :func:`make_server`."""

    daemon_threads = True
    allow_reuse_address = os.name != "nt"  # where Windows would let two servers share a port

    def __init__(self, site: Site, port: int) -> None:
        self.site = site
        super().__init__((ADDRESS, port), Handler)

    @property
    def url(self) -> str:
        """Where a browser finds it."""
        return f"http://{ADDRESS}:{self.server_address[1]}/"

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A browser that hangs up, or falls asleep over an answer, is no error."""
        if not isinstance(sys.exception(), (ConnectionError, TimeoutError)):
            super().handle_error(request, client_address)


def make_server(site: Site, port: int | None = None) -> Server:
    """A server that listens already; ``serve_forever`` answers, ``server_close`` ends it.

    Args:
        site: what to serve.
        port: left out, :data:`PORT`, or a free one where that is taken; 0: a free one.

    Raises:
        ConfigError: a port that is taken, not allowed or none.
    """
    if port is not None and not 0 <= port < 65536:
        raise ConfigError("--port from 0 to 65535", str(port), "leave it out")
    try:
        return Server(site, PORT if port is None else port)
    except OSError as reason:
        if port is None:
            return Server(site, 0)
        raise ConfigError(f"port {port} to be free", reason.strerror or str(reason),
                          "leave --port out, or name another one") from None


class Handler(BaseHTTPRequestHandler):
    """Answers GET and HEAD for the addresses of the server's site."""

    server: Server
    server_version, sys_version = "mitsvbrdf", ""
    timeout = 60  # seconds for a request to arrive; each has a connection of its own

    def do_GET(self) -> None:  # the name that http.server looks for
        """Answer a request that was meant for this machine."""
        if self.named_here():
            found = self.server.site.answer(self.path.partition("?")[0])
            if found is None:
                return self.reply(404, b"not here\n", "text/plain", {})
            headers = found.headers
            same = "ETag" in headers and self.headers.get("If-None-Match") == headers["ETag"]
            self.reply(304 if same else 200, b"" if same else found.content, found.kind, headers)

    do_HEAD = do_GET

    def refuse(self) -> None:
        """Say that only GET is known."""
        if self.named_here():
            self.reply(405, b"only GET\n", "text/plain", {"Allow": "GET, HEAD"})

    do_POST = do_PUT = do_DELETE = do_PATCH = do_OPTIONS = refuse

    def named_here(self) -> bool:
        """Whether the request was meant for this machine: a foreign name that leads here is an attack (DNS
        rebinding).
        """
        hosts = self.headers.get_all("Host", [])
        name = hosts[0].lower() if len(hosts) == 1 else ""
        if name in HOST_NAMES or name.rpartition(":")[0] in HOST_NAMES:
            return True
        self.reply(403, b"served as 127.0.0.1 and localhost only\n", "text/plain", {})
        return False

    def reply(self, status: int, content: bytes, kind: str, headers: dict[str, str]) -> None:
        """Send an answer with the headers that all have."""
        self.send_response(status)
        for name, value in {"Content-Type": kind, "Content-Length": str(len(content)),
                            "Cache-Control": "no-store",
                            "X-Content-Type-Options": "nosniff", "Referrer-Policy": "no-referrer",
                            "Cross-Origin-Resource-Policy": "same-origin", **headers}.items():
            if status != 304 or name not in ("Content-Type", "Content-Length"):
                self.send_header(name, value)
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(content)

    def log_message(self, format: str, *args: object) -> None:
        """Quiet: the terminal is for what the user should know."""
