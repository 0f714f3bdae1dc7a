"""Readings files and OpenIGTLink streams with a few changes: each is refused, or read as its own numbers say."""

from __future__ import annotations

import json
import random
import re
import struct
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pyigtl
from pyigtl.messages import CRC64

from ronnaplan.errors import InputError
from ronnaplan.tracking import Recording, find_markers, read_recording
from ronnaplan.tracking.csv_file import write_csv
from ronnaplan.tracking.igtl_layout import HEADER
from ronnaplan.tracking.igtl_messages import Stream
from ronnaplan.tracking.openigtlink import SILENCE_S
from tests.fuzz.border import Border, WrongValueError
from tests.fuzz.mutations import ANYWHERE, NUMBERS, mutate
from tests.tracking.files import MARKUPS, NDI, as_nrrd, matrix_rows, plus, sequence, turned
from tests.tracking.streams import quaternions_of_tools, tools_of_plus

CSV = (
    "kind,frame,time_s,label,x [mm],y,z,q0,qx,qy,qz,sigma,status,unit\n"
    "point,0,1.25,A,0.125,2,3,,,,,0.17,ok,mm\npoint,0,1.25,,11.5,-2,3,,,,,,ok,mm\npoint,1,1.5,A,,,,,,,,,missing,mm\n"
    "tool,1,1.5,probe,1,2,-1000,0.5,0.5,-0.5,0.5,,ok,mm\ntool,2,,probe,,,,,,,,,no pose,mm\n"
)
PLAIN = "label;x;y;z\nA;1,5;-2,25;3\nB;4,5;5,25;6\n"
SEQUENCE = sequence([(plus(turned(k)), "OK" if k else "INVALID") for k in range(3)])
FCSV = "# Markups\n# CoordinateSystem = RAS\n# columns = id,x,y,z,ow,label\n1,1.5,2,3,0,F-1\n2,4,5,6.25,0,F-2\n"
SEEDS = {
    "readings.csv": CSV.encode(),
    "plain.csv": PLAIN.encode(),
    "utf16.csv": PLAIN.encode("utf-16"),
    "ndi.csv": NDI.encode(),
    "matrices.csv": matrix_rows(0, 4).encode(),
    "points.mrk.json": MARKUPS.encode(),
    "points.fcsv": FCSV.encode(),
    "sequence.mha": SEQUENCE.encode(),
    "sequence.seq.nrrd": as_nrrd(SEQUENCE).encode(),
}
NUMBER = re.compile(r"[-+]?(?:\d+(?:[.,]\d*)?|[.,]\d+)(?:[eE][-+]?\d+)?", re.ASCII)
DIGITS = re.compile(rb"[0-9]+(?:\.[0-9]+)?")
STRANGE = (
    *NUMBERS,
    b"1e3",
    b"1,5",
    b'"1"',
    b"true",
    b"null",
    b"[1,2,3]",
    b"\xd9\xa1",
    b"\xe2\x80\xa8",
    b"\x1b[2J",
    b"m",
)


def _number(data: bytearray, chance: random.Random) -> None:
    """Put something strange in the place of a number."""
    found = list(DIGITS.finditer(bytes(data)))
    if found:
        match = chance.choice(found)
        data[match.start() : match.end()] = chance.choice(STRANGE)


class ReadingsBorder(Border):
    """A readings file of each format."""

    inputs_in_tests = 400

    def check_seeds(self, folder: Path) -> None:
        for name, content in SEEDS.items():
            assert self.feed((name, content), folder) == "read", name

    def hostile(self, chance: random.Random) -> tuple[str, Any]:
        name = chance.choice(list(SEEDS))
        content = bytearray(SEEDS[name])
        mutate(content, (*ANYWHERE, *[_number] * 8), chance)
        return name, (name, bytes(content))

    def feed(self, given: Any, folder: Path) -> str:
        name, content = given
        path = folder / name
        path.write_bytes(content)
        recording = read_recording(path)
        check(recording, _stated(name, content))
        again = folder / "again.csv"
        again.write_text(write_csv(recording), newline="")
        _require_same(recording, read_recording(again))
        with suppress(InputError):
            for marker in find_markers(recording).markers:
                np.linalg.cholesky(marker.covariance_mm2)
        seen = any(point.usable for point in recording.points) or any(tool.usable for tool in recording.tools)
        return "read" if seen else "all flagged"


def _require_same(first: Recording, second: Recording) -> None:
    for one, other in zip((*first.points, *first.tools), (*second.points, *second.tools), strict=True):
        for name, value in vars(one).items():
            back = getattr(other, name)
            if isinstance(value, str):  # of a status the case may go
                same = value.strip().lower() == back.lower()
            else:
                given, got = np.array(value, dtype=float), np.array(back, dtype=float)
                same = np.allclose(given, got, rtol=1e-9, atol=1e-9, equal_nan=True)
            if not same:
                raise WrongValueError(f"{name} is {value!r}, back from CSV {back!r}")


def _stated(name: str, content: bytes) -> set[float]:
    """Return every number that stands in the file, and its opposite (for RAS)."""
    if name.endswith(".json"):
        numbers = [float(value) for value in _values(json.loads(content))]
    else:
        text = content.decode("utf-16" if content[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8", errors="replace")
        # a number grown together with other characters is none
        words = {word for cut in (r"[\s;]+", r"[\s,;=]+") for word in re.split(cut, text.replace('"', ""))}
        numbers = [float(word.replace(",", ".")) for word in words if NUMBER.fullmatch(word)]
    return {signed for value in numbers for signed in (value, -value)}


def _values(value: Any) -> list[float]:
    if isinstance(value, dict | list):
        children = value.values() if isinstance(value, dict) else value
        return [number for child in children for number in _values(child)]
    return [value] if type(value) in (int, float) else []


def check(recording: Recording, stated: set[float]) -> None:
    """Raise `WrongValueError` unless every usable coordinate is among the numbers ``stated``, and every pose rigid."""
    places = [point.position_mm for point in recording.points if point.usable]
    for tool in recording.tools:
        if tool.usable and tool.matrix is not None:
            places.append(tool.matrix[:3, 3])
            if np.abs(tool.matrix[:3, :3] @ tool.matrix[:3, :3].T - np.eye(3)).max() > 1e-9:
                raise WrongValueError(f"{tool} is no rotation")
    for value in np.array(places).ravel().tolist():
        if value not in stated:
            raise WrongValueError(f"{value} mm is not among the numbers of the file")
    names = [*(point.label for point in recording.points), *recording.tool_names, *recording.flagged()]
    if not all(text.isprintable() for text in (*names, *recording.notes)):
        raise WrongValueError("a text that could steer a terminal")


class StreamBorder(Border):
    """An OpenIGTLink stream of every kind of message, its checksums made good again half of the time."""

    inputs_in_tests = 400
    expected_outcomes = ("read", "broken")

    def __init__(self) -> None:
        places = [[1.5, 2.25, -1000.0], [4.0, 5.0, -1001.5]]
        half = float(np.sqrt(0.5))
        position = pyigtl.PositionMessage(
            positions=[[1, 2, 3]], quaternions=[[0, 0, half, half]], names=["P"], device_name="D"
        )
        newer = pyigtl.PointMessage(positions=places, names=["F", "G"], device_name="P")
        newer.header_version, newer.metadata = 2, {"key": "value"}
        body = struct.pack(">7f", 1, 2, 3, 0, 0, half, half)
        self.messages = [
            pyigtl.PointMessage(positions=places, names=["", "A"], device_name="P", timestamp=1.5).pack(),
            pyigtl.TransformMessage(matrix=turned(1), device_name="ProbeToTracker").pack(),
            pyigtl.StringMessage("hello", device_name="S").pack(),
            HEADER.pack(1, b"POSITION", b"Pointer", 3, 0, len(body), CRC64(body)) + body,
            position.pack(),
            newer.pack(),
            tools_of_plus({"Probe": (2, turned(1)), "Tip": (3, turned(2))}, {"ProbeStatus": "OK"}),
            quaternions_of_tools(
                {"Probe": (2, (1.5, 2.5, 3.5, 0, 0, half, half)), "Axis": (4, (1, 2, 3, 0, 0, 0.6, 0.8))}
            ),
        ]

    def check_seeds(self, folder: Path) -> None:
        assert self.feed((b"".join(self.messages), 7), folder) == "read"

    def hostile(self, chance: random.Random) -> tuple[str, Any]:
        order = [chance.choice(self.messages) for _ in range(chance.randrange(1, 8))]
        at = chance.randrange(len(order))
        changed = bytearray(order[at])
        mutate(changed, ANYWHERE, chance)
        is_mended = chance.random() < 0.5 and len(changed) >= HEADER.size
        if is_mended:
            version, kind, device, seconds, fraction, _, _ = HEADER.unpack_from(changed)
            body = bytes(changed[HEADER.size :])
            changed[: HEADER.size] = HEADER.pack(version, kind, device, seconds, fraction, len(body), CRC64(body))
        order[at] = bytes(changed)
        return "mended" if is_mended else "damaged", (b"".join(order), chance.randrange(1, 500))

    def feed(self, given: Any, folder: Path) -> str:
        content, step = given
        whole, pieces = Stream(SILENCE_S), Stream(SILENCE_S)
        whole.feed(content)
        for start in range(0, len(content), step):
            pieces.feed(content[start : start + step])
        if _told(whole) != _told(pieces):
            raise WrongValueError(f"pieces of {step} bytes are read otherwise than the whole")
        recording = Recording("stream", tuple(whole.points), tuple(whole.tools), notes=tuple(whole.notes))
        floats = {value for start in range(4) for value in _floats(content[start:])}
        check(recording, floats)
        with suppress(InputError):
            find_markers(recording)
        return "broken" if whole.broken else "read"


def _floats(content: bytes) -> list[float]:
    values = np.frombuffer(content[: len(content) // 4 * 4], dtype=">f4")
    return [float(value) for value in values if np.isfinite(value)]


def _told(stream: Stream) -> str:
    return repr(
        (write_csv(Recording("s", tuple(stream.points), tuple(stream.tools))), stream.notes, stream.broken)
    )
