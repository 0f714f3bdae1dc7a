"""Is a scan's geometry wrong? Markers that are alike ellipsoids tell; where few are found, candidates.

Slices nearer to each other than their header says, spacings of rows and columns that were exchanged, or a gantry's tilt
that was lost make an ellipsoid of every ball, the same one. Nothing of a scan is corrected for it, and no marker is
found by it: the reason is told. It is told only if balls of the stated size are seen once the grid is what it would be
then, for ellipsoids that are alike may be anything.

Of what is wrong by little all balls are found, and their edges tell (`judge.edge`) to a thousandth. Eggs are out of
round each in its own way: what one map of the grid does not make good of three quarters of the markers is theirs.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ronnaplan.ct.grid import SliceGrid
from ronnaplan.geometry import FloatArray
from ronnaplan.localization.examine import LEAST_TOGETHER, Examine, Examined, distinct
from ronnaplan.localization.scanner.scan import Scan
from ronnaplan.localization.scanwide.ellipsoid import Ellipsoid, ellipsoid_at
from ronnaplan.localization.scanwide.moving import MEDIAN_SPREAD
from ronnaplan.localization.scanwide.wrong_grids import LEAST_SQUARE, LEAST_WRONG, Kind, kinds_of

LOOSEST = 0.1
"""What blur and the scale's end may have made so much longer tells nothing: balls of metal of 5 mm and less, balls in
slices thicker than 0.3 of their diameter."""

ROUND_SHARE, SIZE_SHARE = 0.06, 0.15
"""Ellipsoids are alike if what makes a ball of one makes such of all that their semi-axes differ by no more than the
first share, and from the stated radius than the second; either beside what blur and the scale's end do."""

VOXELS = 0.2
"""Markers tell no less than a kind's least, beside so many squares of the voxel's share of the radius: filters, which
move curved edges, make less."""

STANDS_OUT, ALIKE_QUANTILE, LEFT_SHARE = 4.0, 0.75, 0.5
"""Nor what is not so many standard errors large, or, once made good, leaves more than this share of it in more than a
quarter of the markers."""

EGG_SHARE, EGG_COUNT = 0.003, 3
"""How far out of round balls are, by as much as so many of them would say: three that agree do so by chance, too."""


@dataclass(frozen=True)
class Found:
    """How a scan may be wrong by which of its ellipsoids, and how far these are from balls once it is made good."""

    kind: Kind
    amount: FloatArray
    alike: tuple[int, ...]
    off: float


def distortion(
    scan: Scan, examined: Sequence[Examined], markers: Sequence[Examined], examine: Examine
) -> str | None:
    """Return how a scan's geometry may be wrong, by markers, or candidates where these are few or off; else None."""
    told = markers_tell(scan, markers)
    if told is None and (len(markers) < LEAST_TOGETHER or all(one.is_off_size for one in markers)):
        told = _candidates_tell(scan, examined, examine)
    return told


def markers_tell(scan: Scan, markers: Sequence[Examined]) -> str | None:
    """Return how a scan's geometry may be wrong, by the ellipsoids that its ``markers`` are; None if nothing tells."""
    # What lies on a ball makes it another ellipsoid.
    balls = [one for one in markers if one.shows_its_shape]
    if len(balls) < LEAST_TOGETHER or scan.slant is not None:
        return None
    grid, shapes = scan.volume.grid, np.array([one.shape for one in balls])
    usual = np.median(shapes, axis=0)
    kind = min(kinds_of(grid), key=lambda kind: float(sum(_axes(usual, kind.map_of(kind.amount_of(usual))))))
    amounts = np.array([kind.amount_of(one) for one in shapes])
    amount = np.median(amounts, axis=0)
    share, error = kind.share_of(amount), _median_error(amounts - amount)
    left = np.quantile(_axes(shapes, kind.map_of(amount))[0], ALIKE_QUANTILE, method="higher")
    voxel_mm = grid.pixel_mm if kind.is_within else max(grid.pixel_mm, grid.typical_gap_mm)
    least = kind.least + VOXELS * (2.0 * voxel_mm / min(one.stated_mm for one in balls)) ** 2
    if share < max(least, STANDS_OUT * error) or left > LEFT_SHARE * share:
        return None
    return f"{len(balls)} markers are alike ellipsoids (standard error {error:.2%}), {kind.told(amount, grid)}"


def _median_error(apart: FloatArray) -> float:
    """Return the standard error of the medians that N markers are ``apart`` from (N, A), all A of them together."""
    count = len(apart)
    spread2 = count * math.pi / 2.0 * np.mean(np.abs(apart), axis=0) ** 2 + EGG_COUNT * EGG_SHARE**2
    return MEDIAN_SPREAD * math.sqrt(float(spread2.sum()) / (count + EGG_COUNT) / count)


def _candidates_tell(scan: Scan, examined: Sequence[Examined], examine: Examine) -> str | None:
    """Return how a scan's geometry may be wrong, by its candidates as they were ``examined``; None if nothing tells."""
    seen = [(one, ellipsoid_at(scan, one.center_mm, one.stated_mm / 2.0)) for one in examined]
    ellipsoids = _apart(
        [(one.stated_mm, other) for one, other in seen if other is not None and other.loose <= LOOSEST]
    )
    if len(ellipsoids) < LEAST_TOGETHER:
        return None
    kinds = kinds_of(scan.volume.grid)
    found = [one for kind in kinds if (one := _alike(kind, [other for _, other in ellipsoids])) is not None]
    if not found:
        return None
    best = min(found, key=lambda one: (-len(one.alike), one.off))
    loose = float(np.median([ellipsoids[n][1].loose for n in best.alike]))
    if best.kind.share_of(best.amount) < LEAST_WRONG + loose:
        return None
    whole, moved = _made_good(scan, best.kind.map_of(best.amount))
    places = [(moved(ellipsoids[n][1].center_mm), ellipsoids[n][0]) for n in best.alike]
    balls = distinct(one for one in examine(whole, places) if one.is_marker)
    if len(balls) < LEAST_TOGETHER:
        return None
    return f"{len(best.alike)} candidates are alike ellipsoids, {best.kind.told(best.amount, scan.volume.grid)}"


def _apart(ellipsoids: Sequence[tuple[float, Ellipsoid]]) -> list[tuple[float, Ellipsoid]]:
    """The ellipsoids of their stated diameters (mm), one at a place."""
    kept: list[tuple[float, Ellipsoid]] = []
    for diameter_mm, one in ellipsoids:
        near = (float(np.linalg.norm(one.center_mm - other.center_mm)) for _, other in kept)
        if all(apart_mm > diameter_mm / 2.0 for apart_mm in near):
            kept.append((diameter_mm, one))
    return kept


def _alike(kind: Kind, ellipsoids: Sequence[Ellipsoid]) -> Found | None:
    """Return the largest set of ``ellipsoids`` that are balls once one amount is made good."""
    best: Found | None = None
    shapes, loose = np.array([one.shape for one in ellipsoids]), np.array([one.loose for one in ellipsoids])
    for seed in shapes:
        amount = kind.amount_of(seed)
        for _ in range(2):  # once more with what they show at the median
            off, alike = _off_ball(shapes, loose, kind.map_of(amount))
            if len(alike) < LEAST_TOGETHER:
                break
            amount = np.median([kind.amount_of(shapes[n]) for n in alike], axis=0)
        else:
            one = Found(kind, amount, alike, off)
            if best is None or (-len(one.alike), one.off) < (-len(best.alike), best.off):
                best = one
    return best


def _off_ball(shapes: FloatArray, loose: FloatArray, mapped: FloatArray) -> tuple[float, tuple[int, ...]]:
    """Return how far off balls those of the ``shapes`` (N, 3, 3) usually are that the map (3, 3) makes of balls.

    Their numbers are returned, too. Shapes are told to the shares ``loose`` (N,).
    """
    out_of_round, size = _axes(shapes, mapped)
    alike = np.flatnonzero((out_of_round <= ROUND_SHARE + loose) & (size <= SIZE_SHARE + loose))
    off = float(np.median((out_of_round + size)[alike])) if alike.size else math.inf
    return off, tuple(int(n) for n in alike)


def _axes(shapes: FloatArray, mapped: FloatArray) -> tuple[FloatArray, FloatArray]:
    """By which shares semi-axes of ``shapes`` (..., 3, 3) differ, and are not 1, once the map (3, 3) is made good."""
    back = np.linalg.inv(mapped)
    axes = 0.5 * np.log(np.maximum(np.linalg.eigvalsh(back @ shapes @ back.T), LEAST_SQUARE))
    return np.ptp(axes, axis=-1), np.abs(axes.mean(axis=-1))


def _made_good(scan: Scan, mapped: FloatArray) -> tuple[Scan, Callable[[FloatArray], FloatArray]]:
    """Return the scan as it would be if the map (3, 3) were made good, and what moves a place (3,) of it along."""
    grid = scan.volume.grid
    back = grid.axes.T @ np.linalg.inv(mapped) @ grid.axes
    first_mm = grid.origins_mm[0]

    def moved(place_mm: FloatArray) -> FloatArray:
        place: FloatArray = first_mm + (place_mm - first_mm) @ back.T
        return place

    thickness_mm = None if grid.thickness_mm is None else grid.thickness_mm / float(mapped[2, 2])
    steps_mm = back @ grid.row_step_mm, back @ grid.column_step_mm
    return Scan(
        replace(scan.volume, grid=SliceGrid(moved(grid.origins_mm), *steps_mm, thickness_mm)), whole=scan
    ), moved
