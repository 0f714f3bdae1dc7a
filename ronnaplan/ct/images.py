"""NIfTI, NRRD and MetaImage files: one affine map for the whole volume, and no frame of reference.

Their headers are believed by the letter of each format, or refused: a file that gives no orientation or two that
disagree, other units than mm, or values other than HU.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Final

import numpy as np

from ronnaplan.ct.files import DamagedError, open_regular
from ronnaplan.ct.grid import SliceGrid, require_grid
from ronnaplan.ct.image_header import ImageHeader, StoredVoxels
from ronnaplan.ct.image_voxels import UNPACKING_ERRORS, read_voxels, unpacked
from ronnaplan.ct.limits import GIB, Limits
from ronnaplan.ct.metaimage import meta_header
from ronnaplan.ct.nifti import nifti_header
from ronnaplan.ct.nrrd import nrrd_header
from ronnaplan.ct.slices import CT_ONLY
from ronnaplan.ct.volume import CTVolume, SeriesSource, VolumeFlag
from ronnaplan.errors import InputError
from ronnaplan.geometry import FloatArray
from ronnaplan.text import printable

_READERS: Final[dict[str, Callable[[Path, BinaryIO, Limits], ImageHeader]]] = {
    ".nii": nifti_header,
    ".nii.gz": nifti_header,
    ".nrrd": nrrd_header,
    ".nhdr": nrrd_header,
    ".mha": meta_header,
    ".mhd": meta_header,
}


def is_image_file(path: Path) -> bool:
    """Whether the name is that of a NIfTI, NRRD or MetaImage file."""
    return path.name.lower().endswith(tuple(_READERS))


@dataclass(frozen=True)
class ImageFile:
    """An image file that can be read: its header, and the grid of its voxels; ``k_flips`` if it runs downwards."""

    path: Path
    header: ImageHeader
    grid: SliceGrid
    k_flips: bool

    @property
    def shape(self) -> tuple[int, int, int]:
        """Slices, rows and columns."""
        return self.header.shape

    @property
    def flags(self) -> tuple[VolumeFlag, ...]:
        """Reasons to doubt where its voxels lie."""
        sheared = (VolumeFlag.SHEARED,) if self.grid.is_sheared else ()
        return (VolumeFlag.NO_FRAME_OF_REFERENCE, *sheared)


def open_image(path: Path, limits: Limits, modalities: Collection[str] = tuple(CT_ONLY)) -> ImageFile:
    """Read the header of an image file of one of ``modalities``; raises `InputError` for what it leaves open."""
    try:
        header = _header(path, limits)
        if header.modality not in modalities:
            wanted = " or ".join(modalities)
            raise DamagedError(
                f"its modality is {printable(header.modality, 60)}, not {wanted}; give a scan that is {wanted}"
            )
        _check_size(header.shape, limits)
        grid, k_flips = _grid(header.lps_from_index, header.shape[0])
    except DamagedError as error:
        raise InputError(f"{printable(path)} cannot be used: {error.with_remedy('convert it again')}") from error
    return ImageFile(path, header, grid, k_flips)


def read_image(path: Path, limits: Limits, modalities: Collection[str] = tuple(CT_ONLY)) -> CTVolume:
    """Read an image file, of a CT one whose values are HU; raises `InputError`."""
    image = open_image(path, limits, modalities)
    try:
        voxels = read_voxels(image.header, k_flips=image.k_flips)
    except DamagedError as error:
        raise InputError(f"{printable(path)} cannot be used: {error.with_remedy('convert it again')}") from error
    return CTVolume(
        voxels_hu=voxels,
        grid=image.grid,
        source=SeriesSource(description=printable(path.name), modality=image.header.modality),
        flags=image.flags,
    )


def _header(path: Path, limits: Limits) -> ImageHeader:
    name = path.name.lower()
    read = next(reader for suffix, reader in _READERS.items() if name.endswith(suffix))
    try:
        with open_regular(path) as file:
            stream = unpacked(file, StoredVoxels(path, 0, "gzip")) if name.endswith(".gz") else file
            return read(path, stream, limits)
    except UNPACKING_ERRORS as error:
        raise DamagedError("it is not a readable image file; copy it again") from error


def _check_size(shape: tuple[int, int, int], limits: Limits) -> None:
    count, rows, columns = shape
    if min(shape) < 2:
        raise DamagedError(
            f"it has {columns} x {rows} x {count} voxels, expected two or more each way; give the whole scan"
        )
    needed = count * rows * columns * np.dtype(np.float32).itemsize
    if needed > limits.volume_bytes:
        raise DamagedError(
            f"it declares {needed / GIB:.1f} GiB of voxels but the limit is {limits.volume_bytes / GIB:.1f} GiB; "
            "raise the limit if you trust it"
        )


def _grid(lps_from_index: FloatArray, count: int) -> tuple[SliceGrid, bool]:
    try:
        require_grid(lps_from_index[:, [2, 1, 0, 3]])
    except InputError as error:
        raise DamagedError(str(error)) from error
    column_step, row_step, slice_step, origin = lps_from_index[:3].T
    along = float(slice_step @ np.cross(column_step, row_step))
    numbers = np.arange(count, dtype=np.float64)
    origins = origin + numbers[:: -1 if along < 0 else 1, np.newaxis] * slice_step
    return SliceGrid(origins, row_step, column_step), along < 0
