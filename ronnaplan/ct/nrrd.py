"""The header of an NRRD file (``.nrrd``, ``.nhdr``), by the letter of its format definition (Teem)."""

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
    refuse_uneven,
    whole,
)
from ronnaplan.ct.limits import Limits
from ronnaplan.geometry import FloatArray
from ronnaplan.text import printable

_LPS_FROM: Final = {
    "left-posterior-superior": (1.0, 1.0, 1.0),
    "right-anterior-superior": (-1.0, -1.0, 1.0),
    "left-anterior-superior": (1.0, -1.0, 1.0),
    "lps": (1.0, 1.0, 1.0),
    "ras": (-1.0, -1.0, 1.0),
    "las": (1.0, -1.0, 1.0),
}
_TYPES: Final = {
    name: kind
    for kind, names in {
        "i1": ("signed char", "int8", "int8_t"),
        "u1": ("uchar", "unsigned char", "uint8", "uint8_t"),
        "i2": ("short", "short int", "signed short", "signed short int", "int16", "int16_t"),
        "u2": ("ushort", "unsigned short", "unsigned short int", "uint16", "uint16_t"),
        "i4": ("int", "signed int", "int32", "int32_t"),
        "u4": ("uint", "unsigned int", "uint32", "uint32_t"),
        "i8": ("longlong", "long long", "long long int", "signed long long", "int64", "int64_t"),
        "u8": ("ulonglong", "unsigned long long", "unsigned long long int", "uint64", "uint64_t"),
        "f4": ("float",),
        "f8": ("double",),
    }.items()
    for name in names
}
_ENCODINGS: Final[dict[str, Encoding]] = {
    "raw": "raw",
    "gzip": "gzip",
    "gz": "gzip",
    "bzip2": "bzip2",
    "bz2": "bzip2",
}
_ORDERS: Final = {"little": "<", "big": ">"}
_FIELDS: Final = frozenset(
    {
        *("content", "number", "type", "block size", "dimension", "space", "space dimension", "sizes", "spacings"),
        *(
            "thicknesses",
            "axis mins",
            "axis maxs",
            "centers",
            "centerings",
            "labels",
            "units",
            "kinds",
            "min",
            "max",
        ),
        *("old min", "old max", "data file", "endian", "encoding", "line skip", "byte skip", "sample units"),
        *("space units", "space origin", "space directions", "measurement frame"),
    }
)
"""All that the format knows; what a person adds has a ``:=``."""
_SPACED: Final = {
    name.replace(" ", ""): name
    for name in (
        *("block size", "axis mins", "axis maxs", "old min", "old max"),
        *("data file", "line skip", "byte skip", "sample units"),
    )
}
"""These may be written as one word."""
_BESIDE_DIRECTIONS: Final = {
    **dict.fromkeys(("spacings", "axis mins", "axis maxs"), frozenset({"nan"})),
    "units": frozenset({'"mm"', '""', "???", "none"}),
}
"""Per-axis fields that the format forbids beside ``space directions``, as they would place the samples again -> values
that do not."""
_MODALITIES: Final = ("modality:=", "dicom_0008_0060_modality:=")
"""Keys, in small letters, under which Slicer and dcm2niix tell what made an image."""
_SPATIAL: Final = frozenset({"domain", "space", "none", "???"})
"""Kinds of an axis along which samples lie in space."""
_HU: Final = frozenset({"", "hu", "hounsfield", "hounsfield unit", "hounsfield units"})


def nrrd_header(path: Path, stream: BinaryIO, limits: Limits) -> ImageHeader:
    """Read a header, leaving ``stream`` behind it; raises `DamagedError`."""
    lines = header_lines(stream, limits)
    if not lines or not re.fullmatch(r"NRRD000[1-5]", lines[0]):
        raise DamagedError("it is not an NRRD file (it does not start with NRRD0001 to NRRD0005)")
    fields = _fields(lines[1:])
    _check_meaning(fields)
    (dimension,) = whole(_given(fields, "dimension"), 1, "dimension")
    if dimension != 3:
        kinds = fields.get("kinds", "").split()
        what = f" ({printable(' '.join(kinds), 60)})" if kinds else ""
        raise DamagedError(f"it has {dimension} dimensions{what}, expected 3")
    _check_axes(fields)
    columns, rows, count = whole(_given(fields, "sizes"), 3, "sizes")
    return ImageHeader(
        (count, rows, columns),
        _dtype(fields),
        _lps_from_index(fields),
        _stored(path, fields, stream.tell()),
        modality=next((fields[key].upper() for key in _MODALITIES if key in fields), "CT"),
    )


def _fields(lines: list[str]) -> dict[str, str]:
    """Return the fields, names in small letters; keys (``key:=value``) are kept with their ``:=``."""
    fields: dict[str, str] = {}
    for line in lines:
        if line.startswith("#"):
            continue
        key, separator, value = line.partition(":=") if ":=" in line else line.partition(":")
        if not separator:
            raise DamagedError(f"its header has the line '{printable(line, 60)}', expected 'field: value'")
        name = field_name(key).lower()
        if separator == ":":
            name = _SPACED.get(name, name)
            if name not in _FIELDS:
                raise DamagedError(f"it gives the field '{printable(name, 60)}', which the format does not know")
        else:
            name = f"{name}:="
        if name in fields:
            raise DamagedError(f"it gives '{printable(name, 60)}' twice")
        fields[name] = value.strip()
    return fields


def _given(fields: dict[str, str], name: str) -> str:
    if name not in fields:
        raise DamagedError(f"it gives no {name}; convert it again")
    return fields[name]


def _check_meaning(fields: dict[str, str]) -> None:
    """Refuse what says that the samples are no HU in millimetres."""
    refuse_uneven(fields.get(f"{UNEVEN_MM.lower()}:="))
    units = fields.get("space units", '"mm"' * 3)
    if not re.fullmatch(r'(\s*"mm"){3}\s*', units):
        raise DamagedError(f"its space units are '{printable(units, 60)}', expected \"mm\" three times")
    for name, harmless in _BESIDE_DIRECTIONS.items() if "space directions" in fields else ():
        if not harmless.issuperset(fields.get(name, "").lower().split()):
            raise DamagedError(f"it gives '{name}' beside its space directions, which the format forbids")
    values = fields.get("sample units", "").strip('" ')
    if values.lower() not in _HU:
        raise DamagedError(f"its values are in '{printable(values, 60)}', not in Hounsfield units (HU)")
    for name in ("old min", "old max"):
        if fields.get(name, "nan").lower() != "nan":
            raise DamagedError(f"its values were quantized ('{name}'), so they are not Hounsfield units")


def _check_axes(fields: dict[str, str]) -> None:
    """Refuse axes that do not run through space."""
    others = [kind for kind in fields.get("kinds", "").split() if kind.lower() not in _SPATIAL]
    if others:
        raise DamagedError(f"its samples along an axis are '{printable(others[0], 60)}', not places in space")
    if fields.get("space dimension", "3") != "3":
        raise DamagedError(f"its space has '{printable(fields['space dimension'], 60)}' dimensions, expected 3")


def _dtype(fields: dict[str, str]) -> np.dtype[np.generic]:
    kind = _given(fields, "type").lower()
    if kind not in _TYPES:
        raise DamagedError(f"its type is '{printable(kind, 60)}', expected a number type")
    if _TYPES[kind].endswith("1"):
        return np.dtype(_TYPES[kind])
    order = _given(fields, "endian").lower()
    if order not in _ORDERS:
        raise DamagedError(f"its endian is '{printable(order, 60)}', expected little or big")
    return np.dtype(_ORDERS[order] + _TYPES[kind])


def _lps_from_index(fields: dict[str, str]) -> FloatArray:
    space = fields.get("space", "none")
    if space.lower() not in _LPS_FROM:
        raise DamagedError(f"it gives the space '{printable(space, 60)}', expected left-posterior-superior")
    affine = np.eye(4)
    affine[:3, :3] = _vectors(_given(fields, "space directions"), 3, "space directions").T
    affine[:3, 3] = _vectors(_given(fields, "space origin"), 1, "space origin")[0]
    lps: FloatArray = np.diag([*_LPS_FROM[space.lower()], 1.0]) @ affine
    return lps


def _vectors(text: str, count: int, name: str) -> FloatArray:
    """Return ``count`` vectors (x,y,z) as rows."""
    found = re.fullmatch(r"\s*\(([^(),]*),([^(),]*),([^(),]*)\)\s*" * count, text)
    if found is None:
        raise DamagedError(f"it gives '{printable(text, 60)}' as its {name}, expected {count} of (x,y,z)")
    return np.array([decimals(number, 1, name)[0] for number in found.groups()]).reshape(count, 3)


def _stored(path: Path, fields: dict[str, str], header_bytes: int) -> StoredVoxels:
    encoding = _given(fields, "encoding").lower()
    if encoding not in _ENCODINGS:
        raise DamagedError(f"its encoding is '{printable(encoding, 60)}', expected raw, gzip or bzip2")
    (lines,) = whole(fields.get("line skip", "0"), 1, "line skip")
    (skip,) = whole(fields.get("byte skip", "0"), 1, "byte skip")
    if lines or skip < -1 or (skip and _ENCODINGS[encoding] != "raw"):
        raise DamagedError(
            f"it skips {lines} lines and {skip} bytes of {encoding} data; convert it to one plain file"
        )
    start = None if skip == -1 else skip
    if "data file" not in fields:
        return StoredVoxels(path, None if start is None else header_bytes + start, _ENCODINGS[encoding])
    name = fields["data file"]
    if re.match(r"LIST\b", name) or "%" in name:
        raise DamagedError("its voxels are in several files; convert it to one file")
    return StoredVoxels(beside(path, name), start, _ENCODINGS[encoding])
