"""A CT scan: its voxels, and the grid that says where each of them is in the patient. Nothing is resampled."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ronnaplan.ct.arrays import checked_voxels, upwards
from ronnaplan.ct.flags import VolumeFlag as VolumeFlag
from ronnaplan.ct.flags import Voxels as Voxels
from ronnaplan.ct.grid import SliceGrid
from ronnaplan.ct.identity import ScanIdentity
from ronnaplan.ct.limits import fit_int16
from ronnaplan.ct.scale import doubts_of_scale, unmeasured_hu
from ronnaplan.ct.scale_end import scale_end_hu
from ronnaplan.ct.scratch import one_by_one, runs
from ronnaplan.errors import InputError
from ronnaplan.geometry import FloatArray, Frame, as_point, as_points
from ronnaplan.pipes import Sendable
from ronnaplan.text import place

if TYPE_CHECKING:
    from ronnaplan.figures import Picture


WAYS_TO_A_VOLUME = "read_ct returns one, CTVolume.from_sitk and CTVolume.from_array make one"
"""What to do where something else was given."""

INDEX_DIGITS = 6
"""Voxel indices are rounded to so many digits, so that the outermost voxels are not outside of their grid."""


@dataclass(frozen=True)
class SeriesSource:
    """Where a volume comes from. Nothing here identifies the patient."""

    study_instance_uid: str | None = None
    series_instance_uid: str | None = None
    frame_of_reference_uid: str | None = None
    modality: str = "CT"
    description: str = ""
    kernel: str = ""

    @property
    def frame(self) -> Frame:
        """The patient frame that it lives in."""
        return Frame("CT", self.frame_of_reference_uid)

    @property
    def uids(self) -> dict[str, str | None]:
        """The fields by which documents name the scan, beside its voxels' hash."""
        return {
            "study_instance_uid": self.study_instance_uid,
            "series_instance_uid": self.series_instance_uid,
            "frame_of_reference_uid": self.frame_of_reference_uid,
        }


class Gridded(Sendable):
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
        """The data (K, J, I), as `Gridded` has them."""
        return self.data

    def __repr__(self) -> str:
        least, most = self.values.min(), self.values.max()
        return f"ScalarMap({self.name}, {self.values.shape}, {least:.3g} to {most:.3g} {self.unit})"

    def plot(self, through_mm: Sequence[float] | FloatArray | None = None, points_mm: ArrayLike = ()) -> Picture:
        """Return the map in the three planes through a place (3,) in LPS mm, else through its middle.

        ``points_mm`` (N, 3), say the markers, are drawn before it, wherever they lie. Planes are interpolated, for the
        eye only. Raises `InputError` for a place outside of the map.
        """
        from ronnaplan.ct.sampling import sampled
        from ronnaplan.figures import ThreeViews

        def values(places_mm: FloatArray) -> FloatArray:
            return sampled(self.data, self.grid.indices(places_mm).round(INDEX_DIGITS), np.nan).astype(np.float64)

        slices, rows, columns = self.data.shape
        kji = np.array([(k, j, i) for k in range(slices) for j in (0, rows - 1) for i in (0, columns - 1)])
        corners_mm = self.grid.positions_mm(kji.astype(np.float64))
        low_mm, high_mm = corners_mm.min(axis=0), corners_mm.max(axis=0)
        middle_mm = (low_mm + high_mm) / 2 if through_mm is None else as_point(through_mm, "through_mm")
        if np.isnan(values(middle_mm[np.newaxis])[0]):
            raise InputError(f"{place(middle_mm)} mm is outside of the map; give a place within, LPS mm")
        views = ThreeViews(f"{self!r} through {place(middle_mm)} mm")
        views.fields(values, middle_mm, low_mm, high_mm, f"{self.name}, {self.unit}")
        views.points(as_points(points_mm, "points_mm"))
        return views.picture


@dataclass(frozen=True, eq=False)
class CTVolume(Gridded):
    """A CT scan: ``voxels_hu`` (K, J, I) in Hounsfield units, and the `SliceGrid` that places them.

    ``voxels_hu`` is int16 wherever the rescaled values are whole and fit, else float32. Voxels that the scanner
    did not measure (padding, outside the circle of reconstruction) hold ``padding_hu``.
    """

    voxels_hu: Voxels
    grid: SliceGrid
    source: SeriesSource = field(default_factory=SeriesSource)
    padding_hu: float | None = None
    flags: tuple[VolumeFlag, ...] = ()

    def __repr__(self) -> str:
        slices, rows, columns = self.voxels_hu.shape
        spacing = (
            f"{self.grid.typical_gap_mm:.3g} x {self.grid.row_spacing_mm:.3g} x {self.grid.column_spacing_mm:.3g}"
        )
        flags = "".join(f", {flag.name.lower()}" for flag in self.flags)
        return f"CTVolume({slices} slices of {rows} x {columns}, {spacing} mm{flags})"

    def flagged(self, flag: VolumeFlag) -> CTVolume:
        """Return the volume with one more reason to doubt it."""
        return self if flag in self.flags else replace(self, flags=(*self.flags, flag))

    @classmethod
    def from_array(
        cls, voxels_hu: ArrayLike, affine: ArrayLike, frame_of_reference_uid: str | None = None
    ) -> CTVolume:
        """Return the scan of ``voxels_hu`` (K, J, I) whose indices (k, j, i, 1) ``affine`` (4, 4) maps to LPS mm.

        Of a nibabel image, which counts (i, j, k) and maps to RAS, these are ``numpy.asarray(image.dataobj).T`` and
        ``numpy.diag([-1, -1, 1, 1]) @ image.affine[:, [2, 1, 0, 3]]``; of what `to_xarray` gave, it and its
        ``attrs["lps_from_kji"]``.

        It is doubted as the same scan in an image file is, and what was not measured is told by its corners, too.
        Raises `UsageError` for what is no array of numbers of three axes, `InputError` for masked or impossible values
        and an affine that is none of a scan.
        """
        voxels, matrix = upwards(checked_voxels(voxels_hu), SliceGrid.checked_affine(affine))
        grid, padding_hu = SliceGrid.from_affine(matrix, len(voxels)), unmeasured_hu(voxels)
        source = SeriesSource(frame_of_reference_uid=frame_of_reference_uid)
        sheared = (VolumeFlag.SHEARED,) if grid.is_sheared else ()
        flags = (*sheared, *doubts_of_scale(voxels, padding_hu))
        return cls(voxels, grid, source, padding_hu, flags)

    @classmethod
    def from_sitk(cls, image: Any, frame_of_reference_uid: str | None = None) -> CTVolume:
        """Return the scan in a three-dimensional SimpleITK image of HU; raises as `from_array` does."""
        from ronnaplan.ct.exchange import from_sitk

        return cls.from_array(*from_sitk(image), frame_of_reference_uid)

    @property
    def values(self) -> NDArray[Any]:
        """The voxels (K, J, I), as `Gridded` has them."""
        return self.voxels_hu

    name = "CT"
    unit = "HU"

    @property
    def padding_or_nan_hu(self) -> float:
        """``padding_hu`` to compare voxels with: NaN, which equals none, where there is no padding."""
        return math.nan if self.padding_hu is None else float(self.padding_hu)

    @property
    def frame(self) -> Frame:
        """The patient frame this scan lives in."""
        return self.source.frame

    @property
    def identity(self) -> ScanIdentity:
        """Which scan this is."""
        return ScanIdentity("the scan", self.frame, self.source.series_instance_uid, self.voxel_sha256)

    @cached_property
    def voxel_sha256(self) -> str:
        """SHA-256 of the voxel values in (slice, row, column) order: ties a result to its scan.

        Whole values that int16 holds are taken as such, as where they were read, whatever the array's own type.
        """
        whole = all(fit_int16(plane) for plane in one_by_one(self.voxels_hu))
        digest = hashlib.sha256()
        for first, end in runs(self.voxels_hu, 0, len(self.voxels_hu)):
            digest.update(np.ascontiguousarray(self.voxels_hu[first:end], "<i2" if whole else "<f4").data)
        return digest.hexdigest()

    @cached_property
    def scale_end_hu(self) -> float:
        """Value at which the scan's scale ends, or infinity where its brightest voxels are not cut off."""
        return scale_end_hu(self.voxels_hu)
