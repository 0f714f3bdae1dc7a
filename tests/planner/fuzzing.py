"""A running planner and a start page that are sent hostile HTTP, frames, requests and actions: they go on serving."""

from __future__ import annotations

import random
import zipfile
from pathlib import Path
from typing import Any

import msgpack

from ronnaplan.documents.plan import read_plan
from tests import cases
from tests.fuzz.mutations import ANYWHERE, mutate
from tests.planner.fuzzing_http import ANSWER_S, START_S, ServerBorder
from tests.planner.pages import frame, request
from tests.planner.raw import RawSocket, framed

UNANSWERED_S = 2.0
"""A page whose frame says that it is longer waits for nothing; the planner then has to answer the next page."""

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
    "sized": ("axial", 400.0, 400.0, 1.0, 12.0),
    "hover": ("axial", 200.0, 190.0, 400.0, 400.0),
    "nudge": ("coronal", 1.0, -1.0),
    "click": ("axial", False),
    "window_hu": ("40", 80),
    "layout": ("four",),
    "look_from": ("A",),
    "show_as": ("bone",),
    "strength": (1.5,),
    "open_head": ("corner",),
    "pictures": (),
    "drawn_here": (),
    "dismiss": (),
    "cancel": (),
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


class PlannerBorder(ServerBorder):
    """A planner of its own on the case of the tests."""

    inputs_in_tests = 40
    routes = (
        (b"GET", "/download/{}", ""),
        (b"PUT", "/readings", "name"),
        (b"GET", "/things/{}", ""),
        (b"GET", "/volume", ""),
    )

    def command(self, folder: Path) -> tuple[list[str], Path]:
        cases.write_case(folder)
        cases.write_readings(folder / "readings.csv")
        return ["view", str(cases.CT), "--plan", str(folder / "plan.json")], folder

    def start(self) -> None:
        super().start()
        self._socket: RawSocket | None = None
        self._frames(framed(request("trame.lifecycle.update", "client_connected")))
        self._answer_s = ANSWER_S

    def check_seeds(self, folder: Path) -> None:
        self._answer_s = START_S
        assert self.http(self.request(), True) == "read"
        for name, arguments in SOUND.items():
            outcome = self._frames(framed(request("trame.trigger", name, list(arguments), {})))
            assert outcome == ("refused" if name in NEED_MORE else "read"), name
        assert self.http(self.request(path=b"/download/plan.json"), True) == "read"
        taken = self.request(b"PUT", b"x,y,z\n1,2,3\n", path=b"/readings", query=b"&name=more.csv")
        assert self.http(taken, True) == "read"
        self._answer_s = ANSWER_S

    def hostile(self, chance: random.Random) -> tuple[str, Any]:
        kind = chance.choice(("http", "route", "frame", "chunk", "request", "action", "action"))
        return kind, (kind, chance.getrandbits(64))

    def feed(self, given: Any, folder: Path) -> str:
        kind, number = given
        chance = random.Random(number)
        if self._process.poll() is not None and self._socket is not None:
            self._socket.close()
        self.renew()
        if kind in ("http", "route"):
            outcome = self.http(*(self.hostile_http if kind == "http" else self.hostile_route)(chance))
        else:
            outcome = self._frames(MAKERS[kind](chance), kind == "frame")
        self.check()
        read_plan(self.folder / "plan.json")
        return outcome

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


class StartBorder(ServerBorder):
    """A start page above folders in which nothing can be planned: no answer leads to a planner."""

    inputs_in_tests = 100
    routes = (
        (b"GET", "/folders", "at"),
        (b"GET", "/series", "at"),
        (b"GET", "/thumbnail/{}", ""),
        (b"POST", "/drop", ""),
        (b"PUT", "/dropped", "name"),
        (b"PUT", "/dropped", "name"),
        (b"GET", "/archive", "patient"),
        (b"GET", "/archive/{}", ""),
        (b"POST", "/fetch", "key"),
        (b"POST", "/open", "key"),
        (b"POST", "/open", "name"),
    )

    def command(self, folder: Path) -> tuple[list[str], Path]:
        (folder / "home").mkdir()
        study = folder / "root" / "study" / "ct"
        study.mkdir(parents=True)
        (study / "0").write_bytes(b"no image")
        with zipfile.ZipFile(folder / "root" / "a.zip", "w") as archive:
            archive.writestr("../plan.json", b"{}")
        return ["view", "--root", str(folder / "root")], folder / "home"

    def check_seeds(self, folder: Path) -> None:
        assert self.http(self.request(), True) == "read"
        assert self.http(self.request(path=b"/folders", query=b"&at=study"), True) == "read"
        assert self.http(self.request(b"POST", path=b"/drop"), True) == "read"
        dropped = self.request(b"PUT", b"1", path=b"/dropped", query=self._of_last_drop + b"&name=a/b.dcm")
        assert self.http(dropped, True) == "read"
        self._answer_s = ANSWER_S

    @property
    def _of_last_drop(self) -> bytes:
        """What names the last drop in a query."""
        return b"".join(b"&drop=" + one.name.encode() for one in (self.folder / "home").glob(".dropped-*"))

    def hostile_route(self, chance: random.Random) -> tuple[bytes, bool]:
        made, may_be_served = super().hostile_route(chance)
        return made.replace(b"&name=", self._of_last_drop + b"&name="), may_be_served

    def hostile(self, chance: random.Random) -> tuple[str, Any]:
        return chance.choice(("http", "route", "route")), chance.getrandbits(64)

    def feed(self, given: Any, folder: Path) -> str:
        chance = random.Random(given)
        self.renew()
        make = self.hostile_http if chance.random() < 0.3 else self.hostile_route
        outcome = self.http(*make(chance))
        self.check()
        beside = {one.name for one in self.folder.iterdir()} - {"home", "root", "errors.txt"}
        assert not beside, f"{beside} were written beside the folders that are the server's"
        return outcome


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
