"""The voxels about a candidate, at their true places."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from kernelcache import njit
from ronnaplan.ct.volume import CTVolume
from ronnaplan.geometry import FloatArray


@dataclass(frozen=True)
class Neighbourhood:
    """Voxels near a place: values in HU, and offsets from ``origin_mm`` along u, v, w, slice by slice.

    ``slices`` (N,) are their slices' numbers; ``offsets_mm`` (N, 3); ``values_hu`` (N,); ``axes`` (3, 3) has u, v, w as
    rows in LPS. ``pixel_mm`` is the grid's, ``floors_hu`` (N,) the lowest value about the place, where scales end, and
    ``ceiling_hu`` the value at which the scan's clips; infinite where it does not.
    ``ending_share`` is the share of the directions that were left out, because what holds the ball ends in them.
    ``evened_mm`` (3,), in LPS, is how far a ball was moved when its uneven filling was made even in these values.
    """

    origin_mm: FloatArray
    axes: FloatArray
    slices: NDArray[np.intp]
    offsets_mm: FloatArray
    values_hu: FloatArray
    floors_hu: FloatArray
    pixel_mm: float
    ceiling_hu: float = math.inf
    ending_share: float = 0.0
    evened_mm: FloatArray | None = None

    @cached_property
    def distances_mm(self) -> FloatArray:
        """How far each voxel (N,) lies from the origin."""
        u, v, w = self.offsets_mm.T
        distances_mm: FloatArray = np.sqrt(u * u + v * v + w * w)
        return distances_mm

    @property
    def is_cut_off(self) -> NDArray[np.bool_]:
        """Which voxels (N,) are at the lower end of their scale: what they measured may be darker."""
        return self.values_hu <= self.floors_hu

    @property
    def across(self) -> int:
        """Which of the axes leads across the slices that were measured: those of the patient's axis."""
        return int(np.abs(self.axes[:, 2]).argmax())

    def select(self, chosen: NDArray[np.bool_]) -> Neighbourhood:
        """Keep only the ``chosen`` (N,) voxels."""
        return self.take(np.flatnonzero(chosen))

    def take(self, kept: NDArray[np.intp]) -> Neighbourhood:
        """Keep only the voxels at these places (M,)."""
        voxels = self.slices, self.offsets_mm, self.values_hu, self.floors_hu
        slices, offsets_mm, values_hu, floors_hu = _taken(*voxels, kept)
        return replace(self, slices=slices, offsets_mm=offsets_mm, values_hu=values_hu, floors_hu=floors_hu)

    def given_back(self, lost_hu: FloatArray) -> Neighbourhood:
        """Give the voxels what they have lost (N,); where the scale had ended below, it ends as much higher.

        What had reached its upper end still has.
        """
        values_hu = self.values_hu + lost_hu
        values_hu = np.where(self.values_hu >= self.ceiling_hu, np.maximum(values_hu, self.values_hu), values_hu)
        return replace(self, values_hu=values_hu, floors_hu=self.floors_hu + lost_hu)


def gather(
    volume: CTVolume, center_mm: FloatArray, reach_mm: float, axes: FloatArray, ceiling_hu: float = math.inf
) -> Neighbourhood:
    """Collect the measured voxels within ``reach_mm`` of ``center_mm`` (3,) in LPS.

    ``axes`` (3, 3) are u, v, w in LPS. Where they are not the slices' own, what is as thick as these and lies across w
    stands for a slice.
    """
    grid = volume.grid
    places = grid.slice_positions_mm - center_mm @ grid.normal
    first, last = np.searchsorted(places, [-reach_mm, reach_mm])
    origins_uv = grid.origins_mm[first:last] @ grid.axes[:2].T - grid.axes[:2] @ center_mm
    steps = grid.steps_mm
    window = _window(-origins_uv / steps, reach_mm / steps, volume.voxels_hu.shape)
    slices, offsets, values = _gather(
        *(volume.voxels_hu, int(first), origins_uv, places[first:last], steps, window, reach_mm),
        volume.padding_or_nan_hu,
    )
    floors = np.full(len(values), values.min(initial=np.inf))
    around = Neighbourhood(center_mm, grid.axes, slices, offsets, values, floors, grid.pixel_mm, ceiling_hu)
    return around if axes is grid.axes else _turned(around, axes, float(np.median(grid.spacings_mm)))


def first_of_each(slices: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return where each slice's voxels begin among those of ``slices`` (N,): they come slice by slice."""
    is_first = np.ones(len(slices), dtype=np.bool_)
    np.not_equal(slices[1:], slices[:-1], out=is_first[1:])
    return np.flatnonzero(is_first)


def axes_along(axes: FloatArray, w: FloatArray | None) -> FloatArray:
    """Return ``axes`` (3, 3), turned as little as can be so that the last one is ``w`` (3,), if that is given."""
    if w is None:
        return axes
    from scipy.spatial.transform import Rotation

    turn, _ = Rotation.align_vectors(w[np.newaxis], axes[2:])
    return np.asarray(turn.apply(axes))


def _turned(around: Neighbourhood, axes: FloatArray, slab_mm: float) -> Neighbourhood:
    """See the voxels along other ``axes``, in slabs across w."""
    offsets_mm = around.offsets_mm @ (around.axes @ axes.T)
    slabs = np.floor((offsets_mm[:, 2] - offsets_mm[:, 2].min(initial=0.0)) / slab_mm).astype(np.intp)
    order = np.argsort(slabs, kind="stable")
    return replace(
        around,
        axes=axes,
        slices=slabs[order],
        offsets_mm=np.ascontiguousarray(offsets_mm[order]),
        values_hu=around.values_hu[order],
    )


@njit(cache=True, nogil=True)
def _gather(
    voxels: NDArray[np.int16] | NDArray[np.float32],
    first: int,
    origins: FloatArray,
    places: FloatArray,
    steps: FloatArray,
    window: NDArray[np.intp],
    reach: float,
    padding: float,
) -> tuple[NDArray[np.intp], FloatArray, FloatArray]:
    """Slices (N,), offsets (N, 3) and values (N,) of the voxels of slices from ``first`` on that are near."""
    count = 0
    slices, offsets, values = np.empty(0, np.intp), np.empty((0, 3)), np.empty(0)
    for is_counted in (False, True):  # memory that is touched for the first time costs more than to look twice
        if is_counted:
            slices, offsets, values = np.empty(count, np.intp), np.empty((count, 3)), np.empty(count)
        count = 0
        for place in range(len(places)):
            k, w = first + place, places[place]
            for j in range(window[1, 0], window[1, 1]):
                v = origins[place, 1] + j * steps[1]
                if v * v + w * w > reach * reach:
                    continue
                for i in range(window[0, 0], window[0, 1]):
                    u = origins[place, 0] + i * steps[0]
                    if u * u + v * v + w * w <= reach * reach and voxels[k, j, i] != padding:
                        if is_counted:
                            slices[count], values[count] = k, voxels[k, j, i]
                            offsets[count, 0], offsets[count, 1], offsets[count, 2] = u, v, w
                        count += 1
    return slices, offsets, values


@njit(cache=True, nogil=True)
def _taken(
    slices: NDArray[np.intp],
    offsets: FloatArray,
    values: FloatArray,
    floors: FloatArray,
    kept: NDArray[np.intp],
) -> tuple[NDArray[np.intp], FloatArray, FloatArray, FloatArray]:
    """Return what is told of the voxels at the places ``kept`` (M,): all at once, in half of the time."""
    count = len(kept)
    some_slices, some_offsets = np.empty(count, np.intp), np.empty((count, 3))
    some_values, some_floors = np.empty(count), np.empty(count)
    for m in range(count):
        n = kept[m]
        some_slices[m], some_values[m], some_floors[m] = slices[n], values[n], floors[n]
        for a in range(3):
            some_offsets[m, a] = offsets[n, a]
    return some_slices, some_offsets, some_values, some_floors


def _window(centers: FloatArray, reach: FloatArray, shape: tuple[int, ...]) -> NDArray[np.intp]:
    """First and past-the-last column and row (2, 2) of what is near in any slice, inside the picture."""
    if len(centers) == 0:
        return np.zeros((2, 2), dtype=np.intp)
    low = np.floor(centers.min(axis=0) - reach)
    high = np.ceil(centers.max(axis=0) + reach) + 1
    size = np.array([shape[2], shape[1]])
    return np.stack([np.clip(low, 0, size), np.clip(high, 0, size)], axis=-1).astype(np.intp)
