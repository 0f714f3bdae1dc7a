"""How NIfTI, NRRD and MetaImage headers say that voxels lie in the patient.

SimpleITK reads these headers too, but silently picks one of two contradicting maps, drops a shear, and takes
the identity where a line is damaged; so what it made of a header is compared with what the header says.
"""

from __future__ import annotations

import gzip
import re
import struct
import zlib
from pathlib import Path
from typing import Any, Final

import numpy as np

from ronnaplan.errors import InputError
from ronnaplan.geometry import FloatArray
from ronnaplan.text import printable

NIFTI_SUFFIXES: Final = (".nii", ".nii.gz")
NRRD_SUFFIXES: Final = (".nrrd", ".nhdr")
META_SUFFIXES: Final = (".mha", ".mhd")
AFFINE_TOLERANCE_MM: Final = 0.01
"""Two ways to place the same voxel may differ by this much (NIfTI keeps float32)."""
_TEXT_HEADER_BYTES: Final = 8192
_NIFTI1_PIXDIM: Final = 76
_NIFTI2_PIXDIM: Final = 104
_NIFTI2_HEADER_SIZE: Final = 540
_NIFTI_MILLIMETRES: Final = frozenset({0, 2})
_LPS_FROM_RAS: Final = np.diag([-1.0, -1.0, 1.0, 1.0])
_NRRD_SPACES: Final = {
    "left-posterior-superior": (1.0, 1.0, 1.0, 1.0),
    "right-anterior-superior": (-1.0, -1.0, 1.0, 1.0),
    "left-anterior-superior": (1.0, -1.0, 1.0, 1.0),
    "lps": (1.0, 1.0, 1.0, 1.0),
    "ras": (-1.0, -1.0, 1.0, 1.0),
    "las": (1.0, -1.0, 1.0, 1.0),
}
_META_KEYS: Final = (
    ("TransformMatrix", "Rotation", "Orientation"),
    ("Offset", "Position", "Origin"),
    ("ElementSpacing",),
)


def check_orientation(path: Path, reader: Any, lps_from_index: FloatArray) -> None:
    """Refuse a file whose header does not say that index (i, j, k) lies at ``lps_from_index`` (4, 4)."""
    name = path.name.lower()
    if name.endswith(NIFTI_SUFFIXES):
        declared = _of_nifti(path, reader)
    elif name.endswith(NRRD_SUFFIXES):
        declared = [_of_nrrd(path)]
    else:
        declared = [_of_meta(path)]
    columns, rows, count = reader.GetSize()
    corners = np.array([[i, j, k, 1.0] for i in (0, columns) for j in (0, rows) for k in (0, count)])
    for affine in declared:
        apart = float(np.abs(corners @ (affine - lps_from_index).T).max())
        if not apart <= AFFINE_TOLERANCE_MM:
            raise InputError(
                f"{printable(path)} places its voxels in two ways, {apart:.3g} mm apart "
                "(a shear, or two orientations that disagree); convert it with one orientation"
            )


def _of_nifti(path: Path, reader: Any) -> list[FloatArray]:
    """Return each map that the header declares (NIfTI-1 standard, methods 2 and 3)."""

    def numbers(*keys: str) -> list[float]:
        return [float(value) for key in keys for value in reader.GetMetaData(key).split()]

    units, qform, sform = (int(number) for number in numbers("xyzt_units", "qform_code", "sform_code"))
    if units & 7 not in _NIFTI_MILLIMETRES:
        raise InputError(f"{printable(path)} is not in millimetres; convert it")
    if qform <= 0 and sform <= 0:
        raise InputError(f"{printable(path)} gives no orientation (qform and sform codes are 0); convert it again")
    declared = []
    if sform > 0:
        rows = np.array(numbers("srow_x", "srow_y", "srow_z")).reshape(3, 4)
        declared.append(_LPS_FROM_RAS @ np.vstack([rows, [0.0, 0.0, 0.0, 1.0]]))
    if qform > 0:
        ras_from_index = _from_quaternion(
            np.array(numbers("quatern_b", "quatern_c", "quatern_d")),
            np.array(numbers("qoffset_x", "qoffset_y", "qoffset_z")),
            np.array(numbers("pixdim[1]", "pixdim[2]", "pixdim[3]")),
            _qfac(path),
        )
        declared.append(_LPS_FROM_RAS @ ras_from_index)
    return declared


def _qfac(path: Path) -> float:
    """Return pixdim[0], the handedness of the quaternion's frame, from the file: SimpleITK prints a wrong one.

    -1 is usual (dcm2niix writes it); anything but a negative number counts as 1, by the standard.
    """
    opener = gzip.open if path.name.lower().endswith(".gz") else open
    try:
        with opener(path, "rb") as stream:
            header = stream.read(_NIFTI2_PIXDIM + 8)
        order = "<" if header[:4] in (b"\x5c\x01\x00\x00", b"\x1c\x02\x00\x00") else ">"
        if struct.unpack_from(f"{order}i", header)[0] == _NIFTI2_HEADER_SIZE:
            (value,) = struct.unpack_from(f"{order}d", header, _NIFTI2_PIXDIM)
        else:
            (value,) = struct.unpack_from(f"{order}f", header, _NIFTI1_PIXDIM)
    except (OSError, EOFError, zlib.error, struct.error) as error:
        raise InputError(f"{printable(path)} has no readable NIfTI header; convert it again") from error
    return -1.0 if value < 0 else 1.0


def _from_quaternion(vector: FloatArray, offset: FloatArray, spacing: FloatArray, qfac: float) -> FloatArray:
    from scipy.spatial.transform import Rotation

    affine = np.full((4, 4), np.nan)  # agrees with nothing, should a number be none
    if np.isfinite([*vector, *offset, *spacing]).all():
        real = np.sqrt(max(0.0, 1.0 - float(vector @ vector)))
        affine = np.eye(4)
        affine[:3, :3] = Rotation.from_quat([*vector, real]).as_matrix() * spacing * [1.0, 1.0, qfac]
        affine[:3, 3] = offset
    return affine


def _of_nrrd(path: Path) -> FloatArray:
    fields = _fields(path, ":")
    space = fields.get("space", "none")
    if space.lower() not in _NRRD_SPACES:
        raise InputError(
            f"{printable(path)} gives the space '{printable(space)}'; expected left-posterior-superior"
        )
    vectors = re.findall(r"\(([^)]*)\)", fields.get("space directions", "") + fields.get("space origin", ""))
    try:
        affine = np.eye(4)
        affine[:3] = np.array([vector.split(",") for vector in vectors], dtype=np.float64).reshape(4, 3).T
    except ValueError as error:
        raise InputError(f"{printable(path)} gives no readable space directions and origin; convert it") from error
    return np.diag(_NRRD_SPACES[space.lower()]) @ affine


def _of_meta(path: Path) -> FloatArray:
    fields = _fields(path, "=")
    try:
        matrix, offset, spacing = (
            np.array(next(fields[key] for key in keys if key in fields).split(), dtype=np.float64)
            for keys in _META_KEYS
        )
        affine = np.eye(4)
        affine[:3] = np.column_stack([matrix.reshape(3, 3).T * spacing, offset])
    except (StopIteration, RuntimeError, ValueError) as error:
        names = ", ".join(keys[0] for keys in _META_KEYS)
        raise InputError(f"{printable(path)} gives no readable {names}; convert it again") from error
    return affine


def _fields(path: Path, separator: str) -> dict[str, str]:
    """Return the ``key: value`` or ``key = value`` lines before the first blank line."""
    with path.open("rb") as stream:
        header = stream.read(_TEXT_HEADER_BYTES).decode("latin-1").replace("\r\n", "\n")
    parted = (line.partition(separator) for line in header.split("\n\n", 1)[0].split("\n"))
    return {key.strip(): value.strip() for key, _, value in parted}
