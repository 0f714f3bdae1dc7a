"""A quick look at nearest voxels: it spares most candidates the fit, and tells what of a ball the scan holds."""

from __future__ import annotations

import itertools
import math

import numpy as np
from numpy.typing import NDArray

from kernelcache import njit
from ronnaplan.bounds import METAL_HU
from ronnaplan.ct.volume import CTVolume, Voxels
from ronnaplan.geometry import FloatArray
from ronnaplan.localization.build import Build
from ronnaplan.localization.fit.algebra import ranked
from ronnaplan.localization.fit.cells import CELL_COUNT, cell_directions
from ronnaplan.localization.fit.directions import BACKGROUND_QUANTILE
from ronnaplan.localization.fit.guess import margin_mm
from ronnaplan.localization.search.detect import MIN_CONTRAST_HU
from ronnaplan.threads import in_parts

SCREW_REACH_MM, SCREW_MM, SCREW_STEP_MM = 25.0, 2.0, 0.5
"""A screw is looked for so far beyond the ball, so far beside each direction in every way, in these steps."""

LEAST_HELD = 0.05
"""What touches fewer of a ball's directions than this share does not hold it: noise leaves out single ones."""

MARGIN_SHARE = 0.7
"""Where this share of the blur's reach is left behind, it is as dark as the surroundings."""

GLANCES = ((24, 0.5), (48, 0.75), (CELL_COUNT, 1.0))
"""So many directions tell that most places are nothing like a ball, by less than such a part of what is wanted."""

_SPREAD = np.arange(CELL_COUNT) * 37 % CELL_COUNT
"""An order of the directions in which the first ones look to all sides."""


def surface_shares(
    volume: CTVolume,
    centers_mm: FloatArray,
    diameter_mm: float,
    build: Build,
    thickness_mm: FloatArray,
    least: float,
) -> FloatArray:
    """Share (N,) of directions in which the image falls from a ball's level to its surroundings' at its surface.

    A fit at such a place of ``centers_mm`` (N, 3), where slices are ``thickness_mm`` (N,) thick, cannot cover more of
    the surface. Where a glance shows far less than the ``least`` share that is wanted (`GLANCES`), it is left at that.
    """
    radius_mm = diameter_mm / 2.0
    directions = cell_directions()[_SPREAD] @ volume.grid.axes.T
    depth_mm = build.wall_mm / 2.0 if build.wall_mm else radius_mm / 2.0
    inner_mm = (radius_mm - depth_mm) * directions
    outer_mm = (radius_mm + max(build.layer_mm, 0.0) + MARGIN_SHARE * margin_mm(0.0)) * directions
    per_thickness = MARGIN_SHARE * (margin_mm(1.0) - margin_mm(0.0)) * np.abs(directions[:, 2:]) * directions
    places_mm = np.ascontiguousarray(centers_mm @ volume.grid.axes.T)
    lookup = lookup_of(volume)

    def fallen(first: int, end: int) -> FloatArray:
        some = slice(first, end)
        return _fallen(places_mm[some], thickness_mm[some], inner_mm, outer_mm, per_thickness, least, *lookup)

    return np.concatenate(in_parts(fallen, len(places_mm)))


def unseen_share(volume: CTVolume, center_mm: FloatArray, radius_mm: float) -> float:
    """Share of the ball's directions whose surface lies outside the scan, or where its voxels are padding."""
    return float(np.mean(np.isnan(sample_nearest(volume, center_mm + radius_mm * cell_directions()))))


def sample_nearest(volume: CTVolume, places_mm: FloatArray) -> FloatArray:
    """Nearest voxel's value (N,) at each place (N, 3) in LPS mm; NaN outside the scan and in its padding."""
    places = np.ascontiguousarray(places_mm @ volume.grid.axes.T)
    values = np.empty(len(places))
    fill_nearest(np.zeros(3), places, *lookup_of(volume), values)
    return values


def held_by(
    volume: CTVolume, center_mm: FloatArray, touching: FloatArray, clear_mm: float, ceiling_hu: float
) -> tuple[FloatArray, bool]:
    """Return the unit vector (3,) in LPS towards what holds a ball, and whether there is metal in it.

    It is the mean of those directions ``touching`` (N, 3) it in which metal lies, or else of all of them; zero where
    these are too few.
    """
    _, of_metal = metal_beyond(volume, center_mm, touching, clear_mm, ceiling_hu)
    is_metal = bool(of_metal.any())
    toward = touching[of_metal if is_metal else slice(None)].sum(axis=0)
    length = float(np.linalg.norm(toward))
    holds = length > 0.0 if is_metal else length > LEAST_HELD * CELL_COUNT
    axis: FloatArray = toward / length if holds else np.zeros(3)
    return axis, is_metal


def metal_beyond(
    volume: CTVolume, center_mm: FloatArray, touching: FloatArray, clear_mm: float, ceiling_hu: float
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return where metal lies (K, 3), from the center, beyond what is ``touching`` (N, 3) a ball, and beyond which.

    What lies no farther than ``clear_mm`` from the center is the ball, or its blur. Where the scale ends below metal,
    at ``ceiling_hu``, what reaches its end may be metal.
    """
    axes, least_hu = volume.grid.axes, min(METAL_HU, ceiling_hu)
    along = clear_mm + np.arange(0.0, SCREW_REACH_MM, SCREW_STEP_MM)
    beside = SCREW_MM * np.array(list(itertools.product((-1.0, 0.0, 1.0), repeat=3)))
    towards, beside = (np.ascontiguousarray(some @ axes.T) for some in (touching, beside))
    places, of_metal = _metal_beyond(
        axes @ center_mm, towards, along, beside, clear_mm, least_hu, *lookup_of(volume)
    )
    return places @ axes, of_metal


Lookup = tuple[Voxels, FloatArray, FloatArray, float]
"""A scan's voxels, its slices' origins (K, 3) along u, v, w, the distances of columns and rows, and the padding."""


def lookup_of(volume: CTVolume) -> Lookup:
    """Return what the compiled functions look voxels up in."""
    grid = volume.grid
    origins_mm = np.ascontiguousarray(grid.origins_mm @ grid.axes.T)
    return volume.voxels_hu, origins_mm, grid.steps_mm, volume.padding_or_nan_hu


@njit(cache=True, nogil=True)
def _metal_beyond(
    place: FloatArray,
    towards: FloatArray,
    along: FloatArray,
    beside: FloatArray,
    clear: float,
    least: float,
    voxels: Voxels,
    origins: FloatArray,
    steps: FloatArray,
    padding: float,
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return offsets (K, 3) from a place with ``least`` HU, and whether any (N,) lies ``towards`` (N, 3) it.

    They are looked for ``along`` each of them, in mm, and ``beside`` (M, 3) that, farther than ``clear`` away.
    """
    room = len(along) * len(beside)
    found, of_metal = np.empty((len(towards) * room, 3)), np.zeros(len(towards), dtype=np.bool_)
    apart, values, total = np.empty((room, 3)), np.empty(room), 0
    for n in range(len(towards)):
        count = 0
        for far in along:
            for b in range(len(beside)):
                square = 0.0
                for a in range(3):
                    apart[count, a] = far * towards[n, a] + beside[b, a]
                    square += apart[count, a] ** 2
                count += square > clear * clear
        fill_nearest(place, apart[:count], voxels, origins, steps, padding, values[:count])
        for m in range(count):
            if values[m] >= least:
                found[total], of_metal[n] = apart[m], True
                total += 1
    return found[:total].copy(), of_metal


@njit(cache=True, nogil=True)
def _fallen(
    places: FloatArray,
    thickness: FloatArray,
    inner: FloatArray,
    outer: FloatArray,
    per_thickness: FloatArray,
    least: float,
    voxels: Voxels,
    origins: FloatArray,
    steps: FloatArray,
    padding: float,
) -> FloatArray:
    """Share (N,) of directions in which it is bright at ``inner`` (M, 3) from each place and dark at ``outer``.

    The latter lies farther out by ``per_thickness`` (M, 3) times the slices' ``thickness`` (N,). Each of the `GLANCES`
    must show its part of the ``least``.
    """
    shares = np.zeros(len(places))
    count = len(inner)
    inside, outside, known, beyond = np.empty(count), np.empty(count), np.empty(count), np.empty((count, 3))
    for n in range(len(places)):
        first = 0
        for end, part in GLANCES:
            for m in range(first, end):
                for a in range(3):
                    beyond[m, a] = outer[m, a] + thickness[n] * per_thickness[m, a]
            fill_nearest(places[n], inner[first:end], voxels, origins, steps, padding, inside[first:end])
            fill_nearest(places[n], beyond[first:end], voxels, origins, steps, padding, outside[first:end])
            shares[n] = _share(inside[:end], outside[:end], known)
            if shares[n] < part * least:
                break
            first = end
    return shares


@njit(cache=True, nogil=True)
def _share(inside: FloatArray, outside: FloatArray, known: FloatArray) -> float:
    """Share of directions that are bright ``inside`` (M,) and dark ``outside`` (M,); NaN is unknown.

    ``known`` (M or more,) is room to work in.
    """
    bright = _known(inside, known)
    if bright == 0:
        return 0.0
    high = ranked(known[:bright], bright // 2)
    dark = _known(outside, known)
    if dark == 0:
        return 0.0
    low = ranked(known[:dark], int(BACKGROUND_QUANTILE * (dark - 1)))
    if high - low < MIN_CONTRAST_HU:
        return 0.0
    middle, fallen = (high + low) / 2.0, 0
    for n in range(len(inside)):
        fallen += inside[n] > middle and outside[n] < middle
    return fallen / len(inside)


@njit(cache=True, nogil=True)
def _known(values: FloatArray, known: FloatArray) -> int:
    """Fill ``known`` with those of ``values`` (M,) that are no NaN; return how many there are."""
    count = 0
    for value in values:
        known[count] = value
        count += not math.isnan(value)
    return count


@njit(cache=True, nogil=True)
def fill_nearest(
    place: FloatArray,
    offsets: FloatArray,
    voxels: Voxels,
    origins: FloatArray,
    steps: FloatArray,
    padding: float,
    values: FloatArray,
) -> None:
    """Fill ``values`` (M,) with the nearest voxel's at ``offsets`` (M, 3) from ``place``, along u, v, w.

    NaN outside the scan, which ends half a voxel beyond the last ones, and in its padding.
    """
    nearest = np.empty((len(offsets), 3), dtype=np.intp)
    _find_nearest(place, offsets, voxels.shape, origins, steps, nearest)
    # Where all of them are is known by now, so that the memory is waited for but once.
    for n in range(len(offsets)):
        values[n] = np.nan
        k, j, i = nearest[n]
        if k >= 0 and voxels[k, j, i] != padding:
            values[n] = voxels[k, j, i]


@njit(cache=True, nogil=True, error_model="numpy")
def _find_nearest(
    place: FloatArray,
    offsets: FloatArray,
    shape: tuple[int, int, int],
    origins: FloatArray,
    steps: FloatArray,
    nearest: NDArray[np.intp],
) -> None:
    """Fill ``nearest`` (M, 3) with the slice, row and column of the voxel at each place; slice -1 outside the scan."""
    count, rows, columns = shape
    last = count - 1
    k = int((place[2] - origins[0, 2]) / max(origins[last, 2] - origins[0, 2], 1e-9) * last)
    k = min(max(k, 0), last)
    for n in range(len(offsets)):
        nearest[n, 0] = -1
        w = place[2] + offsets[n, 2]
        while k > 0 and origins[k - 1, 2] >= w:
            k -= 1
        while k <= last and origins[k, 2] < w:
            k += 1
        if 0 < k <= last:
            k -= int(w - origins[k - 1, 2] < origins[k, 2] - w)
        elif last > 0:
            end, before = (0, 1) if k == 0 else (last, last - 1)
            k = end
            if abs(w - origins[end, 2]) > 0.5 * abs(origins[end, 2] - origins[before, 2]):
                continue
        else:
            k = 0
        i = int(np.floor((place[0] + offsets[n, 0] - origins[k, 0]) / steps[0] + 0.5))
        j = int(np.floor((place[1] + offsets[n, 1] - origins[k, 1]) / steps[1] + 0.5))
        if 0 <= i < columns and 0 <= j < rows:
            nearest[n, 0], nearest[n, 1], nearest[n, 2] = k, j, i
