"""The ways in which a grid of slices may be wrong: what ellipsoid each makes of a ball, and how it is told."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from ronnaplan.ct.grid import SliceGrid
from ronnaplan.geometry import FloatArray
from ronnaplan.localization.fit.parameters import W

LEAST_WRONG = 0.04
"""What is longer by less than this share, or sheared by less than this tangent, is found as a ball."""

LEAST_WITHIN, LEAST_ACROSS = 0.005, 0.01
"""Markers tell no less than the first share within the slices and of a shear, and than the second along their
normal."""

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


def kinds_of(grid: SliceGrid) -> Iterator[Kind]:
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
