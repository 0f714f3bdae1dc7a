"""Voxels and where each of them is in the patient.

A scan is a stack of parallel slices. Each slice has its own origin, so gantry tilt (origins that drift within
the slice plane) and uneven spacing are kept exactly as acquired; nothing is resampled.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ronnaplan.errors import InputError, UsageError
from ronnaplan.geometry import FloatArray, Frame, unit

UNIFORM_SPACING_TOLERANCE_MM = 1e-3
"""Slice gaps that differ by less than this are called equal (DICOM writes positions with 3 to 6 decimals)."""


SMALLEST_VOXEL_MM3 = 1e-9
"""No voxel is smaller."""


class VolumeFlag(StrEnum):
    """Reasons to doubt a volume; each value is the sentence shown to the user."""

    LOSSY = "the images were compressed with loss"
    UNEVEN_SPACING = "the slices are not evenly spaced"
    MISSING_SLICE = "one or more slices are missing"
    DUPLICATES_DROPPED = "identical copies of a slice were dropped"
    OVERLAPPING = "the slices overlap"
    TILT_CONTRADICTS = "the gantry tilt tag contradicts the slice positions"
    SHIFTED_SIDEWAYS = "slices are shifted sideways against each other"
    UNREADABLE_FILES = "some files beside the slices could not be read"
    NO_FRAME_OF_REFERENCE = "the file names no frame of reference"
    IMAGES_LEFT_OUT = "images of the same series that do not fit the others were left out"
    MIXED_VOLTAGE = "the tube voltage changes within the volume"
    OUT_OF_ORDER = "neighbouring slices were not taken one after another"
    DERIVED = "the images were computed from others"
    REFORMATTED = "the slices were resampled from others"
    VIRTUAL_VALUES = "the values are those of a material or of a virtual energy"


@dataclass(frozen=True)
class SliceGrid:
    """The places of the voxels of parallel slices, in LPS mm.

    ``origins_mm`` (K, 3) is the center of the voxel (row 0, column 0) of each slice, in ascending order along
    ``normal``. ``row_step_mm`` (3,) leads from one row to the next, ``column_step_mm`` (3,) from one column to
    the next. ``thickness_mm`` is the nominal slice thickness: physics for a model, never geometry.
    """

    origins_mm: FloatArray
    row_step_mm: FloatArray
    column_step_mm: FloatArray
    thickness_mm: float | None = None

    @cached_property
    def normal(self) -> FloatArray:
        """Unit normal (3,) of the slice planes, by DICOM's rule: column direction x row direction."""
        return unit(np.cross(self.column_step_mm, self.row_step_mm))

    @cached_property
    def axes(self) -> FloatArray:
        """Unit vectors u (along a row), v (down a column) and w (the normal) in LPS, as rows (3, 3)."""
        return np.stack(
            [self.column_step_mm / self.column_spacing_mm, self.row_step_mm / self.row_spacing_mm, self.normal]
        )

    @cached_property
    def slice_positions_mm(self) -> FloatArray:
        """Place (K,) of each slice along ``normal``."""
        return self.origins_mm @ self.normal

    @cached_property
    def spacings_mm(self) -> FloatArray:
        """Gaps (K - 1,) between neighbouring slices along ``normal``."""
        return np.diff(self.slice_positions_mm)

    @cached_property
    def typical_gap_mm(self) -> float:
        """The median gap between slices; of a single slice, the distance between its rows."""
        gaps = self.spacings_mm
        return float(np.median(gaps)) if gaps.size else self.row_spacing_mm

    @property
    def row_spacing_mm(self) -> float:
        """Distance between neighbouring rows."""
        return float(np.linalg.norm(self.row_step_mm))

    @property
    def column_spacing_mm(self) -> float:
        """Distance between neighbouring columns."""
        return float(np.linalg.norm(self.column_step_mm))

    @property
    def is_evenly_spaced(self) -> bool:
        """Whether all gaps agree within `UNIFORM_SPACING_TOLERANCE_MM`."""
        gaps = self.spacings_mm
        return bool(gaps.size == 0 or np.ptp(gaps) < UNIFORM_SPACING_TOLERANCE_MM)

    @property
    def affine(self) -> FloatArray:
        """The (4, 4) that maps voxel indices (k, j, i, 1) to LPS mm; `InputError` where no single one does."""
        steps_mm = np.diff(self.origins_mm, axis=0)
        if len(steps_mm) and np.ptp(steps_mm, axis=0).max() > UNIFORM_SPACING_TOLERANCE_MM:
            raise InputError(
                "the slices are not evenly spaced; expected a regular grid, as no affine holds another"
            )
        slice_step_mm = steps_mm.mean(axis=0) if len(steps_mm) else self.normal * self.row_spacing_mm
        affine = np.eye(4)
        affine[:3, :] = np.stack(
            [slice_step_mm, self.row_step_mm, self.column_step_mm, self.origins_mm[0]], axis=1
        )
        return affine

    @staticmethod
    def checked_affine(affine: ArrayLike) -> FloatArray:
        """Return an affine as an array (4, 4); raises `InputError` for what is none."""
        try:
            matrix = np.asarray(affine, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise InputError("the affine is not made of numbers; expected (4, 4)") from error
        if (
            matrix.shape != (4, 4)
            or not np.isfinite(matrix).all()
            or abs(np.linalg.det(matrix[:3, :3])) < SMALLEST_VOXEL_MM3
        ):
            raise InputError("the affine is no finite, invertible (4, 4) that maps (k, j, i, 1) to LPS mm")
        return matrix

    @classmethod
    def from_affine(cls, affine: ArrayLike, slices: int) -> SliceGrid:
        """Return the grid of so many slices whose voxels (k, j, i, 1) the affine (4, 4) maps to LPS mm."""
        matrix = cls.checked_affine(affine)
        origins_mm = matrix[:3, 3] + np.arange(slices)[:, np.newaxis] * matrix[:3, 0]
        return cls(origins_mm, matrix[:3, 1], matrix[:3, 2])

    @property
    def tilt_deg(self) -> float:
        """Angle between the slice normal and the line through the slice origins, from the positions alone."""
        if len(self.origins_mm) < 2:
            return 0.0
        direction = unit(self.origins_mm[-1] - self.origins_mm[0])
        return float(np.degrees(np.arccos(np.clip(direction @ self.normal, -1.0, 1.0))))

    def positions_mm(self, kji: FloatArray) -> FloatArray:
        """Map voxel indices (..., 3) = (slice, row, column) to LPS mm (..., 3).

        Fractional slice indices are interpolated between the two slices' own origins; beyond the first and the
        last slice the nearest gap is continued.
        """
        k, j, i = np.moveaxis(np.asarray(kji, dtype=np.float64), -1, 0)
        in_plane = j[..., np.newaxis] * self.row_step_mm + i[..., np.newaxis] * self.column_step_mm
        places: FloatArray = self._origin_at(k) + in_plane
        return places

    def indices(self, positions_mm: FloatArray) -> FloatArray:
        """Map LPS mm (..., 3) to fractional voxel indices (..., 3) = (slice, row, column)."""
        positions = np.asarray(positions_mm, dtype=np.float64)
        k = _interpolate(positions @ self.normal, self.slice_positions_mm, self._slice_numbers)
        in_plane = positions - self._origin_at(k)
        j = in_plane @ self.row_step_mm / self.row_spacing_mm**2
        i = in_plane @ self.column_step_mm / self.column_spacing_mm**2
        return np.stack([k, j, i], axis=-1)

    def _origin_at(self, k: FloatArray) -> FloatArray:
        columns = [_interpolate(k, self._slice_numbers, self.origins_mm[:, axis]) for axis in range(3)]
        return np.stack(columns, axis=-1)

    @property
    def _slice_numbers(self) -> FloatArray:
        return np.arange(len(self.origins_mm), dtype=np.float64)


def _interpolate(x: FloatArray, xp: FloatArray, fp: FloatArray) -> FloatArray:
    """Piecewise linear interpolation that continues the first and last segment (`numpy.interp` would clamp)."""
    if len(xp) < 2:
        return np.broadcast_to(np.asarray(fp[0], dtype=np.float64), x.shape)
    left = np.clip(np.searchsorted(xp, x, side="right") - 1, 0, len(xp) - 2)
    fraction = (x - xp[left]) / (xp[left + 1] - xp[left])
    continued: FloatArray = fp[left] + fraction * (fp[left + 1] - fp[left])
    return continued


@dataclass(frozen=True)
class SeriesSource:
    """Where a volume comes from. Nothing here identifies the patient."""

    study_instance_uid: str | None = None
    series_instance_uid: str | None = None
    frame_of_reference_uid: str | None = None
    modality: str = "CT"
    description: str = ""
    kernel: str = ""


class Gridded:
    """Values (K, J, I) on a `SliceGrid`, as other libraries hold them; an uneven grid is refused (`InputError`)."""

    grid: SliceGrid
    unit: str
    name: str

    @property
    def values(self) -> NDArray[Any]:
        """The values (K, J, I)."""
        raise NotImplementedError

    @property
    def affine(self) -> FloatArray:
        """The (4, 4) that maps voxel indices (k, j, i, 1) to LPS mm."""
        return self.grid.affine

    def to_sitk(self) -> Any:
        """Return a SimpleITK image (LPS)."""
        from ronnaplan.ct.exchange import to_sitk

        return to_sitk(self.values, self.affine)

    def to_nibabel(self) -> Any:
        """Return a nibabel NIfTI-1 image (RAS)."""
        from ronnaplan.ct.exchange import to_nibabel

        return to_nibabel(self.values, self.affine)

    def to_pyvista(self) -> Any:
        """Return a PyVista image (LPS)."""
        from ronnaplan.ct.exchange import to_pyvista

        return to_pyvista(self.values, self.affine, self.name)

    def to_xarray(self) -> Any:
        """Return an xarray.DataArray over (k, j, i)."""
        from ronnaplan.ct.exchange import to_xarray

        return to_xarray(self.values, self.affine, self.name, self.unit)


@dataclass(frozen=True, eq=False, repr=False)
class ScalarMap(Gridded):
    """Any quantity over a scan's grid: ``data`` (K, J, I) in ``unit``."""

    data: NDArray[np.float32]
    grid: SliceGrid
    name: str
    unit: str
    frame: Frame

    @property
    def values(self) -> NDArray[Any]:
        """The data, as `Gridded` has them."""
        return self.data

    def __repr__(self) -> str:
        least, most = self.values.min(), self.values.max()
        return f"ScalarMap({self.name}, {self.values.shape}, {least:.3g} to {most:.3g} {self.unit})"


@dataclass(frozen=True, eq=False)
class CTVolume(Gridded):
    """A CT scan: ``voxels_hu`` (K, J, I) in Hounsfield units, and the `SliceGrid` that places them.

    ``voxels_hu`` is int16 wherever the rescaled values are whole and fit, else float32. Voxels that the scanner
    did not measure (padding, outside the circle of reconstruction) hold ``padding_hu``.
    """

    voxels_hu: NDArray[np.int16] | NDArray[np.float32]
    grid: SliceGrid
    source: SeriesSource = field(default_factory=SeriesSource)
    padding_hu: float | None = None
    flags: tuple[VolumeFlag, ...] = ()

    def __repr__(self) -> str:
        slices, rows, columns = self.voxels_hu.shape
        spacing = (
            f"{self.grid.typical_gap_mm:.3g} x {self.grid.row_spacing_mm:.3g} x {self.grid.column_spacing_mm:.3g}"
        )
        flags = f", {len(self.flags)} flags" if self.flags else ""
        return f"CTVolume({slices} slices of {rows} x {columns}, {spacing} mm{flags})"

    @classmethod
    def from_array(
        cls, voxels_hu: ArrayLike, affine: ArrayLike, frame_of_reference_uid: str | None = None
    ) -> CTVolume:
        """Return the scan of ``voxels_hu`` (K, J, I) whose indices (k, j, i, 1) ``affine`` (4, 4) maps to LPS mm."""
        voxels = np.asarray(voxels_hu)
        if voxels.ndim != 3 or voxels.dtype.kind not in "iuf" or not voxels.size:
            raise UsageError(
                f"voxels are {voxels.dtype} of shape {voxels.shape}; expected numbers (slices, rows, columns)"
            )
        if not np.isfinite(voxels).all():
            raise InputError("voxels hold values that are not finite; expected HU")
        info = np.iinfo(np.int16)
        fits = voxels.dtype.kind in "iu" and info.min <= voxels.min() and voxels.max() <= info.max
        kept: Any = voxels.astype(np.int16 if fits else np.float32)
        source = SeriesSource(frame_of_reference_uid=frame_of_reference_uid)
        matrix = SliceGrid.checked_affine(affine)
        if np.linalg.det(matrix[:3, [2, 1, 0]]) < 0:  # a `SliceGrid` ascends along its normal
            kept = kept[::-1]
            matrix = np.column_stack(
                [-matrix[:, 0], *matrix[:, 1:3].T, matrix[:, 3] + (len(kept) - 1) * matrix[:, 0]]
            )
        return cls(kept, SliceGrid.from_affine(matrix, len(kept)), source)

    @classmethod
    def from_sitk(cls, image: Any, frame_of_reference_uid: str | None = None) -> CTVolume:
        """Return the scan in a three-dimensional SimpleITK image of HU."""
        from ronnaplan.ct.exchange import from_sitk

        return cls.from_array(*from_sitk(image), frame_of_reference_uid)

    @property
    def values(self) -> NDArray[Any]:
        """The voxels, as `Gridded` has them."""
        return self.voxels_hu

    name = "CT"
    unit = "HU"

    @property
    def frame(self) -> Frame:
        """The patient frame this scan lives in."""
        return Frame("CT", self.source.frame_of_reference_uid)

    @cached_property
    def voxel_sha256(self) -> str:
        """SHA-256 of the voxel values in (slice, row, column) order: ties a result to its scan."""
        return hashlib.sha256(np.ascontiguousarray(self.voxels_hu).data).hexdigest()
