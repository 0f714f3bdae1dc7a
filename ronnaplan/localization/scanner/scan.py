"""A scan as the fits of its markers need it: a volume, and what is known of its slices and of its scale's end."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from ronnaplan.ct.volume import CTVolume, VolumeFlag
from ronnaplan.geometry import FloatArray
from ronnaplan.localization.fit.neighbourhood import axes_along
from ronnaplan.localization.scanner.beat import noise_beats
from ronnaplan.localization.scanner.hounsfield import in_hounsfield
from ronnaplan.localization.scanner.measured import measured
from ronnaplan.localization.scanner.repeated import without_copies
from ronnaplan.localization.scanner.splined import before_splines
from ronnaplan.localization.scanner.summed import UNTOLD, Summed

BROADENING = 1.5
"""Slice profiles are broader than nominal by up to this factor."""


@dataclass(frozen=True)
class Slant:
    """The profile of slices that others were computed from obliquely.

    The unit vector ``axis`` (3,) in LPS along which it blurs, and how wide it is.
    """

    axis: FloatArray
    width_mm: float


class Scan:
    """A volume with the facts about it that every fit needs.

    ``slant`` is the slices' profile where that is not along their normal, ``summed`` how their rays were summed, and
    ``unplaced_mm2`` (3, 3), in LPS, how far all of it may lie elsewhere. What is made of a ``whole`` scan has its
    scale's end, but where that is taken to be at ``ends_at_hu``, and was computed and lies as that was.
    """

    def __init__(
        self,
        volume: CTVolume,
        slant: Slant | None = None,
        whole: Scan | None = None,
        summed: Summed = UNTOLD,
        *,
        ends_at_hu: float | None = None,
        unplaced_mm2: FloatArray | None = None,
    ) -> None:
        self.volume = volume
        self.slant = slant
        self.summed = summed
        self._whole = whole
        self._ends_at_hu = ends_at_hu
        self._unplaced_mm2 = np.zeros((3, 3)) if unplaced_mm2 is None else unplaced_mm2

    @classmethod
    def of(cls, volume: CTVolume, slant: Slant | None = None, summed: Summed = UNTOLD) -> Scan:
        """Return what was measured of a volume, in Hounsfield units; raises `InputError` for a single slice."""
        once, unplaced_mm2 = without_copies(volume)
        kept = measured(once)
        made = before_splines(once) if kept is once else kept
        return cls(in_hounsfield(made), slant, summed=summed, unplaced_mm2=unplaced_mm2)

    @cached_property
    def axes(self) -> FloatArray:
        """Unit vectors u, v and w (3, 3) in LPS: along w the slices' profile blurs, across it the kernel."""
        return axes_along(self.volume.grid.axes, self.profile_axis)

    @property
    def profile_axis(self) -> FloatArray | None:
        """Unit vector (3,) in LPS along which the slices' profile blurs; None where that is their normal."""
        return None if self.slant is None else self.slant.axis

    def thickness_mm(self, centers_mm: FloatArray) -> FloatArray:
        """Nominal thickness (...) of the slices at ``centers_mm`` (..., 3).

        That is their gap, or the neighbouring gap where that is wider, or what the file says where it says more: tags
        often hold the pixel's size instead.
        """
        grid = self.volume.grid
        stated_mm = self._stated_mm
        if not grid.spacings_mm.size:
            return np.full(centers_mm.shape[:-1], stated_mm or grid.row_spacing_mm)
        above = np.searchsorted(grid.slice_positions_mm, centers_mm @ grid.normal)
        thickness_mm: FloatArray = np.maximum(self._wide_gaps_mm[above], stated_mm)
        return thickness_mm

    @cached_property
    def _wide_gaps_mm(self) -> FloatArray:
        """The widest of each gap and its neighbours, below the first slice and above the last one, too (K + 1,)."""
        padded_mm = np.pad(self.volume.grid.spacings_mm, 1, mode="edge")
        widest_mm: FloatArray = np.pad(sliding_window_view(padded_mm, 3).max(axis=1), 1, mode="edge")
        return widest_mm

    @property
    def widest_mm(self) -> float:
        """Width of the slice profile that a fit must be able to see."""
        return BROADENING * max(self._stated_mm, self.gap_mm, self.volume.grid.row_spacing_mm)

    @property
    def _stated_mm(self) -> float:
        """How thick the slices are said to be, or were that they were computed from; 0 where nobody knows."""
        return max(self.volume.grid.thickness_mm or 0.0, 0.0 if self.slant is None else self.slant.width_mm)

    @cached_property
    def gap_mm(self) -> float:
        """Widest distance between neighbouring slices."""
        return float(self.volume.grid.spacings_mm.max(initial=0.0))

    def gap_across_mm(self, center_mm: FloatArray, radius_mm: float) -> float:
        """Widest distance between neighbouring slices that a ball of this radius at ``center_mm`` (3,) reaches into."""
        grid = self.volume.grid
        heights_mm = grid.slice_positions_mm - center_mm @ grid.normal
        reaches = (heights_mm[1:] > -radius_mm) & (heights_mm[:-1] < radius_mm)
        return float(grid.spacings_mm[reaches].max(initial=0.0))

    @cached_property
    def is_computed(self) -> bool:
        """Whether its slices were computed from others, of which none is left."""
        return noise_beats(self.volume) if self._whole is None else self._whole.is_computed

    @property
    def unplaced_mm2(self) -> FloatArray:
        """Covariance (3, 3) in LPS mm^2 of where all of it is, which what repeats its neighbours leaves open."""
        return self._unplaced_mm2 if self._whole is None else self._whole.unplaced_mm2

    @property
    def flags(self) -> tuple[VolumeFlag, ...]:
        """Reasons to doubt the volume."""
        told = [VolumeFlag.REFORMATTED] if self.is_computed or self.slant is not None else []
        return tuple(dict.fromkeys([*self.volume.flags, *told]))

    @property
    def ceiling_hu(self) -> float:
        """Value at which the scan clips, or infinity where its brightest voxels are not clipped."""
        if self._ends_at_hu is not None:
            return self._ends_at_hu
        return self.volume.scale_end_hu if self._whole is None else self._whole.ceiling_hu
