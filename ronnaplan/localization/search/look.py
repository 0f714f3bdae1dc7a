"""A quick look at nearest voxels: it spares most candidates the fit."""

from __future__ import annotations

import math

import numpy as np

from kernelcache import njit
from ronnaplan.ct.volume import CTVolume, Voxels
from ronnaplan.geometry import FloatArray
from ronnaplan.localization.build import Build
from ronnaplan.localization.fit.algebra import ranked
from ronnaplan.localization.fit.cells import BACKGROUND_QUANTILE, CELL_COUNT, cell_directions
from ronnaplan.localization.fit.depth import margin_mm
from ronnaplan.localization.search.detect import MIN_CONTRAST_HU
from ronnaplan.localization.search.nearest import fill_nearest, lookup_of
from ronnaplan.threads import in_parts

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
    # Places that share slices one after another: the strongest first would wait for the memory.
    upwards, lookup = np.argsort(places_mm[:, 2], kind="stable"), lookup_of(volume)
    places_mm, thickness_mm = places_mm[upwards], thickness_mm[upwards]

    def fallen(first: int, end: int) -> FloatArray:
        some = slice(first, end)
        return _fallen(places_mm[some], thickness_mm[some], inner_mm, outer_mm, per_thickness, least, *lookup)

    shares = np.empty(len(places_mm))
    shares[upwards] = np.concatenate(in_parts(fallen, len(places_mm)))
    return shares


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
