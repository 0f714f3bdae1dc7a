"""The header of a NIfTI-1 or NIfTI-2 file (``.nii``, ``.nii.gz``), by the letter of nifti1.h and nifti2.h."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, Final

import numpy as np

from ronnaplan.ct.files import DamagedError
from ronnaplan.ct.image_header import (
    AFFINE_TOLERANCE_MM,
    Encoding,
    ImageHeader,
    StoredVoxels,
    finite,
    positive,
    scaled,
)
from ronnaplan.ct.limits import Limits
from ronnaplan.geometry import LPS_FROM_RAS, FloatArray

QUATERNION_ROUNDING: Final = 2.0**-22
"""Of the sum of squares of three float32 numbers near 1: beyond 1 by more is no unit quaternion."""
_MILLIMETRES: Final = frozenset({0, 2})
"""Codes of ``xyzt_units``: unknown, which most CT converters of old wrote, and mm."""
_SPACES: Final = frozenset({0, 1, 2})
"""Codes of ``qform_code`` and ``sform_code``: none, the scanner's space, and a space aligned with another scan's."""
_PLAIN: Final = frozenset({0, 1001, 1002})
"""Codes of ``intent_code``: values as they are, an estimate, labels. Others are statistics, vectors, matrices."""
_TYPES: Final = {
    **{2: "u1", 256: "i1", 4: "i2", 512: "u2", 8: "i4", 768: "u4"},
    **{1024: "i8", 1280: "u8", 16: "f4", 64: "f8"},
}


@dataclass(frozen=True)
class _Layout:
    """Where the fields of one version are: name -> `struct` form and offset."""

    size: int
    magic: tuple[int, bytes]
    pair_magic: bytes
    fields: dict[str, tuple[str, int]]


_NIFTI1: Final = _Layout(
    348,
    (344, b"n+1\0"),
    b"ni1\0",
    {
        "dim": ("8h", 40),
        "intent_code": ("h", 68),
        "datatype": ("h", 70),
        "bitpix": ("h", 72),
        "pixdim": ("8f", 76),
        "vox_offset": ("f", 108),
        "scl": ("2f", 112),
        "xyzt_units": ("B", 123),
        "qform_code": ("h", 252),
        "sform_code": ("h", 254),
        "quatern": ("3f", 256),
        "qoffset": ("3f", 268),
        "srow": ("12f", 280),
    },
)
_NIFTI2: Final = _Layout(
    540,
    (4, b"n+2\0\r\n\x1a\n"),
    b"ni2\0\r\n\x1a\n",
    {
        "datatype": ("h", 12),
        "bitpix": ("h", 14),
        "dim": ("8q", 16),
        "pixdim": ("8d", 104),
        "vox_offset": ("q", 168),
        "scl": ("2d", 176),
        "qform_code": ("i", 344),
        "sform_code": ("i", 348),
        "quatern": ("3d", 352),
        "qoffset": ("3d", 376),
        "srow": ("12d", 400),
        "xyzt_units": ("i", 500),
        "intent_code": ("i", 504),
    },
)
_LAYOUTS: Final = {
    struct.pack(order + "i", layout.size): (order, layout) for layout in (_NIFTI1, _NIFTI2) for order in "<>"
}
_LONGEST_HEADER: Final = 540


def nifti_header(path: Path, stream: BinaryIO, limits: Limits) -> ImageHeader:
    """Read a header from the unpacked ``stream`` of ``path``; raises `DamagedError`."""
    content = stream.read(_LONGEST_HEADER)
    order, layout = _LAYOUTS.get(content[:4], ("", None))
    if layout is None or len(content) < layout.size:
        raise DamagedError("it is not a NIfTI file: its header is not of 348 or 540 bytes")
    at, magic = layout.magic
    if content[at : at + len(magic)] == layout.pair_magic:
        raise DamagedError("its voxels are in another file (.hdr and .img); convert it to one file")
    if content[at : at + len(magic)] != magic:
        raise DamagedError("it is not a NIfTI file: its magic number is wrong (ANALYZE has none)")
    fields = {name: struct.unpack_from(order + form, content, at) for name, (form, at) in layout.fields.items()}
    (offset,) = fields["vox_offset"]
    if not layout.size + 4 <= offset <= limits.header_bytes or offset != int(offset):
        raise DamagedError(f"its voxels start at byte {offset:g}, expected {layout.size + 4} or more")
    (intent,) = fields["intent_code"]
    if intent not in _PLAIN:
        raise DamagedError(
            f"its values have the intent {intent} (a statistic, vectors, ...), so they are no image's; give the scan "
            "itself"
        )
    slope, intercept = fields["scl"]
    if not np.isfinite(fields["scl"]).all():
        raise DamagedError(
            f"it gives '{slope:g} {intercept:g}' as its scale of the values, expected finite numbers"
        )
    if slope == 0.0:
        slope, intercept = 1.0, 0.0  # the standard: zero means that the values are not scaled
    shape = _shape(fields["dim"])
    encoding: Encoding = "gzip" if path.name.lower().endswith(".gz") else "raw"
    return ImageHeader(
        shape,
        _dtype(order, *fields["datatype"], *fields["bitpix"]),
        np.diag([*LPS_FROM_RAS, 1.0]) @ _ras_from_index(fields, shape),
        StoredVoxels(path, 0, encoding, skip=int(offset)),
        *scaled(slope, intercept),
    )


def _shape(dim: tuple[int, ...]) -> tuple[int, int, int]:
    count, sizes = dim[0], dim[1:]
    if not 1 <= count <= 7:
        raise DamagedError(f"it has {count} dimensions, expected 3")
    while count > 3 and sizes[count - 1] == 1:
        count -= 1
    if count != 3:
        raise DamagedError(f"it has {count} dimensions, expected 3")
    return sizes[2], sizes[1], sizes[0]


def _dtype(order: str, datatype: int, bits: int) -> np.dtype[np.generic]:
    if datatype not in _TYPES:
        raise DamagedError(
            f"its values are of the type {datatype} (colours, complex or unknown), expected numbers"
        )
    dtype = np.dtype(order + _TYPES[datatype])
    if bits != 8 * dtype.itemsize:
        raise DamagedError(f"its values take {bits} bits, but {8 * dtype.itemsize} by their type")
    return dtype


def _ras_from_index(fields: dict[str, tuple[Any, ...]], shape: tuple[int, int, int]) -> FloatArray:
    """Return the map of the header; refuses one in other units, of another space, or two that disagree."""
    (units,), (qform,), (sform,) = fields["xyzt_units"], fields["qform_code"], fields["sform_code"]
    if units & 7 not in _MILLIMETRES:
        raise DamagedError("it is not in millimetres; convert it")
    for code in (qform, sform):
        if code not in _SPACES:
            raise DamagedError(
                f"it is in the space {code} (an atlas, or unknown), expected the scanner's or patient's"
            )
    sizes = positive(np.array(fields["pixdim"][1:4], dtype=np.float64), "voxel sizes (pixdim)")
    if sform and qform:
        exact, (other, loose_rad) = _by_sform(fields, sizes, shape), _by_quaternion(fields, sizes)
        _require_agreement(exact, other, shape, loose_rad * float(np.linalg.norm(sizes * shape[::-1])))
        return exact
    if sform:
        return _by_sform(fields, sizes, shape)
    if qform:
        return _by_quaternion(fields, sizes)[0]
    raise DamagedError("it gives no orientation (qform and sform codes are 0); convert it again")


def _by_sform(fields: dict[str, tuple[Any, ...]], sizes: FloatArray, shape: tuple[int, int, int]) -> FloatArray:
    """Return the map of method 3 of the standard, whose steps must be of the voxels' sizes."""
    rows = finite(np.array(fields["srow"], dtype=np.float64), "sform").reshape(3, 4)
    steps = np.linalg.norm(rows[:, :3], axis=0)
    if float(np.abs((steps - sizes) * shape[::-1]).max()) > AFFINE_TOLERANCE_MM:
        raise DamagedError(
            f"its voxels are {_mm(sizes)} by pixdim and {_mm(steps)} by its sform; convert it again"
        )
    return np.vstack([rows, [0.0, 0.0, 0.0, 1.0]])


def _by_quaternion(fields: dict[str, tuple[Any, ...]], sizes: FloatArray) -> tuple[FloatArray, float]:
    """Return the map of method 2 of the standard, and how loose float32 leaves its angle (near half turns)."""
    from scipy.spatial.transform import Rotation

    vector = finite(np.array(fields["quatern"], dtype=np.float64), "quaternion")
    square = float(vector @ vector)
    if square > 1.0 + QUATERNION_ROUNDING:
        raise DamagedError(f"its quaternion is longer than 1 ({square**0.5:.3g}); convert it again")
    real = max(0.0, 1.0 - square) ** 0.5
    affine = np.eye(4)
    rotation = Rotation.from_quat([*vector, real]).as_matrix()
    affine[:3, :3] = rotation * sizes * [1.0, 1.0, _handedness(fields["pixdim"][0])]
    affine[:3, 3] = finite(np.array(fields["qoffset"], dtype=np.float64), "qform offset")
    return affine, 2.0 * min(QUATERNION_ROUNDING / max(real, 1e-30), QUATERNION_ROUNDING**0.5)


def _require_agreement(
    one: FloatArray, other: FloatArray, shape: tuple[int, int, int], looseness_mm: float
) -> None:
    corners = np.array([[i, j, k, 1.0] for k in (0, shape[0]) for j in (0, shape[1]) for i in (0, shape[2])])
    apart_mm = float(np.abs(corners @ (one - other).T).max())
    if not apart_mm <= AFFINE_TOLERANCE_MM + looseness_mm:
        raise DamagedError(
            f"it places its voxels in two ways, {apart_mm:.3g} mm apart (a shear, or two orientations that "
            "disagree); convert it with one orientation"
        )


def _handedness(qfac: float) -> float:
    """Return the sign of the third axis: pixdim[0], where the standard takes 0 for 1."""
    if qfac not in (-1.0, 0.0, 1.0):
        raise DamagedError(f"it gives {qfac:g} as its handedness (pixdim[0]), expected -1 or 1")
    return -1.0 if qfac < 0 else 1.0


def _mm(sizes: FloatArray) -> str:
    return " x ".join(f"{size:.4g}" for size in sizes) + " mm"
