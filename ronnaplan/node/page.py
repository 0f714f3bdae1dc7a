"""The operator's page: what was received, what is worked on, what waits and why; and figures for Prometheus.

On this machine only, and only for who has the token, which is in the node's log and in ``page.token`` of its folder.
"""

from __future__ import annotations

import hmac
import os
import secrets
import sys
import threading
from contextlib import suppress
from http.cookies import CookieError, SimpleCookie
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any, Final
from urllib.parse import parse_qs, urlsplit

from ronnaplan.errors import InputError
from ronnaplan.node.config import Config
from ronnaplan.node.index import Index
from ronnaplan.node.jobs import retry
from ronnaplan.node.logs import Log
from ronnaplan.node.tables import METRICS, STILL, metrics_text, status_page
from ronnaplan.text import whole_number

HOST: Final = "127.0.0.1"
NAMES: Final = frozenset({HOST, "localhost"})
COOKIE: Final = "ronnaplan_node"
TOKEN_FILE: Final = "page.token"
POLICY: Final = "default-src 'none'; style-src 'unsafe-inline'; form-action 'self'; frame-ancestors 'none'"
LONGEST_BODY: Final = 1000
"""Bytes that are read of what a page sends."""
SILENT_S: Final = 10.0
"""Who says nothing for so long is waited for no longer."""


class Page:
    """Serves the page from `start` to `stop`."""

    def __init__(self, config: Config, log: Log) -> None:
        self.token = secrets.token_urlsafe(24)
        port = config.page_port or 0
        try:
            self._server = _Server((HOST, port), _Handler)
        except OSError as error:
            raise InputError(
                f"cannot show the status page on {HOST}:{port} ({error.strerror}); choose another"
            ) from error
        self._server.token, self._server.folder, self._server.log = self.token, config.data, log
        _keep_secret(config.data / TOKEN_FILE, self.token)
        self._thread = threading.Thread(target=self._server.serve_forever, name="page", daemon=True)
        log.tell("status page", address=f"http://{HOST}:{self.port}/", token_in=TOKEN_FILE)

    @property
    def port(self) -> int:
        """Where it is."""
        return int(self._server.server_address[1])

    def start(self) -> None:
        """Serve in a thread."""
        self._thread.start()

    def stop(self) -> None:
        """Let go of the port."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    token: str
    folder: Path
    log: Log

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Tell of a request that could not be answered in one line; who closes the page meanwhile is no fault."""
        error = sys.exception()
        if not isinstance(error, ConnectionError):
            self.log.tell("page failed", reason=f"{type(error).__name__}: {error}")


class _Handler(BaseHTTPRequestHandler):
    server: _Server
    server_version, sys_version = "ronnaplan", ""
    timeout = SILENT_S

    def do_GET(self) -> None:
        """Show the page, or the figures."""
        path, asked = urlsplit(self.path).path, parse_qs(urlsplit(self.path).query, keep_blank_values=True)
        if not self._is_let_in():
            return
        with Index(self.server.folder) as index:
            if path == "/":
                self._answer(200, "text/html", status_page(index, still=STILL in asked))
            elif path == "/metrics":
                self._answer(200, METRICS, metrics_text(index, self.server.folder, self.server.log.counts))
            else:
                self._answer(404, "text/plain", "there is no such page")

    def do_POST(self) -> None:
        """Have a job done again."""
        length = whole_number(self.headers.get("Content-Length", "")) or 0
        body = self.rfile.read(min(max(length, 0), LONGEST_BODY)).decode("ascii", "replace")
        if not self._is_let_in():
            return
        job = whole_number(parse_qs(body).get("job", [""])[0])
        origin = self.headers.get("Origin")
        if urlsplit(self.path).path != "/retry" or job is None or origin != f"http://{self.headers.get('Host')}":
            self._answer(400, "text/plain", "only jobs can be retried, and from the page itself")
            return
        with Index(self.server.folder) as index:
            found = retry(index, job)
        self.server.log.tell("retry", job=job, done=found)
        self.send_response(303)
        self.send_header("Location", "/")
        self.send_header("Content-Length", "0")
        self.end_headers()

    def log_message(self, format: str, *arguments: Any) -> None:  # noqa: A002
        """Nothing: a request's path may hold the token."""

    def _is_let_in(self) -> bool:
        """Whether the request is for this host and shows the token: in its address, a cookie or as a bearer's."""
        host = ""
        with suppress(ValueError):  # brackets around no address
            host = urlsplit(f"//{self.headers.get('Host', '')}").hostname or ""
        if host not in NAMES or not hmac.compare_digest(self._shown().encode(), self.server.token.encode()):
            self._answer(403, "text/plain", f"open the page with ?token= and what the node's {TOKEN_FILE} holds")
            return False
        return True

    def _shown(self) -> str:
        given = parse_qs(urlsplit(self.path).query).get("token", [""])[0]
        bearer = self.headers.get("Authorization", "").removeprefix("Bearer ")
        try:
            cookie = SimpleCookie(self.headers.get("Cookie", "")).get(COOKIE)
        except CookieError:
            cookie = None
        return given or (cookie.value if cookie else "") or bearer

    def _answer(self, status: int, kind: str, text: str) -> None:
        content = text.encode()
        self.send_response(status)
        self.send_header("Content-Type", f"{kind}; charset=utf-8")
        self.send_header("Content-Length", str(len(content)))
        self.send_header("Content-Security-Policy", POLICY)
        self.send_header("Referrer-Policy", "no-referrer")
        self.send_header("Cache-Control", "no-store")
        if status == 200:
            self.send_header("Set-Cookie", f"{COOKIE}={self.server.token}; HttpOnly; SameSite=Strict; Path=/")
        self.end_headers()
        self.wfile.write(content)


def _keep_secret(path: Path, token: str) -> None:
    path.unlink(missing_ok=True)
    with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w") as stream:
        stream.write(f"{token}\n")
