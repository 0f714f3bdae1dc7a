"""Values on a regular grid as other libraries hold them, and back: each says by itself where its voxels are.

An ``affine`` (4, 4) maps voxel indices (k, j, i, 1) = (slice, row, column) to LPS mm, for values (K, J, I).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ronnaplan.errors import InputError, UsageError
from ronnaplan.extras import library_of_arrays
from ronnaplan.geometry import LPS_FROM_RAS, FloatArray

Values = NDArray[Any]

LARGEST_SHEAR = 1e-4
"""Cosine between two directions of a grid that other libraries still take for a right angle (0.006 degrees)."""


def from_sitk(image: Any) -> tuple[Values, FloatArray]:
    """Return values (K, J, I) and affine (4, 4) of a three-dimensional SimpleITK image of one value a voxel."""
    import SimpleITK as sitk

    if not isinstance(image, sitk.Image):
        raise UsageError(f"{type(image).__name__} is no SimpleITK.Image; give one, or use read_ct for a file")
    if image.GetDimension() != 3 or image.GetNumberOfComponentsPerPixel() != 1:
        raise InputError(
            f"the image has {image.GetDimension()} dimensions and {image.GetNumberOfComponentsPerPixel()} values a "
            "voxel; expected 3 and 1"
        )
    affine = np.eye(4)
    columns = np.array(image.GetDirection()).reshape(3, 3) * image.GetSpacing()
    affine[:3, :3] = columns[:, ::-1]
    affine[:3, 3] = image.GetOrigin()
    return sitk.GetArrayFromImage(image), affine


def to_sitk(values: Values, affine: FloatArray) -> Any:
    """Return a SimpleITK image; raises `InputError` for a sheared grid (a tilted gantry), which it cannot hold."""
    import SimpleITK as sitk

    spacing_mm, directions = _orthogonal(affine)
    image = sitk.GetImageFromArray(np.ascontiguousarray(values))
    image.SetSpacing(spacing_mm[::-1].tolist())
    image.SetOrigin(affine[:3, 3].tolist())
    image.SetDirection(directions[:, ::-1].ravel().tolist())
    return image


def to_nibabel(values: Values, affine: FloatArray) -> Any:
    """Return a nibabel NIfTI-1 image, (i, j, k) in RAS mm as that library has it; needs nibabel."""
    nibabel = library_of_arrays("nibabel")
    of_ijk = affine[:, [2, 1, 0, 3]]
    return nibabel.Nifti1Image(
        np.ascontiguousarray(values.transpose(2, 1, 0)), np.diag([*LPS_FROM_RAS, 1.0]) @ of_ijk
    )


def to_pyvista(values: Values, affine: FloatArray, name: str) -> Any:
    """Return a PyVista image of ``values`` (K, J, I), whose points are the voxels' centers in LPS mm; needs pyvista."""
    pyvista = library_of_arrays("pyvista")
    spacing_mm, directions = _orthogonal(affine)
    image = pyvista.ImageData(
        dimensions=values.shape[::-1],
        spacing=spacing_mm[::-1],
        origin=affine[:3, 3],
        direction_matrix=directions[:, ::-1],
    )
    image.point_data[name] = values.reshape(-1)
    return image


def to_xarray(values: Values, affine: FloatArray, name: str, unit: str) -> Any:
    """Return an xarray.DataArray over (k, j, i), the affine in its attributes; needs xarray."""
    attributes = {"units": unit, "coordinate_system": "LPS", "lps_from_kji": affine.tolist()}
    return library_of_arrays("xarray").DataArray(values, dims=("k", "j", "i"), name=name, attrs=attributes)


def _orthogonal(affine: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return spacings (3,) and directions (3, 3), by column, of k, j and i; `InputError` where they are oblique."""
    spacing_mm = np.linalg.norm(affine[:3, :3], axis=0)
    directions = affine[:3, :3] / spacing_mm
    if np.abs(directions.T @ directions - np.eye(3)).max() > LARGEST_SHEAR:
        raise InputError(
            "the slices are shifted against each other (a tilted gantry); expected a grid of right angles"
        )
    return spacing_mm, directions
