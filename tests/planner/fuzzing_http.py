"""A server that is sent hostile HTTP: other hosts and tokens, damaged requests, wrong values for its routes."""

from __future__ import annotations

import random
import subprocess
import sys
import tempfile
import weakref
from abc import abstractmethod
from pathlib import Path
from typing import ClassVar
from urllib.parse import quote, urlsplit

from tests.fuzz.border import Border, WrongValueError, peak_bytes
from tests.fuzz.mutations import ANYWHERE, mutate
from tests.planner.browser import environment
from tests.planner.raw import answered

MOST_GROWN_BYTES = 2**28
"""What the server's memory may grow by, pages and caches included."""

ANSWER_S = 120.0
"""An answer that takes longer is a hang, even on a machine that much else is asked of."""

START_S = 900.0
"""The same for a planner that starts on a machine that much is asked of: it loads and compiles at first use."""

INPUTS_PER_SERVER = 1500
"""Then another is started, as what it keeps has grown."""

NAMES = (
    *("plan.json", "readings.csv", "study", "study/ct", "notes.csv", "a.zip", "ct", "0", "1", "7", "-1", "case-1"),
    *("", ".", "..", "../..", "/etc/passwd", "a/../../b", "x" * 300, "a\\..\\b", "con", ".hidden.csv", "a b.csv"),
    *("\0", "\x1b[31m", "\u202egnp.csv", "\u2028", "%2e%2e", "a/" * 40 + "b", "9" * 5000, "1e3", "\u0664"),
)
"""Given for what a route asks for."""

Route = tuple[bytes, str, str]
"""Method, path with ``{}`` where a value stands, and the name of a query value or none."""


class ServerBorder(Border):
    """A server of its own on a folder of its own."""

    slowest_s = 120.0  # another server may have to be started
    routes: ClassVar[tuple[Route, ...]]

    def __init__(self) -> None:
        self._served = 0
        self.start()

    @abstractmethod
    def command(self, folder: Path) -> tuple[list[str], Path]:
        """Return the arguments of ``ronnaplan`` for a server on ``folder``, and where it is started."""

    def start(self) -> None:
        """Start a server."""
        temporary = tempfile.TemporaryDirectory()
        self.folder = Path(temporary.name)
        arguments, place = self.command(self.folder)
        self._log = self.folder / "errors.txt"
        command = [sys.executable, "-m", "ronnaplan", *arguments]
        with self._log.open("wb") as errors:
            process = subprocess.Popen(
                command, stdout=subprocess.PIPE, stderr=errors, env=environment(), cwd=place
            )
        self._process, self._end = process, weakref.finalize(self, _end, process, temporary)
        assert process.stdout is not None
        parts = urlsplit(process.stdout.readline().decode().strip())
        assert parts.hostname is not None, self._log.read_text(errors="replace")
        assert parts.port is not None
        self._address, self._token = (parts.hostname, parts.port), parts.query.partition("=")[2]
        self._served, self._first_bytes = 0, peak_bytes(self._process.pid)
        self._answer_s = START_S

    def renew(self) -> None:
        """Start another server where this one has ended or served enough."""
        if self._served == INPUTS_PER_SERVER or self._process.poll() is not None:
            self._end()
            self.start()
        self._served += 1

    def check(self) -> None:
        """Raise where the server ended, told of an error of its own or took memory."""
        assert self._process.poll() is None, f"the server ended with status {self._process.returncode}"
        told = self._log.read_text(errors="replace")
        assert "Traceback" not in told, told[-3000:]
        assert "\x1b" not in told, told[-3000:]
        grown = peak_bytes(self._process.pid) - self._first_bytes
        assert grown < MOST_GROWN_BYTES, f"the server's memory has grown by {grown >> 20} MiB"

    def peak_bytes(self) -> int:
        return max(super().peak_bytes(), peak_bytes(self._process.pid))

    def request(self, method: bytes = b"GET", body: bytes = b"", **changed: bytes) -> bytes:
        """Return a sound request, or one with parts changed."""
        host = f"{self._address[0]}:{self._address[1]}".encode()
        parts = {"path": b"/index.html", "token": self._token.encode(), "host": host, "more": b"", "query": b""}
        parts |= changed | {"method": method, "length": str(len(body)).encode()}
        return (
            b"%(method)s %(path)s?token=%(token)s%(query)s HTTP/1.1\r\nHost: %(host)s\r\nConnection: close\r\n"
            b"Content-Length: %(length)s\r\n%(more)s\r\n" % {name.encode(): value for name, value in parts.items()}
        ) + body

    def hostile_route(self, chance: random.Random) -> tuple[bytes, bool]:
        """Return a request to one of the routes with any value, and whether it may be served."""
        method, path, name = chance.choice(self.routes)
        value = quote(chance.choice(NAMES), safe="/" if chance.random() < 0.5 else "").encode()
        query = b"&%s=%s" % (name.encode(), value) if name else b""
        body = (
            b""
            if method == b"GET"
            else chance.choice((b"", b"x,y,z\n1,2,3\n", chance.randbytes(300), b"PK\x03\x04"))
        )
        method = method if chance.random() < 0.9 else chance.choice((b"GET", b"POST", b"PUT", b"DELETE", b"X"))
        made = self.request(method, body, path=path.encode().replace(b"{}", value), query=query)
        return made, True

    def hostile_http(self, chance: random.Random) -> tuple[bytes, bool]:
        """Return a request, and whether it may be served."""
        own = f"{self._address[0]}:{self._address[1]}".encode()
        hosts = (
            own,
            own,
            own,
            b"evil.example",
            b"127.0.0.1:99999999",
            b"[",
            b"a@127.0.0.1",
            b"\xff",
            b"",
            own + b"/",
        )
        origins = (b"", b"", b"", b"http://[", b"null", b"http://evil.example", b"\xff", b"http://" + own)
        tokens = (self._token.encode(),) * 4 + (b"", b"%ff", b"%00", b"x" * 5000, self._token.encode()[:-1])
        paths = (
            b"/index.html",
            b"/index.html",
            b"/ws",
            b"/%00",
            b"/../etc/passwd",
            b"/planner_page/%2e%2e/server.py",
        )
        host, origin, token, path = (chance.choice(each) for each in (hosts, origins, tokens, paths))
        more = b"Origin: %s\r\n" % origin if origin else b""
        if chance.random() < 0.2:
            more += b'Cookie: ronnaplan_%d=\xff\xfe; a="\r\n' % self._address[1]
        made = bytearray(self.request(path=path, token=token, host=host, more=more))
        sound = host == own and origin in (b"", b"http://" + own) and token == self._token.encode()
        if chance.random() < 0.4:
            mutate(made, ANYWHERE, chance)
            sound = self._token.encode() in made
        return bytes(made), sound

    def http(self, made: bytes, sound: bool) -> str:
        """Send a request: "read" where it is served, "refused" where not."""
        try:
            status = answered(self._address, made, self._answer_s if b"\r\n\r\n" in made else 0.2)
        except TimeoutError:
            if b"\r\n\r\n" in made:
                raise
            return "not complete"
        assert status < 500, f"status {status} for {made!r}"
        if status in (0, *range(400, 500)):
            return "refused"
        if not sound:
            raise WrongValueError(f"status {status} for {made!r}")
        return "read"


def _end(process: subprocess.Popen[bytes], temporary: tempfile.TemporaryDirectory[str]) -> None:
    process.kill()
    process.communicate()
    temporary.cleanup()
