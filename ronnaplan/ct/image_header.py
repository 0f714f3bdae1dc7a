"""What the header of an image file states, whatever its format, and how its texts and numbers are read: to the letter.

No library's parser sees a header. They take the identity for a broken line, one of two contradicting maps, and end
the process on a number of 5,000 digits.
"""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Final, Literal

import numpy as np

from ronnaplan.ct.files import DamagedError
from ronnaplan.ct.limits import Limits, are_hu
from ronnaplan.geometry import FloatArray
from ronnaplan.text import counted, printable

Encoding = Literal["raw", "gzip", "zlib", "bzip2"]

AFFINE_TOLERANCE_MM: Final = 0.01
"""Two ways to place the same voxel may differ by this much (NIfTI keeps float32)."""
UNEVEN_MM: Final = "ITK_non_uniform_sampling_deviation"
"""Under this name ITK tells how far the slices of a series lie from the even grid that it made of them."""
LARGEST_NUMBER: Final = 1e9
"""No place, size or scale of a scan is larger; squares and products of such numbers stay finite."""
LONGEST_LINE: Final = 1 << 16
_DECIMAL: Final = re.compile(r"[+-]?(\d{1,40}\.?\d{0,40}|\.\d{1,40})([eE][+-]?\d{1,3})?", re.ASCII)
_WHOLE: Final = re.compile(r"-?\d{1,10}", re.ASCII)
_PLAIN: Final = re.compile(r"[\t -~]*")
"""Printable ASCII. Of other bytes, readers differ which are blanks."""


@dataclass(frozen=True)
class StoredVoxels:
    """Where the voxels of an image are: from byte ``start`` of ``path``, packed as ``encoding``.

    ``skip`` bytes come before them once unpacked. ``start`` is None where they fill the end of the file.
    """

    path: Path
    start: int | None
    encoding: Encoding = "raw"
    skip: int = 0


@dataclass(frozen=True)
class ImageHeader:
    """The header of an image of ``shape`` (K, J, I), in slices, rows and columns.

    ``lps_from_index`` (4, 4) maps (i, j, k, 1) to LPS mm; HU = stored value of type ``dtype`` x ``slope`` +
    ``intercept``. ``modality`` is what it says to have been made by, CT where it says nothing.
    """

    shape: tuple[int, int, int]
    dtype: np.dtype[np.generic]
    lps_from_index: FloatArray
    stored: StoredVoxels
    slope: float = 1.0
    intercept: float = 0.0
    modality: str = "CT"


def header_lines(stream: BinaryIO, limits: Limits) -> list[str]:
    """Return the lines of a text header up to its blank line or ``ElementDataFile``."""
    lines: list[str] = []
    while raw := stream.readline(LONGEST_LINE):
        if not raw.endswith(b"\n") and len(raw) == LONGEST_LINE:
            raise DamagedError(f"its header has a line of more than {LONGEST_LINE} bytes")
        if stream.tell() > limits.header_bytes:
            raise DamagedError("its header is too long")
        line = raw.decode("utf-8", "surrogateescape").rstrip("\r\n")
        if not line.strip():
            break
        lines.append(line)
        if line.startswith("ElementDataFile"):
            break
    return lines


def field_name(text: str) -> str:
    """Return the name of a field without the blanks around it; raises `DamagedError` unless it is printable ASCII."""
    name = text.strip(" \t")
    if not _PLAIN.fullmatch(name):
        raise DamagedError(f"its header has the field '{printable(name, 60)}', expected a name in printable ASCII")
    return name


def decimals(text: str, count: int, name: str) -> FloatArray:
    """Return the decimal numbers (``count``,) of ``text``; raises `DamagedError` for any other text."""
    words = text.split() if _PLAIN.fullmatch(text) else []
    if len(words) != count or not all(_DECIMAL.fullmatch(word) for word in words):
        raise DamagedError(f"it gives '{printable(text, 60)}' as its {name}, expected {counted(count, 'number')}")
    return finite(np.array(words, dtype=np.float64), name)


def whole(text: str, count: int, name: str) -> tuple[int, ...]:
    """Return the ``count`` whole numbers of ``text``; raises `DamagedError` for any other text."""
    words = text.split() if _PLAIN.fullmatch(text) else []
    if len(words) != count or not all(_WHOLE.fullmatch(word) for word in words):
        wanted = counted(count, "whole number")
        raise DamagedError(f"it gives '{printable(text, 60)}' as its {name}, expected {wanted} of up to 10 digits")
    return tuple(int(word) for word in words)


def finite(numbers: FloatArray, name: str) -> FloatArray:
    """Return ``numbers`` (...); raises `DamagedError` if one is no number, or beyond `LARGEST_NUMBER`."""
    if not (np.abs(numbers) <= LARGEST_NUMBER).all():
        raise DamagedError(
            f"it gives {_shown(numbers)} as its {name}, expected finite numbers up to {LARGEST_NUMBER:g}"
        )
    return numbers


def positive(numbers: FloatArray, name: str) -> FloatArray:
    """Return ``numbers`` (...); raises `DamagedError` if one is not above zero."""
    if not (finite(numbers, name) > 0).all():
        raise DamagedError(f"it gives {_shown(numbers)} as its {name}, expected numbers above 0")
    return numbers


def scaled(slope: float, intercept: float) -> tuple[float, float]:
    """Return the scale of the values; raises `DamagedError` if it is not finite, zero, or no scanner's."""
    finite(np.array([slope, intercept]), "scale of the values")
    if not are_hu(np.array([slope, intercept])):
        raise DamagedError(f"it scales its values by {slope:g} and {intercept:g}, which cannot be right")
    if slope == 0.0:
        raise DamagedError("it scales its values by 0")
    return slope, intercept


def refuse_uneven(text: str | None) -> None:
    """Raise `DamagedError` if ``text``, the value of `UNEVEN_MM`, tells of slices that lie elsewhere."""
    (apart_mm,) = decimals(text or "0", 1, UNEVEN_MM)
    if apart_mm > AFFINE_TOLERANCE_MM:
        raise DamagedError(
            f"ITK made it of slices that are missing or unevenly spaced, off by up to {apart_mm:.3g} mm; use the "
            "series itself"
        )


def beside(header: Path, name: str) -> Path:
    """Return the path of the data file that a header names, which counts from the header's folder."""
    if not name or "\0" in name:
        raise DamagedError("it does not name the file of its voxels")
    return Path(os.fspath(header.parent)) / name


def _shown(numbers: FloatArray) -> str:
    return f"'{' '.join(f'{number:g}' for number in numbers)}'"
