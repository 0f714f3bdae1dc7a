"""A running planner that is sent hostile HTTP, web-socket frames, chunks, requests and actions: it goes on serving."""

from __future__ import annotations

import random
import subprocess
import sys
import tempfile
import weakref
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import msgpack

from ronnaplan.documents.plan import read_plan
from tests import cases
from tests.fuzz.border import Border, WrongValueError, peak_bytes
from tests.fuzz.mutations import ANYWHERE, mutate
from tests.planner.browser import environment
from tests.planner.pages import frame, request
from tests.planner.raw import RawSocket, answered, framed

MOST_GROWN_BYTES = 2**28
"""What the planner's memory may grow by, pages and caches included."""

ANSWER_S = 120.0
"""An answer that takes longer is a hang, even on a machine that much else is asked of."""

START_S = 900.0
"""The same for a planner that starts on a machine that much is asked of: it loads and compiles at first use."""

UNANSWERED_S = 2.0
"""A page whose frame says that it is longer waits for nothing; the planner then has to answer the next page."""

INPUTS_PER_PLANNER = 1500
"""Then another is started, as the history of its plan has grown."""

VALUES: tuple[Any, ...] = (
    *(
        "axial",
        "sagittal",
        "inline",
        "head",
        "left",
        "T1",
        "F1",
        "F2",
        "AC",
        "entry",
        "target",
        "diameter",
        "ctrl+z",
    ),
    *(
        "",
        "x" * 9,
        "\x1b[31m",
        "\u2028",
        "#ff00aa",
        "12.5",
        "nan",
        "1e308",
        "1 2 3",
        "../plan.json",
        "readings.csv",
    ),
    *(0, 1, 2, -1, 3, 7, 2**63, -(2**63), 0.5, 40.0, 200.0, 400.0, 1e4, 1e308, float("nan"), float("inf")),
    *(True, False, None, b"axial", [], [1, 2], {}, {"a": 1}),
)
SOUND: dict[str, tuple[Any, ...]] = {
    "press": ("axial", 200.0, 190.0, 400.0, 400.0, 0, False),
    "move": ("axial", 220.0, 180.0, 400.0, 400.0),
    "release": ("axial",),
    "wheel": ("axial", 1, False, 200.0, 200.0, 400.0, 400.0),
    "key": ("f",),
    "window": ("bone",),
    "surface": (),
    "select": ("left",),
    "lock": ("left", False),
    "remove": ("T1",),
    "rename_path": ("left", "left"),
    "place": ("left", "entry", 0, "30.5"),
    "colour": ("left", "#ff00aa"),
    "notes": ("left", "a note"),
    "instrument": ("left", "DBS lead"),
    "electrode": ("left", "Medtronic 3387"),
    "size": ("left", "diameter", "1.5"),
    "take": (0,),
    "landmark": ("AC", "0 0 0"),
    "jump_landmark": ("AC",),
    "jump": ("F1",),
    "jump_rejected": (0,),
    "reject": ("F2",),
    "accept": (0,),
    "rename": ("F1", "F1"),
    "readings": ("readings.csv",),
    "pick_reading": ("1",),
}
NEED_MORE = ("remove", "take", "pick_reading")
"""Sound, but what they speak of is not there to begin with."""

METHODS = (
    "trame.trigger",
    "trame.state.get",
    "trame.state.update",
    "trame.lifecycle.update",
    "trame.error.client",
)
OTHERS: tuple[Any, ...] = (
    "application.exit",
    "application.exit.later",
    "trame.force.push",
    "wslink.hello",
    "",
    "x",
    None,
    5,
    [],
)


class PlannerBorder(Border):
    """A planner of its own on the case of the tests."""

    slowest_s = 120.0  # another planner may have to be started
    inputs_in_tests = 200

    def __init__(self) -> None:
        self._served = 0
        self._start()

    def check_seeds(self, folder: Path) -> None:
        self._answer_s = START_S
        assert self._http(self._request(), True) == "read"
        for name, arguments in SOUND.items():
            outcome = self._frames(framed(request("trame.trigger", name, list(arguments), {})))
            assert outcome == ("refused" if name in NEED_MORE else "read"), name
        self._answer_s = ANSWER_S

    def hostile(self, chance: random.Random) -> tuple[str, Any]:
        kind = chance.choice(("http", "frame", "chunk", "request", "action", "action"))
        return kind, (kind, chance.getrandbits(64))

    def feed(self, given: Any, folder: Path) -> str:
        kind, number = given
        chance = random.Random(number)
        if self._served == INPUTS_PER_PLANNER or self._process.poll() is not None:
            if self._socket is not None:
                self._socket.close()
            self._end()
            self._start()
        self._served += 1
        outcome = (
            self._http(*self._hostile_http(chance))
            if kind == "http"
            else self._frames(MAKERS[kind](chance), kind == "frame")
        )
        self._check()
        return outcome

    # --- the planner -----------------------------------------------------------------------------------------

    def _start(self) -> None:
        temporary = tempfile.TemporaryDirectory()
        self.folder = cases.write_case(Path(temporary.name))
        cases.write_readings(self.folder / "readings.csv")
        self._log = self.folder / "errors.txt"
        command = [
            sys.executable,
            "-m",
            "ronnaplan",
            "view",
            str(cases.CT),
            "--plan",
            str(self.folder / "plan.json"),
        ]
        with self._log.open("wb") as errors:
            process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=errors, env=environment())
        self._process, self._end = process, weakref.finalize(self, _end, process, temporary)
        assert process.stdout is not None
        parts = urlsplit(process.stdout.readline().decode().strip())
        assert parts.hostname is not None, self._log.read_text(errors="replace")
        assert parts.port is not None
        self._address, self._token = (parts.hostname, parts.port), parts.query.partition("=")[2]
        self._socket: RawSocket | None = None
        self._served, self._first_bytes = 0, peak_bytes(self._process.pid)
        self._answer_s = START_S
        self._frames(framed(request("trame.lifecycle.update", "client_connected")))
        self._answer_s = ANSWER_S

    def _check(self) -> None:
        """Raise where the planner ended, told of an error of its own, took memory or damaged its plan."""
        assert self._process.poll() is None, f"the planner ended with status {self._process.returncode}"
        told = self._log.read_text(errors="replace")
        assert "Traceback" not in told, told[-3000:]
        assert "\x1b" not in told, told[-3000:]
        grown = peak_bytes(self._process.pid) - self._first_bytes
        assert grown < MOST_GROWN_BYTES, f"the planner's memory has grown by {grown >> 20} MiB"
        read_plan(self.folder / "plan.json")

    def peak_bytes(self) -> int:
        return max(super().peak_bytes(), peak_bytes(self._process.pid))

    # --- HTTP ------------------------------------------------------------------------------------------------

    def _request(self, **changed: bytes) -> bytes:
        host = f"{self._address[0]}:{self._address[1]}".encode()
        parts = {"path": b"/index.html", "token": self._token.encode(), "host": host, "more": b""} | changed
        return b"GET %(path)s?token=%(token)s HTTP/1.1\r\nHost: %(host)s\r\nConnection: close\r\n%(more)s\r\n" % {
            name.encode(): value for name, value in parts.items()
        }

    def _hostile_http(self, chance: random.Random) -> tuple[bytes, bool]:
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
        made = bytearray(self._request(path=path, token=token, host=host, more=more))
        sound = host == own and origin in (b"", b"http://" + own) and token == self._token.encode()
        if chance.random() < 0.4:
            mutate(made, ANYWHERE, chance)
            sound = self._token.encode() in made
        return bytes(made), sound

    def _http(self, made: bytes, sound: bool) -> str:
        try:
            status = answered(self._address, made, self._answer_s if made.endswith(b"\r\n\r\n") else 0.2)
        except TimeoutError:
            if made.endswith(b"\r\n\r\n"):
                raise
            return "not complete"
        assert status < 500, f"status {status} for {made!r}"
        if status in (0, *range(400, 500)):
            return "refused"
        if not sound:
            raise WrongValueError(f"status {status} for {made!r}")
        return "read"

    # --- the web socket --------------------------------------------------------------------------------------

    def _frames(self, sent: bytes, may_be_longer: bool = False) -> str:
        """Send bytes and a sound request behind them: "read" where it is answered, "refused" where it is closed."""
        if self._socket is None:
            self._socket = RawSocket(self._address, self._token, self._answer_s)
        self._socket.wait_s = UNANSWERED_S if may_be_longer else self._answer_s
        try:
            self._socket.send(sent)
            return "read" if self._socket.is_done() else "refused"
        except (ConnectionError, TimeoutError) as error:
            self._socket.close()
            self._socket = None
            if isinstance(error, ConnectionError):
                return "refused"
            if not may_be_longer:
                raise
            return "not complete"


def _end(process: subprocess.Popen[bytes], temporary: tempfile.TemporaryDirectory[str]) -> None:
    process.kill()
    process.communicate()
    temporary.cleanup()


def _action(chance: random.Random) -> bytes:
    name = chance.choice(list(SOUND))
    arguments = [value if chance.random() < 0.7 else chance.choice(VALUES) for value in SOUND[name]]
    if chance.random() < 0.1:
        arguments.append(chance.choice(VALUES))
    if arguments and chance.random() < 0.1:
        arguments.pop()
    return framed(_packed("trame.trigger", [name, arguments, {}]))


def _request(chance: random.Random) -> bytes:
    method = chance.choice(METHODS if chance.random() < 0.7 else OTHERS)
    some = [chance.choice(VALUES) for _ in range(chance.choice((0, 1, 1, 2, 3)))]
    some = chance.choice(
        (some, [[{"key": "tab", "value": chance.choice(VALUES)}]], ["client_connected"], ["press", some, {}])
    )
    return framed(_packed(method, some, number=chance.choice(("rpc:1", "rpc:1", "system:1:1", 5, None))))


def _chunk(chance: random.Random) -> bytes:
    made = bytearray(request("trame.trigger", "select", ["left"], {}))
    mutate(made, ANYWHERE, chance)
    return framed(bytes(made))


def _frame(chance: random.Random) -> bytes:
    content = chance.choice((request("trame.trigger", "select", ["left"], {}), b"", b"x" * 200, frame(b"\x80")))
    opcode, last = chance.choice((0, 1, 2, 2, 3, 8, 9, 10, 15)), chance.random() < 0.8
    claimed = chance.choice((None, None, 2**16, 2**32, 2**63 - 1, 0, 5))
    made = bytearray(framed(content, opcode=opcode, last=last, claimed=claimed))
    if chance.random() < 0.3:
        mutate(made, ANYWHERE, chance)
    return bytes(made)


def _packed(method: Any, arguments: list[Any], number: Any = "rpc:1") -> bytes:
    return frame(msgpack.packb({"wslink": "1.0", "id": number, "method": method, "args": arguments, "kwargs": {}}))


MAKERS = {"action": _action, "request": _request, "chunk": _chunk, "frame": _frame}
