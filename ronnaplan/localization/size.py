"""The sizes of the balls in a scan, found without being told.

Only what looks like a sphere is fitted (`anysize`), once; a second time, with what a head does to its image made good,
where no size is that of `MIN_MARKERS` balls. Where only the commonest size is asked for, what can no longer change it
is not fitted.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np

from ronnaplan.ct.progress import advancing
from ronnaplan.ct.volume import WAYS_TO_A_VOLUME, CTVolume
from ronnaplan.errors import RefusedError, check_type
from ronnaplan.geometry import FloatArray
from ronnaplan.localization.build import SOLID, Build
from ronnaplan.localization.examine import OF_THE_SHAPE, Examined, distinct, examine_place
from ronnaplan.localization.fit.parameters import BACKGROUND, CONTRAST
from ronnaplan.localization.fit.shading import PLATEAU_SHARE
from ronnaplan.localization.scanner.scan import Scan
from ronnaplan.localization.scanwide.slant import along_the_blur
from ronnaplan.localization.scanwide.thick import as_thick, as_thin
from ronnaplan.localization.scanwide.usual import OF_THE_PROFILE, judged_again, usual_of
from ronnaplan.localization.search.anysize import SEARCHED_MM, Place, round_places
from ronnaplan.localization.search.coarse import COARSE_FLOOR_MM, coarsen
from ronnaplan.text import counted
from ronnaplan.threads import in_threads, single_threaded_algebra

LARGE_MM = 5.0 * COARSE_FLOOR_MM
"""The size of a ball as large as this shows as well in a copy of voxels of `COARSE_FLOOR_MM`."""

SAME_SIZE = 0.03
"""Balls whose diameters differ by at most this share are of one kind."""

MAY_BE_SAME = 0.25
"""What has not been fitted may come out as large as what differs by at most this share: fits are given up at 0.15."""

FIRST_FITTED = 8
"""So many of the roundest places are fitted before anybody asks which of the others can still matter."""

MIN_MARKERS = 3
"""Fewer balls of one size could be anything; a registration needs three."""


@dataclass(frozen=True)
class Size:
    """A kind of ball in a scan: the middle of its fitted diameters, and how many there are."""

    diameter_mm: float
    count: int
    is_hidden: bool = False
    """Whether the scale ends so far below the contrast of most, and of all but two, that nobody sees how large."""

    def __str__(self) -> str:
        spheres = counted(self.count, "sphere")
        if self.is_hidden:
            return f"{spheres} of about {self.diameter_mm:.0f} mm, brighter than the scan's scale"
        return f"{spheres} of {self.diameter_mm:.2f} mm"


def sizes_seen(volume: CTVolume, marker: Build = SOLID, *, progress: bool = False) -> tuple[Size, ...]:
    """Return the kinds of balls in a scan, commonest first, of equally common ones the largest first.

    ``marker`` says how they are made.
    """
    return _sizes(volume, marker, progress, lambda _, places, fitted: _left(places, fitted))


def common_diameter(
    volume: CTVolume, expected: int | None = None, marker: Build = SOLID, *, progress: bool = False
) -> float:
    """Return the diameter (mm) of the commonest kind of ball in a scan, or of the one that ``expected`` balls have.

    Raises `RefusedError`, with the sizes that are there as proposals, when no `MIN_MARKERS` balls have one size,
    several sizes are equally common, or the scale's end hides the size.
    """
    return common_sizes(volume, expected, marker, progress=progress)[0].diameter_mm


def common_sizes(
    volume: CTVolume, expected: int | None, marker: Build, *, progress: bool = False
) -> tuple[Size, ...]:
    """Return the kind that `common_diameter` goes by, and then the others of `MIN_MARKERS` balls that were seen.

    Refuses as that does.  Of the others there may be more balls, which were not fitted.
    """
    sizes = _sizes(volume, marker, progress, partial(_undecided, expected))
    first = commonest(sizes, expected)
    return (first, *(size for size in sizes if size.count >= MIN_MARKERS and size is not first))


def commonest(sizes: Sequence[Size], expected: int | None) -> Size:
    """Return the first of ``sizes``, or the one that ``expected`` balls have; refuse as `common_diameter` does."""
    sets = [size for size in sizes if size.count >= MIN_MARKERS]
    wanted = [size for size in sets if size.count == expected] or [
        size for size in sets if size.count == sets[0].count
    ]
    if len(wanted) == 1 and wanted[0].is_hidden:
        raise RefusedError(f"{wanted[0]}: that hides their size; state --diameter")
    if len(wanted) == 1:
        return wanted[0]
    if not sets:
        raise RefusedError(f"no {MIN_MARKERS} balls of one size were found; {proposal(sizes)}")
    raise RefusedError(f"{len(wanted)} sizes of balls are equally common; {proposal(wanted)}")


def proposal(sizes: Iterable[Size]) -> str:
    """Return what was seen and which ``--diameter`` to try, in one clause."""
    seen = tuple(sizes)
    if not seen:
        return (
            f"no sphere of {SEARCHED_MM[0]:g} to {SEARCHED_MM[1]:g} mm was seen; hollow and wrapped ones are looked "
            "for where --marker says so"
        )
    told = [size for size in seen if not size.is_hidden]
    if not told:
        return f"seen: {', '.join(map(str, seen))}: state --diameter"
    tries = [f"{size.diameter_mm:.1f}" for size in told if size.count >= MIN_MARKERS] or [
        f"{told[0].diameter_mm:.1f}"
    ]
    both = f" or --diameter {','.join(tries)} for all" if len(tries) > 1 else ""
    return f"seen: {', '.join(map(str, seen))}: try {' or '.join(f'--diameter {one}' for one in tries)}{both}"


def told_of_others(sizes: Sequence[Size], expected: int | None) -> tuple[str, ...]:
    """Return a warning where no number said that the first of ``sizes`` is meant, as `common_sizes` gave them."""
    if len(sizes) < 2 or expected is not None:
        return ()
    return (f"balls of {sizes[0].diameter_mm:.2f} mm are taken, the commonest; {proposal(sizes)}",)


def _sizes(
    volume: CTVolume,
    marker: Build,
    progress: bool,
    wanted: Callable[[Scan, Sequence[Place], Mapping[int, Examined]], list[int]],
) -> tuple[Size, ...]:
    """Return the kinds of balls in a scan, by fits at those of its round places that are ``wanted``.

    That tells which have to be fitted next, by their numbers, once some of them are.
    """
    check_type(volume, CTVolume, "the volume", WAYS_TO_A_VOLUME)
    scan = as_thin(Scan.of(volume))
    coarse = Scan(coarsen(scan.volume, COARSE_FLOOR_MM), whole=scan)

    def scan_for(diameter_mm: float) -> Scan:
        return coarse if marker == SOLID and diameter_mm >= LARGE_MM else scan

    def fitted_in(scan: Scan, places: Sequence[Place]) -> list[Examined]:
        return list(in_threads(lambda place: _fitted(scan, *place, marker), places))

    # numba's functions release the interpreter's lock
    with single_threaded_algebra():
        places = round_places(scan, coarse.volume, marker, progress)
        fitted = _fitted_at(
            places,
            lambda place: _fitted(scan_for(place[1]), *place, marker),
            partial(wanted, scan),
            progress,
        )
        thick = as_thick(scan, fitted, fitted_in)
        if thick is not scan:
            scan = coarse = thick  # `scan_for` goes by them
            fitted = fitted_in(scan, places)
        turned = along_the_blur(scan, fitted, marker)
        if turned is not scan:
            scan = coarse = turned
            fitted = fitted_in(scan, places)
        shown = replace(usual_of(fitted), balls=())  # balls of several sizes have no misfit in common
        judged = [judged_again(scan_for(one.stated_mm), one, marker, shown) for one in fitted]
        sizes = _sizes_of(judged, scan)
        if all(size.count < MIN_MARKERS for size in sizes):
            sizes = _sizes_of(in_threads(lambda one: _in_full(scan, one, marker), judged), scan)
    return sizes


def _sizes_of(judged: Iterable[Examined], scan: Scan) -> tuple[Size, ...]:
    """Return the kinds of the balls among what was ``judged``, commonest first, of equally common ones the largest."""
    accepted = distinct(one for one in judged if one.is_marker)
    kinds = [[accepted[n] for n in kind] for kind in _runs([one.diameter_mm for one in accepted], SAME_SIZE)]
    sizes = [_size_of(kind, scan) for kind in kinds]
    return tuple(sorted(sizes, key=lambda size: (-size.count, -size.diameter_mm)))


def _size_of(kind: Sequence[Examined], scan: Scan) -> Size:
    """Return the size of a kind: of those of its balls that show it, where these are `MIN_MARKERS`."""
    shown = [one for one in kind if not _is_hidden(one, scan)]
    tells = shown if len(shown) >= MIN_MARKERS else kind
    is_hidden = tells is kind and 2 * len(shown) <= len(kind)
    return Size(float(np.median([one.diameter_mm for one in tells])), len(kind), is_hidden)


def _fitted_at(
    places: Sequence[Place],
    fit: Callable[[Place], Examined],
    wanted: Callable[[Sequence[Place], Mapping[int, Examined]], list[int]],
    progress: bool,
) -> list[Examined]:
    """Fit balls at those of the ``places``, roundest first, that are ``wanted``; return the fits in their order."""
    fitted: dict[int, Examined] = {}

    def fits() -> Iterator[Examined]:
        while asked := wanted(places, fitted):
            for n, one in zip(asked, in_threads(fit, [places[n] for n in asked]), strict=True):
                fitted[n] = one
                yield one

    for _ in advancing(fits(), len(places), progress, "fitting balls"):
        pass
    return [fitted[n] for n in sorted(fitted)]


def _left(places: Sequence[Place], fitted: Mapping[int, Examined]) -> list[int]:
    """Return which of the ``places`` have not been ``fitted``."""
    return [n for n in range(len(places)) if n not in fitted]


def _undecided(
    expected: int | None, scan: Scan, places: Sequence[Place], fitted: Mapping[int, Examined]
) -> list[int]:
    """Return which of the ``places`` have to be fitted next to know the commonest kind, or that of ``expected`` balls.

    First the roundest, then all of a kind that is common enough to be it; of others the least round, which come to
    nothing soonest, as many as may not be balls before it is sure that they are too few. Where no kind is common enough
    all are fitted, to be proposed.
    """
    if any(one.failures and one.failed <= OF_THE_PROFILE for one in fitted.values()):
        return _left(places, fitted)  # these may be balls, if all of the scan are such
    most = max((size.count for size in _sizes_of(fitted.values(), scan)), default=0)
    enough = max(most if expected is None else min(most, expected), MIN_MARKERS)
    may_be = [n for n in range(len(places)) if n not in fitted or fitted[n].is_marker]
    kinds = _runs([fitted[n].diameter_mm if n in fitted else places[n][1] for n in may_be], MAY_BE_SAME)
    common: list[int] = []
    others: list[int] = []
    for kind in kinds:
        left = sorted(may_be[n] for n in kind if may_be[n] not in fitted)
        if len(kind) - len(left) >= enough or (not fitted and len(kind) >= enough):
            common += left
        else:
            others += left[::-1][: max(len(kind) - enough + 1, 0)]
    if not fitted and common:
        return sorted(common)[:FIRST_FITTED]
    return sorted(common or others) or ([] if most >= MIN_MARKERS else _left(places, fitted))


def _fitted(scan: Scan, center_mm: FloatArray, diameter_mm: float, marker: Build) -> Examined:
    """Fit and judge a ball of about this size; once more where only the size was not right."""

    def at(center_mm: FloatArray, diameter_mm: float) -> Examined:
        return examine_place(scan, center_mm, diameter_mm, marker, for_its_size=True)

    first = at(center_mm, diameter_mm)
    if first.is_marker or not first.failed <= {"diameter"} | OF_THE_PROFILE:
        return first
    return at(first.center_mm, first.diameter_mm)


def _in_full(scan: Scan, one: Examined, marker: Build) -> Examined:
    """Fit a ball whose shape alone was turned down with what a head does to its image made good, and judge it."""
    if one.is_marker or not one.failed <= OF_THE_SHAPE:
        return one
    return examine_place(scan, one.center_mm, one.diameter_mm, marker)


def _is_hidden(one: Examined, scan: Scan) -> bool:
    """Whether the scale ends so far below a ball's contrast that nobody sees how large it is."""
    return bool(scan.ceiling_hu - one.parameters[BACKGROUND] < PLATEAU_SHARE * one.parameters[CONTRAST])


def _runs(diameters_mm: Sequence[float], apart: float) -> list[list[int]]:
    """Sort diameters into runs without a gap larger than the share ``apart``; return each one's numbers."""
    ordered = sorted(range(len(diameters_mm)), key=lambda n: diameters_mm[n])
    runs = [[first] for first in ordered[:1]]
    for smaller, larger in pairwise(ordered):
        if diameters_mm[larger] > diameters_mm[smaller] * (1.0 + apart):
            runs.append([])
        runs[-1].append(larger)
    return runs
