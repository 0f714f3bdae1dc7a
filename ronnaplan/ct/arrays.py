"""What a scan is made of where no file tells it: an array of HU, and an affine."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ronnaplan.bounds import LARGEST_HU
from ronnaplan.ct.flags import Voxels
from ronnaplan.ct.limits import are_hu, fit_int16
from ronnaplan.errors import InputError, UsageError
from ronnaplan.geometry import FloatArray


def checked_voxels(voxels_hu: ArrayLike) -> Voxels:
    """Return voxels (K, J, I) as int16 where that is whole numbers that int16 holds, else as float32.

    Raises `UsageError` for what is no array of numbers of three axes, `InputError` for masked or impossible values.
    """
    voxels = np.asarray(voxels_hu)
    if voxels.ndim != 3 or voxels.dtype.kind not in "iuf" or not voxels.size:
        raise UsageError(
            f"voxels are {voxels.dtype} of shape {voxels.shape}; expected numbers (slices, rows, columns)"
        )
    if np.ma.is_masked(voxels_hu):
        raise InputError("voxels are masked; fill in what the scan has there")
    if not are_hu(voxels):
        raise InputError(f"voxels hold values that are not finite numbers up to {LARGEST_HU:g}; expected HU")
    return (
        voxels.astype(np.int16) if voxels.dtype.kind in "iu" and fit_int16(voxels) else voxels.astype(np.float32)
    )


def upwards(voxels_hu: Voxels, affine: FloatArray) -> tuple[Voxels, FloatArray]:
    """Return voxels (K, J, I) and their affine (4, 4) with the slices ascending along their normal, as on a grid."""
    if np.linalg.det(affine[:3, [2, 1, 0]]) < 0:
        last_mm = affine[:, 3] + (len(voxels_hu) - 1) * affine[:, 0]
        voxels_hu, affine = voxels_hu[::-1], np.column_stack([-affine[:, 0], *affine[:, 1:3].T, last_mm])
    as_read: Any = np.ascontiguousarray(voxels_hu)  # kernels are compiled for these
    return as_read, affine
