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
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ronnaplan.ct.grid import SliceGrid
from ronnaplan.geometry import FloatArray
from ronnaplan.localization.examine import LEAST_TOGETHER, Examine, Examined, distinct
from ronnaplan.localization.fit.parameters import W
from ronnaplan.localization.scanner.scan import Scan
from ronnaplan.localization.scanwide.ellipsoid import Ellipsoid, ellipsoid_at
from ronnaplan.localization.scanwide.moving import MEDIAN_SPREAD

LEAST_WRONG = 0.04
"""What is longer by less than this share, or sheared by less than this tangent, is found as a ball."""

LOOSEST = 0.1
"""What blur and the scale's end may have made so much longer tells nothing: balls of metal of 5 mm and less, balls in
slices thicker than 0.3 of their diameter."""

ROUND_SHARE, SIZE_SHARE = 0.06, 0.15
"""Ellipsoids are alike if what makes a ball of one makes such of all that their semi-axes differ by no more than the
first share, and from the stated radius than the second; either beside what blur and the scale's end do."""

LEAST_WITHIN, LEAST_ACROSS, VOXELS = 0.005, 0.01, 0.2
"""Markers tell no less than the first share within the slices and of a shear, and than the second along their normal,
beside so many squares of the voxel's share of the radius: filters, which move curved edges, make less."""

STANDS_OUT, ALIKE_QUANTILE, LEFT_SHARE = 4.0, 0.75, 0.5
"""Nor what is not so many standard errors large, or, once made good, leaves more than this share of it in more than a
quarter of the markers."""

EGG_SHARE, EGG_COUNT = 0.003, 3
"""How far out of round balls are, by as much as so many of them would say: three that agree do so by chance, too."""

LEAST_SQUARE = 1e-9
"""Of a semi-axis, of which a logarithm is taken: medians of shapes that are unlike need not be an ellipsoid's."""


@dataclass(frozen=True)
class Kind:
    """One way to be wrong: ``told`` (amount, grid) says what of; ``map_of`` (amount) makes an ellipsoid of a ball.

    The map (3, 3) is along u, v and w, ``amount_of`` tells from the shape (3, 3) that it makes of a ball how much, and
    ``share_of`` how wrong that is. Markers tell no less than ``least``; pixels alone tell what ``is_within`` slices.
    """

    amount_of: Callable[[FloatArray], FloatArray]
    map_of: Callable[[FloatArray], FloatArray]
    share_of: Callable[[FloatArray], float]
    told: Callable[[FloatArray, SliceGrid], str]
    least: float = math.inf
    is_within: bool = False


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
    kind = min(_kinds(grid), key=lambda kind: float(sum(_axes(usual, kind.map_of(kind.amount_of(usual))))))
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
    kinds = _kinds(scan.volume.grid)
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


def _kinds(grid: SliceGrid) -> Iterator[Kind]:
    """Yield the ways in which a grid may be wrong."""
    slices_mm, rows_mm, columns_mm = grid.typical_gap_mm, grid.row_spacing_mm, grid.column_spacing_mm
    across = "as across"
    table = grid.axes @ (grid.origins_mm[-1] - grid.origins_mm[0])
    # A tilted gantry's table does not go along the slices' normal.
    aside = table[:2] / table[2] if table[2] > 0.0 else np.zeros(2)
    yield _longer((0, 0, 1), f"along the slices' normal {across}", "the slices' distance", slices_mm, aside)
    yield _longer((0, 1, 0), f"down the columns {across}", "the rows' distance", rows_mm)
    yield _longer((1, 0, 0), f"along the rows {across}", "the columns' distance", columns_mm)
    yield _longer((1, 1, 0), "within the slices as along their normal", "the pixels' distance", rows_mm)
    if not math.isclose(rows_mm, columns_mm, rel_tol=LEAST_WRONG):
        yield _exchanged(columns_mm / rows_mm)
    yield from (_sheared(is_tilt=False), _sheared(is_tilt=True))


def _longer(
    along: tuple[int, int, int],
    where: str,
    what: str,
    said_mm: float,
    aside: FloatArray | tuple[float, float] = (0, 0),
) -> Kind:
    """What is wrong by one factor ``along`` some of u, v and w, which the header says to be ``said_mm``.

    Slices lie ``aside`` (2,) along u and v by so much of their distance.
    """
    wrong = np.array(along, dtype=np.bool_)
    is_one = wrong.sum() == 1
    alone = int(np.flatnonzero(wrong if is_one else ~wrong)[0])

    def amount_of(shape: FloatArray) -> FloatArray:
        # The axis that is alone is as long as the other two are not: of whatever size the ball is, and however aside.
        longer = 0.75 * math.log(shape[alone, alone]) - 0.25 * math.log(max(np.linalg.det(shape), LEAST_SQUARE))
        return np.array([math.exp(longer if is_one else -longer)])

    def map_of(factor: FloatArray) -> FloatArray:
        mapped = np.diag(np.where(wrong, factor, 1.0))
        mapped[:2, 2] = (factor - 1.0) * aside
        return mapped

    def share_of(factor: FloatArray) -> float:
        return abs(math.log(float(factor[0])))

    def told(factor: FloatArray, _: SliceGrid) -> str:
        digits = 2 + (share_of(factor) < LEAST_WRONG)
        return (
            f"{factor[0]:.{digits}f} times as long {where}: {what} in the header ({said_mm:.{digits + 1}g} mm) may be "
            f"wrong ({said_mm / factor[0]:.3g}?)"
        )

    is_within = is_one and alone != W
    return Kind(amount_of, map_of, share_of, told, LEAST_WITHIN if is_within else LEAST_ACROSS, is_within)


def _exchanged(ratio: float) -> Kind:
    """Rows' and columns' distances that stand in each other's place; the latter are ``ratio`` times the former."""
    exchanged = np.diag([ratio, 1.0 / ratio, 1.0])

    def told(_: FloatArray, grid: SliceGrid) -> str:
        return (
            f"{ratio**2:.2f} times as long along the rows as down the columns: the distances of rows and columns in "
            f"the header ({grid.row_spacing_mm:.3g} and {grid.column_spacing_mm:.3g} mm) may be exchanged"
        )

    return Kind(lambda _: np.array([ratio]), lambda _: exchanged, lambda _: abs(math.log(ratio)), told)


def _sheared(*, is_tilt: bool) -> Kind:
    """Slices that lie sideways of where they should; where the table's way stands for their distance, it ``is_tilt``.

    The amount is the shear's tangent along u and v, or its sine.
    """

    def cosine(amount: FloatArray) -> float:
        return math.sqrt(max(1.0 - float(amount @ amount), 0.1)) if is_tilt else 1.0

    def amount_of(shape: FloatArray) -> FloatArray:
        return np.asarray(shape[:2, 2] / shape[2, 2])

    def map_of(amount: FloatArray) -> FloatArray:
        mapped = np.eye(3)
        mapped[:, 2] = np.append(amount, 1.0) / cosine(amount)
        return mapped

    def tangent(amount: FloatArray) -> float:
        return float(np.linalg.norm(amount)) / cosine(amount)

    def told(amount: FloatArray, _: SliceGrid) -> str:
        degrees, digits = math.degrees(math.atan(tangent(amount))), int(tangent(amount) < LEAST_WRONG)
        return f"sheared by {degrees:.{digits}f} degrees from slice to slice, as where a gantry's tilt was lost"

    return Kind(amount_of, map_of, tangent, told, LEAST_WITHIN)
