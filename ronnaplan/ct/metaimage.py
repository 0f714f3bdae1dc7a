"""The header of a MetaImage file (``.mha``, ``.mhd``), by the letter of its documentation (ITK's MetaIO)."""

from __future__ import annotations

import re
from pathlib import Path
from typing import BinaryIO, Final

import numpy as np

from ronnaplan.ct.files import DamagedError
from ronnaplan.ct.image_header import (
    UNEVEN_MM,
    Encoding,
    ImageHeader,
    StoredVoxels,
    beside,
    decimals,
    field_name,
    header_lines,
    positive,
    refuse_uneven,
    scaled,
    whole,
)
from ronnaplan.ct.limits import Limits
from ronnaplan.geometry import FloatArray
from ronnaplan.text import printable

UNIT_TOLERANCE: Final = 1e-4
"""Directions whose length differs from 1 by more would scale the voxels beside their spacing."""
_SYNONYMS: Final = {
    **{"Position": "Offset", "Origin": "Offset"},
    **{"Orientation": "TransformMatrix", "Rotation": "TransformMatrix"},
    "ElementByteOrderMSB": "BinaryDataByteOrderMSB",
}
_TYPES: Final = {
    **{
        "MET_CHAR": "i1",
        "MET_UCHAR": "u1",
        "MET_SHORT": "i2",
        "MET_USHORT": "u2",
        "MET_INT": "i4",
        "MET_UINT": "u4",
    },
    **{"MET_LONG_LONG": "i8", "MET_ULONG_LONG": "u8", "MET_FLOAT": "f4", "MET_DOUBLE": "f8"},
}
"""``MET_LONG`` is missing: its size depends on the machine that wrote it."""
_EXPECTED: Final = {
    "ObjectType": ("Image",),
    "TransformType": ("Rigid", "Affine"),
    "DistanceUnits": ("mm", "?"),
    "Modality": ("MET_MOD_CT", "MET_MOD_MR", "MET_MOD_UNKNOWN"),
    "BinaryData": ("True",),
    "HeaderSizePerSlice": ("0",),
    "ElementNumberOfChannels": ("1",),
}
"""Fields that may be absent, but where they stand must hold one of these."""
SLOPE: Final = "ElementToIntensityFunctionSlope"
OFFSET: Final = "ElementToIntensityFunctionOffset"
_HEARD: Final = (
    *(
        *_SYNONYMS,
        *_SYNONYMS.values(),
        *_EXPECTED,
        SLOPE,
        OFFSET,
        "NDims",
        "DimSize",
        "ElementType",
        "ElementSpacing",
    ),
    *("CenterOfRotation", "CompressedData", "HeaderSize", "ElementDataFile"),
)
_SPELLED: Final = {name.lower(): name for name in _HEARD}
"""MetaIO knows a field by its very letters and passes over any other, which people may yet mean to be heard."""


def meta_header(path: Path, stream: BinaryIO, limits: Limits) -> ImageHeader:
    """Read a header, leaving ``stream`` behind it; raises `DamagedError`."""
    fields = _fields(header_lines(stream, limits))
    (dimensions,) = whole(_given(fields, "NDims"), 1, "NDims")
    if dimensions != 3:
        raise DamagedError(f"it has {dimensions} dimensions, expected 3")
    for name, wanted in _EXPECTED.items():
        if fields.get(name, wanted[0]) not in wanted:
            raise DamagedError(f"its {name} is '{printable(fields[name], 60)}', expected {wanted[0]}")
    refuse_uneven(fields.get(UNEVEN_MM))
    columns, rows, count = whole(_given(fields, "DimSize"), 3, "DimSize")
    (slope,) = decimals(fields.get(SLOPE, "1"), 1, SLOPE)
    (offset,) = decimals(fields.get(OFFSET, "0"), 1, OFFSET)
    return ImageHeader(
        (count, rows, columns),
        _dtype(fields),
        _lps_from_index(fields),
        _stored(path, fields, stream.tell()),
        *scaled(float(slope), float(offset)),
        modality="MR" if fields.get("Modality") == "MET_MOD_MR" else "CT",
    )


def _fields(lines: list[str]) -> dict[str, str]:
    """Return the fields by their name, synonyms as one; refuses two that disagree, and a name in other capitals."""
    fields: dict[str, str] = {}
    for line in lines:
        key, separator, value = line.partition("=")
        if not separator:
            raise DamagedError(f"its header has the line '{printable(line, 60)}', expected 'Key = Value'")
        written = field_name(key)
        if written != _SPELLED.get(written.lower(), written):
            raise DamagedError(f"its header has the field {written}, expected {_SPELLED[written.lower()]}")
        name = _SYNONYMS.get(written, written)
        value = value.strip(" \t")
        if name != "ElementDataFile":
            value = re.sub(r"[ \t]+", " ", value)
        if fields.setdefault(name, value) != value:
            raise DamagedError(
                f"it gives two values for {printable(written, 60)} (or a synonym): "
                f"'{printable(fields[name], 60)}' and '{printable(value, 60)}'"
            )
    return fields


def _given(fields: dict[str, str], name: str) -> str:
    if name not in fields:
        raise DamagedError(f"it gives no readable {name}; convert it again")
    return fields[name]


def _is_true(fields: dict[str, str], name: str, otherwise: str | None) -> bool:
    """Return a truth value as MetaIO writes it."""
    value = fields.get(name, otherwise)
    if value not in ("True", "False"):
        raise DamagedError(f"it gives '{printable(value, 60)}' as its {name}, expected True or False")
    return value == "True"


def _dtype(fields: dict[str, str]) -> np.dtype[np.generic]:
    kind = _given(fields, "ElementType")
    if kind not in _TYPES:
        raise DamagedError(f"its ElementType is '{printable(kind, 60)}', expected a number type of known size")
    if _TYPES[kind].endswith("1"):
        return np.dtype(_TYPES[kind])
    return np.dtype((">" if _is_true(fields, "BinaryDataByteOrderMSB", None) else "<") + _TYPES[kind])


def _lps_from_index(fields: dict[str, str]) -> FloatArray:
    """Return the affine map; the rows of ``TransformMatrix`` are the directions of the axes.

    ``AnatomicalOrientation`` is not heard: its letters mean where an axis comes from to some writers, and where it
    leads to others.
    """
    directions = decimals(_given(fields, "TransformMatrix"), 9, "TransformMatrix").reshape(3, 3).T
    if float(np.abs(np.linalg.norm(directions, axis=0) - 1.0).max()) > UNIT_TOLERANCE:
        raise DamagedError("its TransformMatrix holds directions that are not of length 1; convert it again")
    if decimals(fields.get("CenterOfRotation", "0 0 0"), 3, "CenterOfRotation").any():
        raise DamagedError("its CenterOfRotation is not 0, which readers take in two ways; convert it again")
    affine = np.eye(4)
    affine[:3, :3] = directions * positive(
        decimals(_given(fields, "ElementSpacing"), 3, "ElementSpacing"), "ElementSpacing"
    )
    affine[:3, 3] = decimals(_given(fields, "Offset"), 3, "Offset")
    return affine


def _stored(path: Path, fields: dict[str, str], header_bytes: int) -> StoredVoxels:
    encoding: Encoding = "zlib" if _is_true(fields, "CompressedData", "False") else "raw"
    (skip,) = whole(fields.get("HeaderSize", "0"), 1, "HeaderSize")
    if skip < -1 or (skip and encoding != "raw"):
        raise DamagedError(f"it skips {skip} bytes of {encoding} data (HeaderSize); convert it again")
    name = _given(fields, "ElementDataFile")
    if name == "LOCAL":
        return StoredVoxels(path, None if skip == -1 else header_bytes + skip, encoding)
    if re.match(r"LIST\b", name) or "%" in name:
        raise DamagedError("its voxels are in several files; convert it to one file")
    return StoredVoxels(beside(path, name), None if skip == -1 else skip, encoding)
