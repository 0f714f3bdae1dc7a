"""A CT scan: its voxels, and the grid that says where each of them is in the patient. Nothing is resampled."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ronnaplan.bounds import LARGEST_HU
from ronnaplan.ct.grid import SliceGrid
from ronnaplan.ct.identity import ScanIdentity
from ronnaplan.ct.limits import are_hu, fit_int16
from ronnaplan.ct.scale_end import scale_end_hu
from ronnaplan.ct.scratch import one_by_one, runs
from ronnaplan.errors import InputError, UsageError
from ronnaplan.geometry import FloatArray, Frame, as_point, as_points
from ronnaplan.pipes import Sendable
from ronnaplan.text import place

if TYPE_CHECKING:
    from ronnaplan.figures import Picture


Voxels = NDArray[np.int16] | NDArray[np.float32]
"""HU (slice, row, column), or a part of them."""

WAYS_TO_A_VOLUME = "read_ct returns one, CTVolume.from_sitk and CTVolume.from_array make one"
"""What to do where something else was given."""

INDEX_DIGITS = 6
"""Voxel indices are rounded to so many digits, so that the outermost voxels are not outside of their grid."""


class VolumeFlag(StrEnum):
    """Reasons to doubt a volume; each value is the sentence shown to the user."""

    LOSSY = "the images were compressed with loss"
    UNEVEN_SPACING = "the slices are not evenly spaced"
    ROUNDED = "the slices' positions are rounded, and were taken for evenly spaced as they agree with that"
    CUT_SPACING = (
        "the pixel spacing has three decimals, and the diameter of reconstruction tells that more were left out: "
        "distances in the slices may be off by 0.05 % and more"
    )
    MISSING_SLICE = "one or more slices are missing"
    DUPLICATES_DROPPED = "identical copies of a slice were dropped"
    SAME_INSTANCE = "different images bear one SOP Instance UID, so that archives keep one of them only"
    OVERLAPPING = "the slices overlap"
    TILT_CONTRADICTS = "the gantry tilt tag contradicts the slice positions"
    SHIFTED_SIDEWAYS = "slices are shifted sideways against each other"
    SHEARED = (
        "each slice lies sideways of the one before, and no tag tells of a tilted gantry; check their positions"
    )
    UNREADABLE_FILES = "some files beside the slices could not be read"
    ONLY_USABLE = "another scan beside it cannot be used, so this one was taken; check that it is the one meant"
    NO_FRAME_OF_REFERENCE = "the file names no frame of reference"
    IMAGES_LEFT_OUT = "images of the same series that do not fit the others were left out"
    MIXED_VOLTAGE = "the tube voltage changes within the volume"
    OUT_OF_ORDER = "neighbouring slices were not taken one after another"
    DERIVED = "the images were computed from others"
    REFORMATTED = "the slices were resampled from others"
    REPEATED = "slices, rows or columns repeat others, as resampling to the nearest does; give the original series"
    VIRTUAL_VALUES = "the values are those of a material or of a virtual energy"
    NO_AIR = "no value is as low as air's, as if all were offset (by 1024?); expected air at -1000 HU"
    LOW_AIR = (
        "air is far below -1000 HU, as if an offset (of -1024?) had been added twice; expected air at -1000 HU"
    )
    SIGN = (
        "values lie far below air's -1000 HU, as if the pixels were unsigned though the header calls them signed; what "
        "is bright would then be dark here"
    )
    NO_TISSUE = (
        "no value is as high as tissue's, as if the rescale slope were wrong; expected tissue at about 0 HU"
    )
    SCALED = "air and what is in it are not 1000 apart, so the values are no HU; they were scaled to find markers"
    INVERTED = "more than half is brighter than bone, as if inverted or without its sign; expected air at -1000 HU"


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

        Raises `UsageError` for what is no array of numbers of three axes, `InputError` for masked or impossible values
        and an affine that is none of a scan.
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
        kept: Any = voxels.astype(np.int16 if voxels.dtype.kind in "iu" and fit_int16(voxels) else np.float32)
        source = SeriesSource(frame_of_reference_uid=frame_of_reference_uid)
        matrix = SliceGrid.checked_affine(affine)
        if np.linalg.det(matrix[:3, [2, 1, 0]]) < 0:  # a `SliceGrid` ascends along its normal
            kept = kept[::-1]
            matrix = np.column_stack(
                [-matrix[:, 0], *matrix[:, 1:3].T, matrix[:, 3] + (len(kept) - 1) * matrix[:, 0]]
            )
        rows = np.ascontiguousarray(kept)  # as readers give them: kernels are compiled for these
        return cls(rows, SliceGrid.from_affine(matrix, len(rows)), source)

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
