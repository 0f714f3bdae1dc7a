"""The sizes of the balls in a scan, found without being told.

Votes for balls of a few sizes give places; where half the image's step lies in every direction from there gives each a
sphere, and so its size; only what looks like a sphere is fitted, once.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from ronnaplan.ct.progress import advancing
from ronnaplan.ct.volume import CTVolume
from ronnaplan.errors import RefusedError, check_type
from ronnaplan.geometry import FloatArray
from ronnaplan.localization.build import SOLID, Build
from ronnaplan.localization.coarse import COARSE_FLOOR_MM, Blocks, blocks, coarse_voxel_mm, coarsen
from ronnaplan.localization.detect import detect_in
from ronnaplan.localization.examine import Examined, Scan, distinct, examine_place
from ronnaplan.localization.hardened import Head
from ronnaplan.localization.look import surface_shares
from ronnaplan.localization.measured import measured
from ronnaplan.localization.parameters import BACKGROUND, CONTRAST
from ronnaplan.localization.parts import single_threaded_algebra
from ronnaplan.localization.shading import PLATEAU_SHARE
from ronnaplan.localization.slant import along_the_blur
from ronnaplan.localization.sphere import LEAST_SHOWN, spheres_at
from ronnaplan.localization.thick import as_thick
from ronnaplan.localization.usual import OF_THE_PROFILE, judged_again, usual_of
from ronnaplan.threads import in_threads

SEARCHED_MM = (3.0, 26.0)
"""Markers in use have diameters within this range."""

STEP = 1.25
"""Each size voted for is this much larger than the last: votes gather in cells of a sixth of the diameter."""

COARSEST_SHARE = 1.0 / 2.9
"""Voxels in which a ball of any size is still seen, as a share of its diameter: its sphere is sought in finer ones."""

MOST_LOOKED_AT = 1500
"""The strongest candidates of each size that are looked at; noise has thousands of small ones."""

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
    is_hidden: bool = False
    """Whether the scale ends so far below their contrast that nobody sees how large they are."""

    def __str__(self) -> str:
        spheres = f"{self.count} sphere{'s' * (self.count > 1)}"
        if self.is_hidden:
            return f"{spheres} of about {self.diameter_mm:.0f} mm, brighter than the scan's scale"
        return f"{spheres} of {self.diameter_mm:.2f} mm"


def sizes_seen(volume: CTVolume, marker: Build = SOLID, *, progress: bool = False) -> tuple[Size, ...]:
    """Return the kinds of balls in a scan, commonest first, of equally common ones the largest first.

    ``marker`` says how they are made.
    """
    check_type(volume, CTVolume, "the volume", "read_ct returns one")
    scan = Scan(measured(volume))
    coarse = Scan(coarsen(scan.volume, COARSE_FLOOR_MM), whole=scan)
    with single_threaded_algebra():
        places = _round_places(scan, coarse.volume, marker, progress)

    def scan_for(diameter_mm: float) -> Scan:
        return coarse if marker == SOLID and diameter_mm >= LARGE_MM else scan

    def fitted_in(scan: Scan, places: Sequence[tuple[FloatArray, float]]) -> list[Examined]:
        return list(in_threads(lambda place: _fitted(scan, *place, marker), places))

    # numba's functions release the interpreter's lock
    with single_threaded_algebra():
        fits = in_threads(lambda place: _fitted(scan_for(place[1]), *place, marker), places)
        fitted = list(advancing(fits, len(places), progress, "fitting balls"))
        thick = as_thick(scan, fitted, fitted_in)
        if thick is not scan:
            scan = coarse = thick
            fitted = fitted_in(scan, places)
        turned = along_the_blur(scan, fitted, marker)
        if turned is not scan:
            scan = coarse = turned
            fitted = fitted_in(scan, places)
        shown = replace(usual_of(fitted), balls=())  # balls of several sizes have no misfit in common
        judged = [judged_again(scan_for(one.stated_mm), one, marker, shown) for one in fitted]
    accepted = distinct(one for one in judged if one.is_marker)
    sizes = [
        Size(float(np.median(kind)), len(kind), is_hidden)
        for is_hidden in (False, True)
        for kind in _kinds([one.diameter_mm for one in accepted if _is_hidden(one, scan) == is_hidden])
    ]
    return tuple(sorted(sizes, key=lambda size: (-size.count, -size.diameter_mm)))


def common_diameter(
    volume: CTVolume, expected: int | None = None, marker: Build = SOLID, *, progress: bool = False
) -> float:
    """Return the diameter (mm) of the commonest kind of ball in a scan, or of the one that ``expected`` balls have.

    Raises `RefusedError`, with the sizes that are there as proposals, when no `MIN_MARKERS` balls have one size,
    several sizes are equally common, or the scale's end hides the size.
    """
    sizes = sizes_seen(volume, marker, progress=progress)
    sets = [size for size in sizes if size.count >= MIN_MARKERS]
    wanted = [size for size in sets if size.count == expected] or [
        size for size in sets if size.count == sets[0].count
    ]
    if len(wanted) == 1 and wanted[0].is_hidden:
        raise RefusedError(f"{wanted[0]}: that hides their size; state --diameter")
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
    told = [size for size in seen if not size.is_hidden]
    if not told:
        return f"seen: {', '.join(map(str, seen))}: state --diameter"
    tries = [f"{size.diameter_mm:.1f}" for size in told if size.count >= MIN_MARKERS] or [
        f"{told[0].diameter_mm:.1f}"
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

    copies: dict[Blocks, list[float]] = {}  # several sizes share one
    for diameter_mm in diameters_mm:
        copies.setdefault(blocks(coarse, coarse_voxel_mm(diameter_mm, COARSEST_SHARE)), []).append(diameter_mm)

    def voted(sizes_mm: list[float]) -> list[tuple[FloatArray, float]]:
        copy = coarsen(coarse, coarse_voxel_mm(sizes_mm[0], COARSEST_SHARE))
        balls: list[tuple[FloatArray, float]] = []
        for diameter_mm, candidates in zip(sizes_mm, detect_in(copy, sizes_mm), strict=True):
            places = candidates.centers_mm[:MOST_LOOKED_AT]
            thickness_mm = scan.thickness_mm(places)
            shares = surface_shares(volume, places, diameter_mm, marker, thickness_mm, LEAST_SHOWN)
            balls += [(place, diameter_mm) for place in places[shares >= LEAST_SHOWN]]
        return balls

    tried = advancing(in_threads(voted, copies.values()), len(copies), progress, "trying sizes")
    found = [ball for some in tried for ball in some]
    if not found:
        return []
    looked_at = np.array([place for place, _ in found]), np.array([size for _, size in found])
    spheres = list(zip(*spheres_at(volume, *looked_at, marker), strict=True))
    kept: list[tuple[FloatArray, float]] = []
    for center_mm, diameter_mm, share in sorted(spheres, key=lambda sphere: -sphere[2]):
        if share == 0.0:
            break
        if all(math.dist(center_mm, other) >= size / 2.0 for other, size in kept):
            kept.append((center_mm, float(diameter_mm)))
    return kept


def _fitted(scan: Scan, center_mm: FloatArray, diameter_mm: float, marker: Build) -> Examined:
    """Fit and judge a ball of about this size; once more where only the size was not right.

    What a head does to its image moves its center, but hardly changes its size.
    """

    def at(center_mm: FloatArray, diameter_mm: float) -> Examined:
        return examine_place(scan, center_mm, diameter_mm, marker, head=Head.LEFT)

    first = at(center_mm, diameter_mm)
    if first.is_marker or not first.failed <= {"diameter", "certainty"} | OF_THE_PROFILE:
        return first
    return at(first.center_mm, first.diameter_mm)


def _is_hidden(one: Examined, scan: Scan) -> bool:
    return bool(scan.ceiling_hu - one.parameters[BACKGROUND] < PLATEAU_SHARE * one.parameters[CONTRAST])


def _kinds(diameters_mm: list[float]) -> list[list[float]]:
    """Sort diameters into runs without a gap larger than `SAME_SIZE`."""
    ordered = sorted(diameters_mm)
    kinds = [[first] for first in ordered[:1]]
    for smaller, larger in pairwise(ordered):
        if larger > smaller * (1.0 + SAME_SIZE):
            kinds.append([])
        kinds[-1].append(larger)
    return kinds
