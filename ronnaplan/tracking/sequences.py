"""Tracker sequences in image files as written by the PLUS toolkit: MetaImage (``.mha``, ``.mhd``) and NRRD.

The header holds, for each frame, ``Seq_Frame0000_<Tool>To<Tracker>Transform`` (16 numbers, row by row), its
``...TransformStatus`` (OK or INVALID) and ``Seq_Frame0000_Timestamp``; the images behind it are not read. In
MetaImage a field is ``key = value`` and ``ElementDataFile`` is the last; in NRRD it is ``key:=value`` and an empty
line ends the header.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ronnaplan.errors import InputError
from ronnaplan.text import BLANKS, plain_number, printable
from ronnaplan.tracking.recording import OK, Recording, Roundings, ToolReading, tool_reading
from ronnaplan.untrusted import require_file

LONGEST_LINE = 1 << 16
MOST_HEADER_BYTES = 1 << 28
MOST_FIELDS = 1_000_000
"""Half an hour of ten tools at 20 Hz; more fields or bytes would take the memory."""
PREFIX = "Seq_Frame"
FIELD = re.compile(PREFIX + r"([0-9]{1,9})_([^\s=:]+)\s*:?=\s*(.*)")
UNIT = re.compile(r"(?:DistanceUnits\s*=|space units\s*:)\s*(.+)", re.IGNORECASE)
Fields = dict[tuple[int, str], str]


def read_sequence(path: Path) -> Recording:
    """Read every transform of every frame of ``path``; those marked invalid, or that are no pose, are flagged.

    Raises `InputError` for a file that is no MetaImage or NRRD, that holds no transforms, or that says one thing twice.
    """
    fields: Fields = {}
    for line in _header(path):
        match = FIELD.match(line)
        if match is None:
            raise InputError(
                f"{path} has the field '{printable(line, 80)}'; expected {PREFIX}, a number, _ and a name"
            )
        key = int(match[1]), match[2]
        if len(fields) > MOST_FIELDS:
            raise InputError(f"{path} has more than {MOST_FIELDS} fields; split the recording")
        if fields.setdefault(key, match[3].strip(BLANKS)) != match[3].strip(BLANKS):
            raise InputError(
                f"{path} gives {printable(match[2])} of frame {key[0]} twice; expected each field once"
            )
    transforms = sorted((frame, name) for frame, name in fields if name.endswith("Transform"))
    if not transforms:
        raise InputError(f"{path} holds no {PREFIX}..Transform fields; expected a tracker sequence")
    read = [_reading(fields, frame, name) for frame, name in transforms]
    roundings = Roundings()
    for _, excess in read:
        roundings.add(excess)
    return Recording(str(path), tools=tuple(tool for tool, _ in read), notes=roundings.notes)


def seems_sequence(beginning: bytes) -> bool:
    """Whether an image file begins with fields of frames: of other images, which hold no readings, none does."""
    return PREFIX.encode() in beginning


def _header(path: Path) -> Iterator[str]:
    """Yield the lines of the header that are a frame's."""
    require_file(path, expected="a MetaImage or NRRD tracker sequence")
    left = MOST_HEADER_BYTES
    try:
        with path.open("rb") as file:
            is_nrrd = file.read(4) == b"NRRD"
            file.seek(0)
            while (raw := file.readline(LONGEST_LINE)) and left > 0:
                left -= len(raw)
                line = raw.decode("ascii", errors="replace").strip(BLANKS)
                if line.startswith(PREFIX):
                    yield line
                elif (unit := UNIT.match(line)) and set(re.findall(r"[^\s\"]+", unit[1])) != {"mm"}:
                    raise InputError(f"{path} states lengths in {printable(unit[1], 80)}; expected mm")
                if (not line) if is_nrrd else line.startswith("ElementDataFile"):
                    return
                if not is_nrrd and "=" not in line:
                    break
            if is_nrrd and not raw:  # a detached header may end with the file
                return
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror}); check the path") from error
    raise InputError(
        f"{path} is not a MetaImage or NRRD file, or its header ends early; expected 'key = value' lines"
    )


def _reading(fields: Fields, frame: int, name: str) -> tuple[ToolReading, float]:
    """Return the reading, and by how much its rotation missed one."""
    status = fields.get((frame, f"{name}Status"), OK).lower()
    time_s = plain_number(fields.get((frame, "Timestamp"), ""))
    numbers = [plain_number(text) for text in re.split("[ \t]+", fields[frame, name].strip(BLANKS))]
    matrix = np.array(numbers, dtype=np.float64)
    tool = name.removesuffix("Transform")
    return tool_reading(frame, tool, matrix, float("nan") if time_s is None else time_s, status)
