"""What the columns of a table of readings are called, and which of them mean the same."""

from __future__ import annotations

import re
from collections.abc import Sequence

from ronnaplan.tracking.cells import SEEN_COLUMNS

POINT_NAMES = ("label", "name", "marker", "id")
TOOL_NAMES = ("label", "name", "marker", "tool", "tool_name", "id")
"""Columns that name what a row tells of; the first one that it fills counts."""
SYSTEM_COLUMNS = ("coordinate_system", "coordinates")
OF_WORDS = frozenset({"kind", "frame", "notes", "description", *TOOL_NAMES, *SYSTEM_COLUMNS, *SEEN_COLUMNS})
"""Columns of words, of which none is a unit: a frame may be called M."""
SAME_COLUMNS = {"qw": "q0", "frame_number": "frame"}
OF_A_READING = re.compile(
    rf"(((tool|pose)(_?(?P<tool>\d+))?|(marker|point)(_?\d+)?)_)?(is_?)?(?P<said>{'|'.join(sorted(SEEN_COLUMNS))})"
)
"""What columns are called, too, that say whether a reading counts: ``tool_1_status``, ``is_valid``."""
AXES = (
    *(frozenset(names) for names in (("x", "y", "z"), ("tx", "ty", "tz"), ("l", "p", "s"), ("r", "a", "s"))),
    *(frozenset(names) for names in (("m03", "m13", "m23"), ("m14", "m24", "m34"))),
)
"""What columns of places are called, by the first word of their name."""
ENDS = frozenset({"entry", "target"})
"""The same of trajectories."""
SIZES = frozenset({"sigma", "error", "diameter", "length"})
"""Other columns that are lengths in mm, by the first word of their name."""


def column_name(cell: str) -> str:
    """Return ``cell`` lower-case, without ``#``, unit or brackets: ``"#Tx [mm]"`` becomes ``"tx"``.

    >>> column_name(" X (mm)"), column_name("Frame#"), column_name("sigma_mm"), column_name("time_s")
    ('x', 'frame', 'sigma', 'time')

    A quaternion's scalar, and a frame's number, have two names that mean the same: ``"qw"`` becomes ``"q0"``, and
    ``"Frame Number"`` ``"frame"``. What says whether a reading counts has several.

    >>> column_name("tool_1_status"), column_name("isVisible"), column_name("system_status")
    ('status', 'visible', 'system_status')
    """
    name = bare_name(cell)
    of_a_reading = OF_A_READING.fullmatch(name)
    return of_a_reading["said"] if of_a_reading else SAME_COLUMNS.get(name, name)


def bare_name(cell: str) -> str:
    """Return ``cell`` as `column_name` does, but what means the same keeps its own name."""
    bare = re.sub(r"[\[(].*?[\])]", "", cell).replace("#", "").strip().lower()
    return re.sub(r"_(mm|s)$", "", bare.replace(" ", "_")).strip("_")


def place_columns(header: Sequence[str]) -> list[int]:
    """Return the columns of a ``header`` of normalized names that are coordinates of places."""
    firsts = [name.split("_")[0] for name in header]
    places = ENDS.union(*(axes for axes in AXES if axes <= set(firsts)))
    return [k for k, first in enumerate(firsts) if first in places]


def length_columns(header: Sequence[str]) -> list[int]:
    """Return the columns that are lengths in mm: those of places, and sizes."""
    sizes = [k for k, name in enumerate(header) if name.split("_")[0] in SIZES]
    return sorted({*place_columns(header), *sizes})
