"""Did the head move while a marker was scanned? What the fit leaves over is held against what motion makes of a ball.

Slices taken one after another show a ball that moved at different places: above and below a jump, in turn where it
goes to and fro, more and more where it drifts. Where all slices are made of one turn (cone beams, and within a helix)
each edge is seen from the directions that touch it, at their time: its opposite edges move together, and the places
they tell differ with the direction in which the edge faces. A still ball has one place, whatever its size, its blur
and its shape: all of these are even in the direction, so that the odd harmonics from the third on are left for motion.

Each pattern is a displacement of the edges; its amplitude (mm) is fitted to the residuals beside all parameters of the
ball, and its standard error taken from the residuals' own correlation within slices and sectors. What still scans show
beyond that (streaks, posts, slanted rays) is counted as `PATTERN_ERRORS_MM`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ronnaplan.geometry import FloatArray
from ronnaplan.localization.cells import cell_directions, direction_cells
from ronnaplan.localization.descent import residuals_and_jacobian
from ronnaplan.localization.directions import (
    BACKGROUND_QUANTILE,
    INSERT_SHARE,
    cell_means,
    deep_inside,
    edge_depth,
    within_reach,
)
from ronnaplan.localization.parameters import CENTER, RADIUS, WIDTH, U, V, W
from ronnaplan.localization.refine import BallFit

SECTORS = 8
"""Each slice is cut into so many sectors, whose residuals are taken to be independent."""

JUMPS = (-0.4, 0.0, 0.4)
"""Heights at which a jump is looked for, as shares of the radius."""

PATTERNS = (
    *(f"jump {axis} at {place:+.1f}" for place in JUMPS for axis in "uvw"),
    *("drift u", "drift v", "turns u", "turns v"),
    *("third cos", "third sin", "fifth cos", "fifth sin", "across cos", "across sin"),
)
"""What is looked for: jumps between slices, along u, v and w; a drift from slice to slice; places that differ between
odd and even slices; and places that differ with the direction of the edges, within the slices and across them."""

OF_SLICES = PATTERNS.index("third cos")
ACROSS = PATTERNS.index("across cos") - OF_SLICES
SLICED_SHARE = 0.7
"""The first ones differ from slice to slice, which two or three slices do not tell from the shape of their profile:
they are not looked for where that is wider than this share of the radius."""

PATTERN_ERRORS_MM = np.array([*[0.012, 0.012, 0.020] * 3, 0.012, 0.012, 0.003, 0.003, *[0.004] * 4, 0.006, 0.006])
"""Standard deviation of each pattern in still scans, beyond noise."""

ERROR_FACTOR = 1.5
"""Residuals are more alike than sectors of one slice show: their standard errors count so many times."""

BEYOND_MM = (0.3, 1.5)
STANDS_SHARE = 0.1
CLEAR_DEG = 30.0
"""Something stands in a direction that is brighter by this share of the contrast so far beyond the blurred edge, where
the edge of a ball that moved does not reach; directions closer than this angle are left out with it."""

WORTH_A_LOOK = 1.0
"""A pattern that is less than so many standard errors large needs no other explanation."""

STEP_MM = 0.05
"""Step of the second derivatives."""

LEAST_LEFT = 0.1
"""A pattern of which less than this share is left beside the ball's own parameters says nothing."""

LIMIT = 4.0
"""A marker is suspected when a pattern is so many standard errors large. Of the still markers of `docs/localization.md`
fewer than one in two hundred are."""

SHARED = 1.5
"""What is alike in all markers of a scan is less by this factor than what differs between them, in still scans."""


MEDIAN_SPREAD = 1.25
"""Standard error of a median over that of a mean. One marker that met a jump does not speak for the others."""

LEAST_TOGETHER = 3
"""So many markers say together what none says alone."""


@dataclass(frozen=True)
class Movement:
    """How far a marker's edges seem to have moved: ``amplitudes_mm`` and ``errors_mm`` (P,) of `PATTERNS`.

    Patterns that the voxels do not tell are NaN.
    """

    amplitudes_mm: FloatArray
    errors_mm: FloatArray

    @property
    def statistic(self) -> float:
        """The largest amplitude in units of its standard error."""
        return _largest(self.amplitudes_mm / np.hypot(self.errors_mm, PATTERN_ERRORS_MM))

    @property
    def odd_mm2(self) -> FloatArray:
        """Mean squares (3,) of the odd harmonics: of those within the slices along u and v, of those across along w.

        Harmonics that the voxels do not tell count as none.
        """
        squares = np.nan_to_num(self.amplitudes_mm[OF_SLICES:]) ** 2
        within, across = float(np.mean(squares[:ACROSS])), float(np.mean(squares[ACROSS:]))
        return np.array([within, within, across])


def movement(fit: BallFit) -> Movement:
    """Fit every pattern to the residuals of a ball; beside a slanted blur, where any stands out."""
    used = _unattached(fit)
    plain = _movement(fit, used, fit.jacobian[used])
    if plain.statistic <= WORTH_A_LOOK:
        return plain
    return _movement(fit, used, np.hstack([fit.jacobian[used], _slanted_blur(fit, used)]))


def _movement(fit: BallFit, used: NDArray[np.bool_], explained: FloatArray) -> Movement:
    """Fit every pattern to the residuals of the ``used`` voxels beside what is ``explained`` (N, Q) by other causes."""
    offsets = fit.neighbourhood.offsets_mm[used] - fit.theta[CENTER]
    slices = fit.neighbourhood.indices[used, 0]
    turn = np.arctan2(offsets[:, 1], offsets[:, 0])
    jacobian, residuals = fit.jacobian[used], fit.residuals_hu[used]
    patterns = _patterns(jacobian, offsets[:, W] / fit.theta[RADIUS], turn, slices)
    own, _ = np.linalg.qr(explained / np.maximum(np.linalg.norm(explained, axis=0), 1e-30))
    left = patterns - own @ (own.T @ patterns)
    squares = np.sum(left**2, axis=0)
    tells = squares > LEAST_LEFT * np.sum(patterns**2, axis=0)
    if float(fit.theta[WIDTH]) > SLICED_SHARE * float(fit.theta[RADIUS]):
        tells[:OF_SLICES] = False
    squares = np.where(tells, squares, np.nan)
    amplitudes = left.T @ residuals / squares
    sectors = (slices - slices.min(initial=0)) * SECTORS + ((turn / (2 * np.pi) + 0.5) * SECTORS).astype(
        int
    ) % SECTORS
    informed = fit.used[used]
    return Movement(amplitudes, ERROR_FACTOR * _scatter(left, residuals, sectors, informed) / squares)


def _slanted_blur(fit: BallFit, used: NDArray[np.bool_]) -> FloatArray:
    """What a blur whose axes are not those of the slices adds to the ``used`` voxels (N, 4), to first order.

    A Gaussian's covariance changes an image by its second derivatives (the equation of heat): along u and w, v and w, u
    and v, and the difference of those along u and along v.
    """
    changes, around = [], fit.neighbourhood.select(used)
    for axis in (U, V):
        step = np.zeros(len(fit.theta))
        step[axis] = STEP_MM
        sides = [
            residuals_and_jacobian(around, fit.theta + side * step, fit.layer_mm, fit.ceiling_hu)[1]
            for side in (1.0, -1.0)
        ]
        changes.append(sides[0][:, CENTER] - sides[1][:, CENTER])
    by_u, by_v = changes
    return np.column_stack([by_u[:, W], by_v[:, W], by_u[:, V], by_u[:, U] - by_v[:, V]])


def suspected(movements: Sequence[Movement]) -> list[bool]:
    """Whether each marker of a scan shows motion by itself, or all of them do together."""
    if len(movements) < LEAST_TOGETHER:
        return [one.statistic > LIMIT for one in movements]
    amplitudes = np.array([one.amplitudes_mm for one in movements])
    errors = np.hypot(np.array([one.errors_mm for one in movements]), PATTERN_ERRORS_MM)
    told = np.isfinite(amplitudes).all(axis=0)
    middle = np.where(told, np.median(np.nan_to_num(amplitudes), axis=0), np.nan)
    spread = MEDIAN_SPREAD * np.sqrt(np.median(np.nan_to_num(errors**2), axis=0) / len(movements))
    together = _largest(middle / np.hypot(spread, PATTERN_ERRORS_MM / SHARED)) > LIMIT
    return [together or one.statistic > LIMIT for one in movements]


def _unattached(fit: BallFit) -> NDArray[np.bool_]:
    """Voxels (N,) of the ball's edge in all directions in which nothing stands, whether these informed the fit or not.

    A fit leaves out the directions that disagree: where a ball moved, those are half of it.
    """
    around, theta = fit.neighbourhood, fit.theta
    depth, blur = edge_depth(around.offsets_mm, theta)
    cells = direction_cells(around.offsets_mm - theta[CENTER])
    beyond = (depth > 3.0 * blur + BEYOND_MM[0]) & (depth < 3.0 * blur + BEYOND_MM[1])
    outside, seen = cell_means(around.values_hu, cells, beyond)
    if not seen.any():
        return fit.used
    background = float(np.quantile(outside[seen], BACKGROUND_QUANTILE))
    stands = seen & (outside - background > STANDS_SHARE * fit.contrast_hu)
    inside, known = cell_means(fit.residuals_hu, cells, deep_inside(around.offsets_mm, theta))
    if known.any():
        stands |= known & (inside - np.median(inside[known]) > INSERT_SHARE * fit.contrast_hu)
    directions = cell_directions()
    close = directions @ directions[stands].T > np.cos(np.radians(CLEAR_DEG))
    unattached: NDArray[np.bool_] = ~(stands | close.any(axis=1))
    return within_reach(around.offsets_mm, theta) & (unattached[cells] | fit.used)


def _patterns(jacobian: FloatArray, height: FloatArray, turn: FloatArray, slices: NDArray[np.intp]) -> FloatArray:
    """What each pattern of 1 mm adds to the voxels (N, P); ``height`` is a share of the radius."""
    by_u, by_v, by_w = jacobian[:, U], jacobian[:, V], jacobian[:, W]
    outward = by_u * np.cos(turn) + by_v * np.sin(turn)
    jumps = [by * np.where(height > place, 0.5, -0.5) for place in JUMPS for by in (by_u, by_v, by_w)]
    odd = np.where(slices % 2 == 0, 0.5, -0.5)
    turning = [outward * wave(order * turn) for order in (3, 5) for wave in (np.cos, np.sin)]
    across = [by_w * wave(2 * turn) for wave in (np.cos, np.sin)]
    columns = [*jumps, by_u * height, by_v * height, by_u * odd, by_v * odd, *turning, *across]
    return np.stack(columns, axis=-1)


def _scatter(
    left: FloatArray, residuals: FloatArray, sectors: NDArray[np.intp], informed: NDArray[np.bool_]
) -> FloatArray:
    """Root (P,) of the summed squares of what each sector adds to a pattern's amplitude.

    Only voxels that ``informed`` the fit tell it, in proportion: in the others a ball that moved leaves its motion.
    """
    sums = np.zeros((int(sectors.max(initial=0)) + 1, left.shape[1]))
    np.add.at(sums, sectors[informed], (left * residuals[:, np.newaxis])[informed])
    shares = np.sum(left[informed] ** 2, axis=0) / np.maximum(np.sum(left**2, axis=0), 1e-30)
    return np.asarray(np.sqrt(np.sum(sums**2, axis=0) / np.maximum(shares, 1e-9)))


def _largest(ratios: FloatArray) -> float:
    """The largest of the known ratios' absolute values; 0 where none is known."""
    return float(np.max(np.abs(ratios), initial=0.0, where=np.isfinite(ratios)))
