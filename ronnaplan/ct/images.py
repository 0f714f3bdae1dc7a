"""NIfTI, NRRD and MetaImage files, read by SimpleITK, which brings them to LPS.

These formats keep one affine map for the whole volume and no frame of reference. A file that gives no
orientation, or two that disagree, is refused: SimpleITK would choose silently.
"""

from __future__ import annotations

import gzip
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from ronnaplan.ct.limits import GIB, Limits
from ronnaplan.ct.orientation import META_SUFFIXES, NIFTI_SUFFIXES, NRRD_SUFFIXES, check_orientation
from ronnaplan.ct.pixels import INT16, Voxels
from ronnaplan.ct.volume import CTVolume, SeriesSource, SliceGrid, VolumeFlag
from ronnaplan.errors import InputError
from ronnaplan.geometry import FloatArray
from ronnaplan.text import printable

PERPENDICULAR_TOLERANCE: Final = 1e-4
"""Largest cosine between rows and columns that still counts as perpendicular."""


def is_image_file(path: Path) -> bool:
    """Whether the name is that of a NIfTI, NRRD or MetaImage file."""
    return path.name.lower().endswith(NIFTI_SUFFIXES + NRRD_SUFFIXES + META_SUFFIXES)


@dataclass(frozen=True)
class ImageFile:
    """An image file's header: ``shape`` (K, J, I) and the grid of its voxels; ``k_flips`` if it runs downwards.

    ``least_bytes`` is what the file must hold, unpacked, as far as its header tells.
    """

    path: Path
    shape: tuple[int, int, int]
    grid: SliceGrid
    k_flips: bool
    least_bytes: int


def open_image(path: Path) -> ImageFile:
    """Read the header of an image file; raises `InputError` if it does not place its voxels unmistakably."""
    reader = _reader(path)
    try:
        reader.ReadImageInformation()
    except RuntimeError as error:
        raise InputError(f"{printable(path)} is not a readable image file ({_reason(error)})") from error
    if reader.GetDimension() != 3 or reader.GetNumberOfComponents() != 1:
        raise InputError(
            f"{printable(path)} has {reader.GetDimension()} dimensions and {reader.GetNumberOfComponents()} "
            "values a voxel; expected 3 and 1"
        )
    columns, rows, count = reader.GetSize()
    if min(columns, rows, count) < 2:
        raise InputError(
            f"{printable(path)} has {columns} x {rows} x {count} voxels; expected two or more each way"
        )
    steps = np.array(reader.GetDirection()).reshape(3, 3) * np.array(reader.GetSpacing())
    affine = np.eye(4)
    affine[:3, :3], affine[:3, 3] = steps, reader.GetOrigin()
    check_orientation(path, reader, affine)
    grid, k_flips = _grid(path, affine, count)
    return ImageFile(path, (count, rows, columns), grid, k_flips, _least_bytes(reader, count * rows * columns))


def read_image(path: Path, limits: Limits) -> CTVolume:
    """Read an image file whose values are HU; raises `InputError`."""
    header = open_image(path)
    needed = int(np.prod(header.shape, dtype=object)) * np.dtype(np.float32).itemsize
    if needed > limits.volume_bytes:
        raise InputError(
            f"{printable(path)} declares {needed / GIB:.1f} GiB of voxels but the limit is "
            f"{limits.volume_bytes / GIB:.1f} GiB; raise the limit if you trust it"
        )
    _check_length(header)
    return CTVolume(
        voxels_hu=_voxels(header),
        grid=header.grid,
        source=SeriesSource(description=printable(path.name)),
        flags=(VolumeFlag.NO_FRAME_OF_REFERENCE,),
    )


def _simple_itk() -> Any:
    import SimpleITK

    return SimpleITK


def _reader(path: Path) -> Any:
    itk = _simple_itk()
    itk.ProcessObject.SetGlobalWarningDisplay(False)
    reader = itk.ImageFileReader()
    reader.SetFileName(str(path))
    return reader


def _least_bytes(reader: Any, voxels: int) -> int:
    if not reader.HasMetaDataKey("vox_offset"):
        return 0  # NRRD and MetaImage: SimpleITK itself notices
    offset = float(reader.GetMetaData("vox_offset"))
    return int(min(max(offset, 0.0), 1e15)) + voxels * int(reader.GetMetaData("bitpix")) // 8


def _reason(error: RuntimeError) -> str:
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return printable(lines[-1]) if lines else "no reason given"


def _voxels(header: ImageFile) -> Voxels:
    try:
        image = _reader(header.path).Execute()
    except (RuntimeError, MemoryError) as error:
        raise InputError(f"{printable(header.path)} cannot be read to its end; copy it again") from error
    stored = _simple_itk().GetArrayViewFromImage(image)
    dtype: Any = np.int16 if all(_fits_int16(plane) for plane in stored) else np.float32
    voxels: Voxels = np.empty(header.shape, dtype)
    for k, plane in enumerate(stored[::-1] if header.k_flips else stored):
        if not np.isfinite(plane).all():
            raise InputError(
                f"{printable(header.path)} holds values that are not finite numbers; convert it again"
            )
        voxels[k] = plane
    return voxels


def _fits_int16(plane: Any) -> bool:
    if plane.dtype == np.int16:
        return True
    if not (INT16.min <= plane.min() and plane.max() <= INT16.max):
        return False
    return bool(plane.dtype.kind in "iu" or (plane == np.rint(plane)).all())


def _grid(path: Path, affine: FloatArray, count: int) -> tuple[SliceGrid, bool]:
    column_step, row_step, slice_step = affine[:3, 0], affine[:3, 1], affine[:3, 2]
    lengths = [float(np.linalg.norm(step)) for step in (column_step, row_step, slice_step)]
    if not np.isfinite(affine).all() or min(lengths) <= 0.0:
        raise InputError(f"{printable(path)} has no usable spacing {lengths}; convert it again")
    if abs(column_step @ row_step) > PERPENDICULAR_TOLERANCE * lengths[0] * lengths[1]:
        raise InputError(
            f"{printable(path)} has rows and columns that are not perpendicular; convert it without shear"
        )
    along = float(slice_step @ np.cross(column_step, row_step)) / (lengths[0] * lengths[1])
    if abs(along) < 0.1 * lengths[2]:
        raise InputError(f"{printable(path)} has slices that do not stack; convert it again")
    numbers = np.arange(count, dtype=np.float64)
    origins = affine[:3, 3] + numbers[:: -1 if along < 0 else 1, np.newaxis] * slice_step
    return SliceGrid(origins, row_step, column_step), along < 0


def _check_length(header: ImageFile) -> None:
    """Refuse a NIfTI that holds fewer voxels than it declares: SimpleITK would read zeros in their place."""
    path, needed = header.path, header.least_bytes
    try:
        if path.name.lower().endswith(".gz"):
            with gzip.open(path) as stream:
                stream.seek(max(0, needed - 1))
                is_whole = len(stream.read(1)) == 1
        else:
            is_whole = path.stat().st_size >= needed
    except (OSError, EOFError, zlib.error):
        is_whole = False
    if not is_whole:
        raise InputError(f"{printable(path)} cannot be read to its end; copy it again")
