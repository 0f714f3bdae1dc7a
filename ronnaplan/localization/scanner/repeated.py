"""The slices, rows and columns of a scan without those that only repeat their neighbours.

Who resamples a scan to thinner slices or smaller pixels by the nearest voxel stores each slice, row or column several
times over. They come in runs of identical ones, as nothing does that has noise of its own, and where one run ends and
the next begins tells how far apart the scanner's were: each run is what lies nearer to one of evenly spaced places than
to the next. With one of each run, at that place, the scan is again the one that was made. Only where the first place
is stays open, where all runs are equally long by as much as the copies are apart: images say nothing of it.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ronnaplan.ct.scratch import one_by_one
from ronnaplan.ct.volume import CTVolume, VolumeFlag, Voxels
from ronnaplan.geometry import FloatArray
from ronnaplan.localization.scanner.measured import CHANGE_HU, WITHIN_SCALE_HU

LEAST_REPEATED = 3
"""So few slices, rows or columns that repeat the one before may be copies for any reason."""

LEAST_TOLD = 4
"""So many different ones tell how far apart they are."""

PROBES = (0.25, 0.5, 0.75)
"""Slices so far along the stack are looked at first: rows and columns of scans as they were made differ in each."""

TIE = 0.01
"""What lies in the middle of two places goes to either by rounding: to this share of a copy."""


class _Places(NamedTuple):
    """Places ``first + n step``, as indices, each to ``off`` at most."""

    first: float
    step: float
    off: float


def without_copies(volume: CTVolume) -> tuple[CTVolume, FloatArray]:
    """Return the scan without what repeats its neighbours, flagged so; itself where nothing does.

    Beside it the covariance (3, 3) in LPS mm^2 of where all of it is, which copies leave open.
    """
    unplaced_mm2 = np.zeros((3, 3))
    for axis in range(3):
        if axis == 0 and not volume.grid.is_evenly_spaced:
            continue
        places = _places(volume.voxels_hu, axis)
        if places is None:
            continue
        grid = volume.grid
        step_mm = (grid.typical_gap_mm * grid.normal, grid.row_step_mm, grid.column_step_mm)[axis]
        # All of its reach, as if it were a standard error: markers share it, and whoever registers does not know.
        unplaced_mm2 += places.off**2 * np.outer(step_mm, step_mm)
        volume = _at(volume, axis, places).flagged(VolumeFlag.REPEATED)
    return volume, unplaced_mm2


def _at(volume: CTVolume, axis: int, places: _Places) -> CTVolume:
    """Return what lies at ``places`` along an axis of the voxels: of slices 0, of rows 1, of columns 2."""
    count, grid = volume.voxels_hu.shape[axis], volume.grid
    surely = 0.5 - (places.off + TIE) / places.step  # so near to its place what repeats it is its own
    n = np.arange(np.ceil(-places.first / places.step - surely), (count - 1 - places.first) / places.step + surely)
    at = places.first + n * places.step
    nearest = np.clip(np.round(at), 0, count - 1).astype(int)
    voxels_hu: Any = np.ascontiguousarray(np.take(volume.voxels_hu, nearest, axis=axis))
    if axis == 0:
        return replace(volume, voxels_hu=voxels_hu, grid=grid.at_slices(at))
    steps_mm = [grid.row_step_mm, grid.column_step_mm]
    origins_mm = grid.origins_mm + at[0] * steps_mm[axis - 1]
    steps_mm[axis - 1] = places.step * steps_mm[axis - 1]
    kept = replace(grid, origins_mm=origins_mm, row_step_mm=steps_mm[0], column_step_mm=steps_mm[1])
    return replace(volume, voxels_hu=voxels_hu, grid=kept)


def _places(voxels_hu: Voxels, axis: int) -> _Places | None:
    """Return where the scanner's slices, rows or columns were; None where none are repeated, or not evenly."""
    repeats, changes = _repeated_slices(voxels_hu) if axis == 0 else _repeated_lines(voxels_hu, axis)
    told = np.flatnonzero(changes)
    if len(told) < LEAST_TOLD or np.count_nonzero(repeats & changes) < LEAST_REPEATED:
        return None
    first, last = int(told[0]), int(told[-1])
    starts = first + 1 + np.flatnonzero(~repeats[first + 1 : last + 1])
    return _evenly(first, starts, last) if len(starts) >= LEAST_TOLD else None


def _repeated_slices(voxels_hu: Voxels) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Tell of each slice whether it repeats the one before, and whether it shows anything (K,).

    The middle row tells nearly all.
    """
    repeats = np.zeros(len(voxels_hu), dtype=np.bool_)
    middle = voxels_hu[:, voxels_hu.shape[1] // 2]
    repeats[1:] = (middle[1:] == middle[:-1]).all(axis=1)
    if np.count_nonzero(repeats) < LEAST_REPEATED:
        return repeats, np.zeros_like(repeats)
    for k in np.flatnonzero(repeats):
        repeats[k] = np.array_equal(voxels_hu[k], voxels_hu[k - 1])
    return repeats, np.array([_changes(plane.reshape(1, -1))[0] for plane in one_by_one(voxels_hu)])


def _repeated_lines(voxels_hu: Voxels, axis: int) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Tell of each row (``axis`` 1) or column whether it repeats the one before in all slices, and shows anything."""
    along: Any = voxels_hu if axis == 1 else voxels_hu.swapaxes(1, 2)
    probes = along[[int(share * len(along)) for share in PROBES]]
    repeats = np.zeros(along.shape[1], dtype=np.bool_)
    repeats[1:] = (probes[:, 1:] == probes[:, :-1]).all(axis=(0, 2))
    if np.count_nonzero(repeats) < LEAST_REPEATED:
        return repeats, np.zeros_like(repeats)
    changes: NDArray[np.bool_] = np.any([_changes(probe) for probe in probes], axis=0)
    candidates = np.flatnonzero(repeats)
    if np.count_nonzero(repeats & changes) >= LEAST_REPEATED:
        for plane in one_by_one(voxels_hu):
            lines = plane if axis == 1 else plane.T
            candidates = candidates[(lines[candidates] == lines[candidates - 1]).all(axis=1)]
    repeats[:] = False
    repeats[candidates] = True
    return repeats, changes


def _changes(lines_hu: Voxels) -> NDArray[np.bool_]:
    """Whether each line (N, M) shows more than one value within the scale: air that is cut off repeats anywhere."""
    low_hu, high_hu = WITHIN_SCALE_HU
    within = (lines_hu > low_hu) & (lines_hu < high_hu)
    most = np.where(within, lines_hu, low_hu).max(axis=1)
    least = np.where(within, lines_hu, high_hu).min(axis=1)
    changes: NDArray[np.bool_] = most - least > CHANGE_HU
    return changes


def _evenly(first: int, starts: NDArray[np.intp], last: int) -> _Places | None:
    """Return the even places of the runs that begin at ``first`` and at ``starts`` (N,) and end at ``last``.

    Place and distance of them lie in a polygon, of which each run cuts off two sides. Its centroid is taken. None where
    nothing is left of it.
    """
    wide = float(last - first)
    corners = np.array([[first - wide, 1.0], [last, 1.0], [last, wide], [first - wide, wide]])
    corners = _cut(corners, np.array([1.0, -0.5]), first + TIE)
    corners = _cut(corners, np.array([-1.0, -len(starts) - 0.5]), TIE - last)
    for n, start in enumerate(starts.tolist()):
        # Between the places n and n + 1 lies what is between the last of one run and the first of the next.
        corners = _cut(corners, np.array([1.0, n + 0.5]), start + TIE)
        corners = _cut(corners, np.array([-1.0, -n - 0.5]), 1.0 + TIE - start)
    if len(corners) < 3:
        return None
    middle = _centroid(corners)
    ends = np.array([[1.0, 0.0], [1.0, len(starts)]])
    off = float(np.abs((corners - middle) @ ends.T).max())
    return _Places(float(middle[0]), float(middle[1]), off)


def _cut(corners: FloatArray, normal: FloatArray, most: float) -> FloatArray:
    """Return the part of a convex polygon (N, 2) in which ``normal`` (2,) times a point is ``most`` at most."""
    if not len(corners):
        return corners
    beyond = corners @ normal - most
    if (beyond <= 0.0).all():
        return corners
    kept: list[FloatArray] = []
    for n in range(len(corners)):
        here, before = beyond[n], beyond[n - 1]
        if (here > 0.0) != (before > 0.0):
            share = before / (before - here)
            kept.append(corners[n - 1] + share * (corners[n] - corners[n - 1]))
        if here <= 0.0:
            kept.append(corners[n])
    return np.array(kept).reshape(-1, 2)


def _centroid(corners: FloatArray) -> FloatArray:
    """Return the centroid (2,) of a convex polygon (N, 2)."""
    origin = corners[0]
    one, other = corners - origin, np.roll(corners, -1, axis=0) - origin
    doubled = one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]
    middle: FloatArray = origin + doubled @ (one + other) / (3.0 * doubled.sum())
    return middle
