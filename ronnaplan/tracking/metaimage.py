"""Tracker sequences in MetaImage files (``.mha``, ``.mhd``) as written by the PLUS toolkit and SlicerIGT.

The header holds, for each frame, ``Seq_Frame0000_<Tool>To<Tracker>Transform`` (16 numbers, row by row), its
``...TransformStatus`` (OK or INVALID) and ``Seq_Frame0000_Timestamp``; the images behind it are not read.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from ronnaplan.errors import InputError
from ronnaplan.geometry import FloatArray
from ronnaplan.pose import as_pose
from ronnaplan.tracking.recording import OK, Recording, ToolReading

END_OF_HEADER = b"ElementDataFile"
LONGEST_LINE = 1 << 16
FIELD = re.compile(r"Seq_Frame(\d+)_(\w+)\s*=\s*(.*)")


def read_sequence(path: Path) -> Recording:
    """Read every transform of every frame of ``path``; those marked invalid, or that are no pose, are flagged.

    Raises `InputError` for a file that is no MetaImage or that holds no transforms.
    """
    fields: dict[tuple[int, str], str] = {}
    for line in _header(path):
        match = FIELD.match(line)
        if match:
            fields[int(match[1]), match[2]] = match[3].strip()
    transforms = [(frame, name) for frame, name in fields if name.endswith("Transform")]
    if not transforms:
        raise InputError(f"{path} holds no Seq_Frame..Transform fields; expected a MetaImage tracker sequence")
    return Recording(str(path), tools=tuple(_reading(fields, frame, name) for frame, name in sorted(transforms)))


def _header(path: Path) -> list[str]:
    lines: list[str] = []
    try:
        with path.open("rb") as file:
            while raw := file.readline(LONGEST_LINE):
                line = raw.decode("ascii", errors="replace").strip()
                if "=" not in line:
                    break
                lines.append(line)
                if raw.startswith(END_OF_HEADER):
                    return lines
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror}); check the path") from error
    raise InputError(f"{path} is not a MetaImage file, or its header ends early; expected 'key = value' lines")


def _reading(fields: dict[tuple[int, str], str], frame: int, name: str) -> ToolReading:
    status = fields.get((frame, f"{name}Status"), "OK").lower()
    try:
        time_s = float(fields.get((frame, "Timestamp"), "nan"))
    except ValueError:
        time_s = float("nan")
    matrix: FloatArray | None = None
    try:
        matrix = as_pose(np.array(fields[frame, name].split(), dtype=np.float64).reshape(4, 4))
    except (ValueError, InputError) as error:
        if status == OK:
            status = f"no pose: {error}"
    return ToolReading(frame, name.removesuffix("Transform"), matrix, time_s, None, status)
