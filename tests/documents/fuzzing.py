"""Documents with a few changes: each is refused, or read as what its text says, and then exported and written anew."""

from __future__ import annotations

import copy
import json
import math
import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel

from ronnaplan.documents.chain import read_chain
from ronnaplan.documents.export import export
from ronnaplan.documents.fiducials import read_fiducials
from ronnaplan.documents.files import read_json
from ronnaplan.documents.limits import read_limits
from ronnaplan.documents.placement import placement_text, read_placement
from ronnaplan.documents.plan import plan_document, read_plan
from ronnaplan.documents.plan_exchange import line_markups, plan_table, read_line_markups, read_plan_table
from ronnaplan.documents.reading import to_json, validated
from ronnaplan.documents.registration import read_registration
from ronnaplan.documents.rig import read_rig, read_spheres
from ronnaplan.documents.template import read_template
from ronnaplan.documents.tool import read_hand_eye, read_pivot
from ronnaplan.geometry import Frame
from ronnaplan.planner.storage import Look
from ronnaplan.planning.trajectory import INSTRUMENTS
from tests import cases
from tests.documents.test_strictness import documents, leaves
from tests.fuzz.border import Border, WrongValueError
from tests.fuzz.mutations import ANYWHERE, NUMBERS, mutate

POINTER = INSTRUMENTS["pointer"]
CT = Frame("CT", cases.plan().source.frame_of_reference_uid)
STRANGE: tuple[Any, ...] = (
    *(
        None,
        True,
        False,
        "",
        "1",
        "nan",
        [],
        {},
        [[]],
        0,
        -1,
        1,
        0.0,
        -0.0,
        1e-320,
        1e-9,
        1e5,
        1e17,
        1e308,
        -1e308,
    ),
    *(float("nan"), float("inf"), 10**19, 10**400, "\ud800", "\u2028", "\x1b[2J", "\u202e", "é", "F" * 5000),
)
LOOK = {
    "voxel_sha256": "00",
    "crosshair": [1.0, 2.0, 3.0],
    "center": [1.0, 2.0, 3.0],
    "field_mm": 200.0,
    "window": "bone",
    "selected": None,
    "points": {"AC": [1.0, 2.0, 3.0]},
}


class DocumentBorder(Border):
    """Every kind of document and of plan table, with one to three changes of its values, its structure or its bytes."""

    inputs_in_tests = 400

    def __init__(self) -> None:
        self.texts = {name: json.dumps(content, indent=1) for name, (content, _) in documents().items()}
        self.texts["look"] = json.dumps(LOOK)
        self.texts["lines"] = line_markups(cases.plan())
        self.texts["table"] = plan_table(cases.plan())

    def check_seeds(self, folder: Path) -> None:
        for name, text in self.texts.items():
            assert self.feed((name, text.encode()), folder) == "read", name

    def hostile(self, chance: random.Random) -> tuple[str, Any]:
        name = chance.choice(list(self.texts))
        content = self.texts[name].encode()
        if name != "table" and chance.random() < 0.7:
            value = json.loads(content)
            for _ in range(chance.choice((1, 1, 2, 3))):
                if next(leaves(value), None) is not None:  # else there is nothing left to change
                    chance.choice((_replace, _replace, _nudge, _nudge, _drop, _add, _twice))(value, chance)
            content = _Doubling(value).text().encode(errors="surrogatepass")
        else:
            changed = bytearray(content)
            mutate(changed, (*ANYWHERE, _number), chance)
            content = bytes(changed)
        return name, (name, content)

    def feed(self, given: Any, folder: Path) -> str:
        name, content = given
        path = folder / ("table.csv" if name == "table" else "document.json")
        path.write_bytes(content)
        READERS[name](path)
        return "read"


def _fiducials(path: Path) -> None:
    document = read_fiducials(path)
    _same(path, document)
    for entry in document.fiducials:
        np.linalg.cholesky(np.array(entry.covariance))
    assert len(set(document.points.labels)) == len(document.points)
    for to in ("markups", "csv"):
        export(path, to)


def _registration(path: Path) -> None:
    document = read_registration(path)
    _same(path, document)
    for to in ("markups", "csv"):
        export(path, to)
    if document.status == "unique":
        export(path, "itk")
        np.linalg.cholesky(document.pose.covariance)


def _plan(path: Path) -> None:
    plan = read_plan(path)
    _same(path, plan_document(plan), passed_over=("software", "time"))
    if plan.trajectories:
        plan_table(plan)
        line_markups(plan)


def _limits(path: Path) -> None:
    limits = read_limits(path)
    for (name,), value in leaves(json.loads(path.read_bytes())):
        if name not in ("format", "version"):
            _require(name, value, getattr(limits, name))


def _template(path: Path) -> None:
    template = read_template(path)
    written = json.loads(path.read_bytes())
    if template.distances_mm.tolist() != written["distances"] or list(template.labels) != written["labels"]:
        raise WrongValueError(f"{template} from {written}")


def _placement(path: Path) -> None:
    document = read_placement(path)
    _same(path, document)
    placement_text(document)


def _read_as_written(read: Callable[[Path], BaseModel]) -> Callable[[Path], None]:
    return lambda path: _same(path, read(path))


def _look(path: Path) -> None:
    _same(path, validated(read_json(path), Look, "look", "none"))


def _lines(path: Path) -> None:
    found = read_line_markups(path, CT, POINTER, first="entry")
    written = [line for line in json.loads(path.read_bytes())["markups"] if line["type"] == "Line"]
    for line, read in zip(written, found, strict=True):
        sign = np.array([-1, -1, 1] if line["coordinateSystem"] == "RAS" else [1, 1, 1])
        stated = {tuple(sign * point["position"]) for point in line["controlPoints"]}
        if stated != {tuple(read.entry_mm), tuple(read.target_mm)}:
            raise WrongValueError(f"{read} from {line}")


def _table(path: Path) -> None:
    found = read_plan_table(path, CT, POINTER)
    text = path.read_bytes().decode("utf-8-sig")
    for one in found:
        for value in (*one.entry_mm, *one.target_mm):
            if not any(float(abs(value)) == abs(number) for number in _numbers(text)):
                raise WrongValueError(f"{value} is not in the table")


def _numbers(text: str) -> list[float]:
    found = []
    for cell in text.replace("\n", ",").replace(";", ",").replace("\t", ",").split(","):
        try:
            found.append(float(cell.strip(' "\r')) if "_" not in cell else math.nan)
        except ValueError:
            continue
    return found


READERS: dict[str, Callable[[Path], None]] = {
    "fiducials": _fiducials,
    "registration": _registration,
    "plan": _plan,
    "limits": _limits,
    "template": _template,
    "placement": _placement,
    "pivot": _read_as_written(read_pivot),
    "hand-eye": _read_as_written(read_hand_eye),
    "rig": _read_as_written(read_rig),
    "spheres": _read_as_written(read_spheres),
    "tracked chain": _read_as_written(read_chain),
    "stereo chain": _read_as_written(read_chain),
    "look": _look,
    "lines": _lines,
    "table": _table,
}


def _same(path: Path, document: BaseModel, passed_over: tuple[str, ...] = ()) -> None:
    """Raise `WrongValueError` unless each value of the file is the document's, and it is written as it was read."""
    read = json.loads(document.model_dump_json())
    for place, value in leaves(json.loads(path.read_bytes())):
        if not set(passed_over) & set(place):
            found = read
            for key in place:
                found = found[key]
            _require(place, value, found)
    if json.loads(to_json(document)) != read:
        raise WrongValueError("it is not written as it was read")


def _require(place: Any, value: Any, found: Any) -> None:
    is_number = type(value) in (int, float) and type(found) in (int, float)
    if value != found or not (is_number or type(value) is type(found)):
        raise WrongValueError(f"{place} is {value!r} in the file and {found!r} in what was read")


class _Doubling:
    """Writes JSON in which a member may stand twice: one whose name begins with ``twice:``."""

    def __init__(self, value: Any) -> None:
        self.value = value

    def text(self) -> str:
        return json.dumps(self.value, ensure_ascii=False).replace('"twice:', '"')


def _somewhere(value: Any, chance: random.Random) -> tuple[Any, Any]:
    """Return a container within ``value`` and a key of it."""
    places = [place for place, _ in leaves(value)] or [()]
    place = chance.choice(places)
    cut = chance.choice((len(place), len(place), max(1, len(place) - 1), 1))
    for key in place[: cut - 1]:
        value = value[key]
    return value, place[cut - 1]


def _replace(value: Any, chance: random.Random) -> None:
    parent, key = _somewhere(value, chance)
    parent[key] = chance.choice(STRANGE)


def _nudge(value: Any, chance: random.Random) -> None:
    """Change a number a little, or its sign, which may well be accepted."""
    numbers = [place for place, leaf in leaves(value) if type(leaf) in (int, float) and abs(leaf) < 1e300]
    if numbers:
        place = chance.choice(numbers)
        for key in place[:-1]:
            value = value[key]
        value[place[-1]] *= chance.choice((-1, 1 + 1e-12, 1.001, 2, 0, 1e-3))


def _drop(value: Any, chance: random.Random) -> None:
    parent, key = _somewhere(value, chance)
    del parent[key]


def _add(value: Any, chance: random.Random) -> None:
    parent, key = _somewhere(value, chance)
    if isinstance(parent, list):
        parent.insert(key, copy.deepcopy(parent[key]))
    else:
        parent[chance.choice(("centre", "note", ""))] = chance.choice(STRANGE)


def _twice(value: Any, chance: random.Random) -> None:
    parent, key = _somewhere(value, chance)
    if isinstance(parent, dict):
        parent[f"twice:{key}"] = chance.choice((*STRANGE, parent[key]))


def _number(data: bytearray, chance: random.Random) -> None:
    """Write a strange number over a digit."""
    digits = [at for at, each in enumerate(data) if 0x30 <= each <= 0x39]
    if digits:
        at = chance.choice(digits)
        data[at : at + chance.choice((0, 1, 3))] = chance.choice(NUMBERS)
