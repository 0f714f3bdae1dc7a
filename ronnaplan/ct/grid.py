"""Where the voxels of parallel slices are in the patient.

Each slice has its own origin, so gantry tilt (origins that drift within the slice plane) and uneven spacing are kept
exactly as acquired.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from ronnaplan.bounds import FARTHEST_POINT_MM
from ronnaplan.errors import InputError
from ronnaplan.geometry import FloatArray, as_numbers, unit
from ronnaplan.pipes import Sendable

UNIFORM_SPACING_TOLERANCE_MM = 1e-3
"""Slice gaps that differ by less than this are called equal (DICOM writes positions with 3 to 6 decimals)."""

TILT_TOLERANCE_DEG = 0.5
"""Angles between slices and the line through them are told to this: several makers round the tilt tag to so much."""

CUBE_TOLERANCE = 0.01
"""Voxels whose edges differ by this share at most are cubes."""

PANEL_SLICES = (1, 2)
"""Flat panels' pictures have slices so many pixels apart: their voxels are cubes, of which some export means of two."""

PIXEL_SIZE_RANGE_MM: Final = (1e-2, 100.0)
"""Voxels outside are a damaged header or another unit: no scanner that a head fits into has finer ones. Of those in
metres only voxels of 10 mm and more would pass, which show no marker."""

PERPENDICULAR_TOLERANCE: Final = 2e-4
"""Largest departure of written directions from perpendicular unit vectors (cosines rounded to 4 decimals)."""

LAST_ROW_TOLERANCE: Final = 1e-9
"""What an affine that was fitted may differ in from one that ends in 0 0 0 1, by rounding."""

LEAST_STACKING: Final = 0.1
"""Cosine between the slice axis and the normal, below which slices do not stack."""


def require_grid(affine: FloatArray) -> None:
    """Raise `InputError` unless the voxels (k, j, i, 1) that an affine (4, 4) maps to LPS mm are those of a scan."""
    slice_step, row_step, column_step, origin = affine[:3].T
    lengths = [float(np.linalg.norm(step)) for step in (column_step, row_step, slice_step)]
    low, high = PIXEL_SIZE_RANGE_MM
    if not all(low <= length <= high for length in lengths):
        measure = " x ".join(f"{length:.3g}" for length in lengths)
        raise InputError(
            f"its voxels measure {measure} mm, expected {low:g} to {high:g} mm each way; state lengths in millimetres"
        )
    if not float(np.abs(origin).max()) <= FARTHEST_POINT_MM:
        raise InputError(f"it lies more than {FARTHEST_POINT_MM / 1000.0:g} m from the origin")
    if abs(column_step @ row_step) > PERPENDICULAR_TOLERANCE * lengths[0] * lengths[1]:
        raise InputError("it has rows and columns that are not perpendicular; convert it without shear")
    if abs(float(slice_step @ np.cross(column_step, row_step))) < LEAST_STACKING * np.prod(lengths):
        raise InputError("it has slices that do not stack; convert it again")


@dataclass(frozen=True)
class SliceGrid(Sendable):
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

    @cached_property
    def row_spacing_mm(self) -> float:
        """Distance between neighbouring rows."""
        return float(np.linalg.norm(self.row_step_mm))

    @cached_property
    def column_spacing_mm(self) -> float:
        """Distance between neighbouring columns."""
        return float(np.linalg.norm(self.column_step_mm))

    @property
    def steps_mm(self) -> FloatArray:
        """Distances (2,) between neighbouring columns and rows: along the first two of ``axes``."""
        return np.array([self.column_spacing_mm, self.row_spacing_mm])

    @property
    def pixel_mm(self) -> float:
        """The larger of the distances between rows and between columns."""
        return max(self.row_spacing_mm, self.column_spacing_mm)

    @property
    def is_evenly_spaced(self) -> bool:
        """Whether all gaps agree within `UNIFORM_SPACING_TOLERANCE_MM`."""
        gaps = self.spacings_mm
        return bool(gaps.size == 0 or np.ptp(gaps) < UNIFORM_SPACING_TOLERANCE_MM)

    @property
    def is_in_cubes(self) -> bool:
        """Whether slices, rows and columns are equally far apart, to `CUBE_TOLERANCE`."""
        steps_mm = (self.row_spacing_mm, self.column_spacing_mm, self.typical_gap_mm)
        return max(steps_mm) - min(steps_mm) <= CUBE_TOLERANCE * min(steps_mm)

    @property
    def may_be_a_panels(self) -> bool:
        """Whether slices are `PANEL_SLICES` pixels apart, to `CUBE_TOLERANCE`."""
        pixels = self.typical_gap_mm / self.pixel_mm
        return any(abs(pixels / many - 1.0) <= CUBE_TOLERANCE for many in PANEL_SLICES)

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
        matrix = as_numbers(affine, "the affine's entries", "(4, 4)")
        is_affine = matrix.shape == (4, 4) and np.allclose(
            matrix[3], (0, 0, 0, 1), rtol=0, atol=LAST_ROW_TOLERANCE
        )
        if not is_affine or not np.isfinite(matrix).all():
            raise InputError("the affine is no finite (4, 4) that maps (k, j, i, 1) to LPS mm and ends in 0 0 0 1")
        try:
            require_grid(matrix)
        except InputError as error:
            raise InputError(f"the affine is none of a scan: {error}") from error
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

    @property
    def is_sheared(self) -> bool:
        """Whether slices are shifted sideways, each against the one before, as by no tilted gantry.

        A table moves along the patient's axis, so that the slices of a tilted gantry follow that.
        """
        if self.tilt_deg <= TILT_TOLERANCE_DEG:
            return False
        along = unit(self.origins_mm[-1] - self.origins_mm[0])
        return bool(abs(along[2]) < np.cos(np.radians(TILT_TOLERANCE_DEG)))

    def positions_mm(self, kji: FloatArray) -> FloatArray:
        """Map voxel indices (..., 3) = (slice, row, column) to LPS mm (..., 3).

        Fractional slice indices are interpolated between the two slices' own origins; beyond the first and the
        last slice the nearest gap is continued.
        """
        k, j, i = np.moveaxis(np.asarray(kji, dtype=np.float64), -1, 0)
        in_plane = j[..., np.newaxis] * self.row_step_mm + i[..., np.newaxis] * self.column_step_mm
        places: FloatArray = self._origin_at(k) + in_plane
        return places

    def at_slices(self, places: FloatArray) -> SliceGrid:
        """Return the grid of slices at fractional slice indices ``places`` (K,) of this one."""
        return replace(self, origins_mm=self._origin_at(np.asarray(places, dtype=np.float64)))

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
