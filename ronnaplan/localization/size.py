"""The sizes of the balls in a scan, found without being told.

Votes for balls of a few sizes give places; where half the image's step lies in every direction from there gives each a
sphere, and so its size; only what looks like a sphere is fitted, once.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ronnaplan.ct.progress import advancing
from ronnaplan.ct.volume import CTVolume
from ronnaplan.errors import RefusedError, check_type
from ronnaplan.geometry import FloatArray
from ronnaplan.localization.build import SOLID, Build
from ronnaplan.localization.cells import cell_directions
from ronnaplan.localization.detect import COARSE_FLOOR_MM, coarsen, detect
from ronnaplan.localization.examine import Examined, Scan, distinct, examine_place
from ronnaplan.localization.look import sample_nearest, surface_shares
from ronnaplan.localization.parts import single_threaded_algebra

SEARCHED_MM = (3.0, 26.0)
"""Markers in use have diameters within this range."""

STEP = 1.25
"""Each size voted for is this much larger than the last: votes gather in cells of a sixth of the diameter."""

MOST_LOOKED_AT = 1500
"""The strongest candidates of each size that are looked at; noise has thousands of small ones."""

LEAST_SHOWN = 0.6
"""A ball falls to its surroundings somewhere in at least this share of the directions ..."""

LEAST_ROUND = 0.72
NEAR_SHARE, NEAR_VOXELS = 0.1, 0.4
"""... and in this share of them within so much of its radius, or so many voxels, from one sphere: balls on posts do so
in 0.95 of them, posts alone in 0.4 to 0.7."""

BALL_RADII = 28
"""Distances from the center at which the image is looked at, up to 1.8 radii."""

LARGE_MM = 8.0 * COARSE_FLOOR_MM
"""The size of a ball as large as this shows as well in a copy of voxels of `COARSE_FLOOR_MM`."""

SAME_SIZE = 0.03
"""Balls whose diameters differ by at most this share are of one kind."""

MIN_MARKERS = 3
"""Fewer balls of one size could be anything; a registration needs three."""


@dataclass(frozen=True)
class Size:
    """A kind of ball in a scan: the middle of its fitted diameters, and how many there are."""

    diameter_mm: float
    count: int

    def __str__(self) -> str:
        return f"{self.count} sphere{'s' * (self.count > 1)} of {self.diameter_mm:.2f} mm"


def sizes_seen(volume: CTVolume, marker: Build = SOLID, *, progress: bool = False) -> tuple[Size, ...]:
    """Return the kinds of balls in a scan, commonest first, of equally common ones the largest first.

    ``marker`` says how they are made.
    """
    check_type(volume, CTVolume, "the volume", "read_ct returns one")
    scan, coarse = Scan(volume), Scan(coarsen(volume, COARSE_FLOOR_MM))
    places = _round_places(scan, coarse.volume, marker, progress)

    def fitted_at(place: tuple[FloatArray, float]) -> Examined:
        center_mm, diameter_mm = place
        shows_coarsely = marker == SOLID and diameter_mm >= LARGE_MM
        return _fitted(coarse if shows_coarsely else scan, center_mm, diameter_mm, marker)

    # numba's functions release the interpreter's lock
    with single_threaded_algebra(), ThreadPoolExecutor(os.cpu_count()) as pool:
        fitted = list(advancing(pool.map(fitted_at, places), len(places), progress, "fitting balls"))
    accepted = distinct(one for one in fitted if one.is_marker)
    kinds = _kinds([one.diameter_mm for one in accepted])
    sizes = [Size(float(np.median(kind)), len(kind)) for kind in kinds]
    return tuple(sorted(sizes, key=lambda size: (-size.count, -size.diameter_mm)))


def common_diameter(
    volume: CTVolume, expected: int | None = None, marker: Build = SOLID, *, progress: bool = False
) -> float:
    """Return the diameter (mm) of the commonest kind of ball in a scan, or of the one that ``expected`` balls have.

    Raises `RefusedError`, with the sizes that are there as proposals, when no `MIN_MARKERS` balls have one size or
    several sizes are equally common.
    """
    sizes = sizes_seen(volume, marker, progress=progress)
    sets = [size for size in sizes if size.count >= MIN_MARKERS]
    wanted = [size for size in sets if size.count == expected] or [
        size for size in sets if size.count == sets[0].count
    ]
    if len(wanted) == 1:
        return wanted[0].diameter_mm
    if not sets:
        raise RefusedError(f"no {MIN_MARKERS} balls of one size were found; {proposal(sizes)}")
    raise RefusedError(f"{len(wanted)} sizes of balls are equally common; {proposal(wanted)}")


def proposal(sizes: Iterable[Size]) -> str:
    """Return what was seen and which ``--diameter`` to try, in one clause."""
    seen = tuple(sizes)
    if not seen:
        return f"no sphere of {SEARCHED_MM[0]:g} to {SEARCHED_MM[1]:g} mm was seen"
    tries = [f"{size.diameter_mm:.1f}" for size in seen if size.count >= MIN_MARKERS] or [
        f"{seen[0].diameter_mm:.1f}"
    ]
    both = f" or --diameter {','.join(tries)} for all" if len(tries) > 1 else ""
    return f"seen: {', '.join(map(str, seen))}: try {' or '.join(f'--diameter {one}' for one in tries)}{both}"


def _round_places(scan: Scan, coarse: CTVolume, marker: Build, progress: bool) -> list[tuple[FloatArray, float]]:
    """Return center (3,) and diameter (mm) of what looks like a sphere, whatever its size.

    Votes are taken from the ``coarse`` copy; those for large balls from a coarser copy of it.
    """
    volume = scan.volume
    smallest_mm = max(SEARCHED_MM[0], 3.0 * volume.grid.row_spacing_mm)
    diameters_mm = np.exp(np.arange(np.log(smallest_mm), np.log(SEARCHED_MM[1]), np.log(STEP))).tolist()

    def voted(diameter_mm: float) -> list[tuple[FloatArray, float]]:
        places = detect(coarse, diameter_mm).centers_mm[:MOST_LOOKED_AT]
        shares = surface_shares(volume, places, diameter_mm, marker, scan.thickness_mm(places), LEAST_SHOWN)
        return [(place, diameter_mm) for place in places[shares >= LEAST_SHOWN]]

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        tried = advancing(pool.map(voted, diameters_mm), len(diameters_mm), progress, "trying sizes")
        found = [ball for some in tried for ball in some]
    spheres = [sphere for ball in found if (sphere := _sphere_at(volume, *ball, marker)) is not None]
    kept: list[tuple[FloatArray, float]] = []
    for center_mm, diameter_mm, _ in sorted(spheres, key=lambda sphere: -sphere[2]):
        if all(np.linalg.norm(center_mm - other) >= size / 2.0 for other, size in kept):
            kept.append((center_mm, diameter_mm))
    return kept


def _sphere_at(
    volume: CTVolume, center_mm: FloatArray, diameter_mm: float, marker: Build
) -> tuple[FloatArray, float, float] | None:
    """Return the sphere on which the image falls off around a place: center, diameter, share of its surface.

    None if there is no such sphere of about ``diameter_mm``.
    """
    directions = len(cell_directions())
    for _ in range(2):  # the second time from the sphere's own center
        falls_mm = _falls(volume, center_mm, diameter_mm / 2.0, marker)
        if len(falls_mm) < LEAST_SHOWN * directions:
            return None
        center_mm, radius_mm = _sphere_through(falls_mm)
        if not 0.6 < 2.0 * radius_mm / diameter_mm < 1.7:
            return None
        diameter_mm = 2.0 * radius_mm
    off_mm = np.abs(np.linalg.norm(falls_mm - center_mm, axis=1) - radius_mm)
    voxel_mm = max(volume.grid.row_spacing_mm, volume.grid.typical_gap_mm)
    near_mm = max(NEAR_SHARE * radius_mm, NEAR_VOXELS * voxel_mm)
    share = np.count_nonzero(off_mm <= near_mm) / directions
    return (center_mm, diameter_mm, share) if share >= LEAST_ROUND else None


def _falls(volume: CTVolume, center_mm: FloatArray, radius_mm: float, marker: Build) -> FloatArray:
    """Return the places (N, 3) at which the image first falls to half its step, of the directions in which it does."""
    directions = cell_directions()
    reach_mm = np.linspace(0.3, 1.8, BALL_RADII) * radius_mm
    places_mm = center_mm + reach_mm[:, np.newaxis, np.newaxis] * directions
    values = sample_nearest(volume, places_mm.reshape(-1, 3)).reshape(places_mm.shape[:2])
    usual = np.nanmedian(values, axis=1)
    start = int(np.nanargmax(usual)) if marker.wall_mm else 0  # what is hollow is dark within
    below = values < (usual[start] + np.nanquantile(values[-1], 0.3)) / 2.0
    below[:start] = False
    first = below.argmax(axis=0)
    falls = below.any(axis=0) & (first > start)
    middle_mm = reach_mm[first[falls]] - (reach_mm[1] - reach_mm[0]) / 2.0
    places: FloatArray = center_mm + middle_mm[:, np.newaxis] * directions[falls]
    return places


def _sphere_through(points_mm: FloatArray) -> tuple[FloatArray, float]:
    """Return center and radius of the sphere through most points (N, 3).

    Least squares of |p|^2 = 2 c . p + r^2 - |c|^2, twice, the second time without what lies off the first sphere.
    """
    used = points_mm
    for _ in range(2):
        design = np.hstack([2.0 * used, np.ones((len(used), 1))])
        solved = np.linalg.lstsq(design, (used**2).sum(axis=1), rcond=None)[0]
        center_mm, radius_mm = solved[:3], float(np.sqrt(max(solved[3] + solved[:3] @ solved[:3], 1e-12)))
        off_mm = np.abs(np.linalg.norm(points_mm - center_mm, axis=1) - radius_mm)
        used = points_mm[off_mm <= 2.0 * np.median(off_mm)]
    return center_mm, radius_mm


def _fitted(scan: Scan, center_mm: FloatArray, diameter_mm: float, marker: Build) -> Examined:
    """Fit and judge a ball of about this size; once more where only the size was not right."""
    first = examine_place(scan, center_mm, diameter_mm, marker)
    if first.is_marker or not {test for test, _ in first.failures} <= {"diameter", "certainty"}:
        return first
    return examine_place(scan, first.center_mm, first.diameter_mm, marker)


def _kinds(diameters_mm: list[float]) -> list[list[float]]:
    """Sort diameters into runs without a gap larger than `SAME_SIZE`."""
    ordered = sorted(diameters_mm)
    kinds = [[first] for first in ordered[:1]]
    for smaller, larger in pairwise(ordered):
        if larger > smaller * (1.0 + SAME_SIZE):
            kinds.append([])
        kinds[-1].append(larger)
    return kinds
