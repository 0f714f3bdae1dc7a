"""Did the head move while a marker was scanned? What the fit leaves over is held against what motion makes of a ball.

Slices taken one after another show a ball that moved at different places: above and below a jump, in turn where it
goes to and fro, more and more where it drifts. Where all slices are made of one turn (cone beams, and within a helix)
each edge is seen from the directions that touch it, at their time: its opposite edges move together, and the places
they tell differ with the direction in which the edge faces. A still ball has one place, whatever its size, its blur
and its shape: all of these are even in the direction, so that the odd harmonics from the third on are left for motion.

Each pattern is a displacement of the edges; its amplitude (mm) is fitted to the residuals beside all parameters of the
ball, and its standard error taken from the residuals' own correlation within slices and sectors. What still scans show
beyond that (streaks, posts, slanted rays) is counted as `PATTERN_ERRORS_MM`. Edges that one turn displaces so have
streaks beside them (`turn`), which tell as much as the edges do.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kernelcache import njit
from ronnaplan.geometry import FloatArray
from ronnaplan.localization.fit.algebra import add_products, inverse
from ronnaplan.localization.fit.ball_fit import BallFit
from ronnaplan.localization.fit.model import BLOCK
from ronnaplan.localization.fit.parameters import BACKGROUND, CENTER, RADIUS, WIDTH, U, V, W
from ronnaplan.localization.judge.edge import Edge
from ronnaplan.localization.judge.turn import ACROSS_SLICES, FIFTH, THIRD, streaks

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
"""Standard deviation of each pattern in still scans, beyond noise: chosen on 546 markers of simulated still scans, one
of which was suspected then, as none of 192 others was."""

ERROR_FACTOR = 1.5
"""Residuals are more alike than sectors of one slice show: their standard errors count so many times, chosen on the
same."""

WORTH_A_LOOK = 1.0
"""A pattern that is less than so many standard errors large needs no other explanation."""

LEAST_LEFT = 0.1
"""A pattern of which less than this share is left beside the ball's own parameters says nothing."""


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
        return largest(self.amplitudes_mm / np.hypot(self.errors_mm, PATTERN_ERRORS_MM))

    @property
    def odd_mm2(self) -> FloatArray:
        """Mean squares (3,) of the odd harmonics: of those within the slices along u and v, of those across along w.

        Beyond what noise makes of them; harmonics that the voxels do not tell count as none.
        """
        noise_mm = self.errors_mm[OF_SLICES:] / ERROR_FACTOR
        squares = np.nan_to_num(self.amplitudes_mm[OF_SLICES:] ** 2 - noise_mm**2)
        within, across = max(float(np.mean(squares[:ACROSS])), 0.0), max(float(np.mean(squares[ACROSS:])), 0.0)
        return np.array([within, within, across])


def movement(edge: Edge) -> Movement:
    """Fit every pattern to what is left over at the edge of a ball; beside a slanted blur, where any stands out."""
    fit, used = edge.fit, edge.used
    offsets, slices = fit.neighbourhood.offsets_mm.take(used, axis=0), fit.neighbourhood.slices[used]
    first, end = (int(slices.min()), int(slices.max()) + 1) if len(slices) else (0, 0)
    offsets = offsets - fit.theta[CENTER]
    beside = streaks(fit.theta, fit.prior.layer_mm, offsets) * fit.jacobian[used, BACKGROUND, np.newaxis]
    voxels = offsets, slices - first, fit.residuals_hu[used], fit.used[used], beside
    sizes = end - first, float(fit.theta[RADIUS])
    products, squares, sums = _products(fit.jacobian, used, edge.slanted, *voxels, *sizes)
    parameters, patterns = fit.jacobian.shape[1], np.arange(products.shape[1], products.shape[2])
    plain = np.r_[np.arange(parameters), patterns]
    told = _movement(fit, products[:, :parameters, plain], squares, sums[..., plain])
    return told if told.statistic <= WORTH_A_LOOK else _movement(fit, products, squares, sums)


def _movement(fit: BallFit, products: FloatArray, squares: FloatArray, sums: FloatArray) -> Movement:
    """Tell the patterns of a ball from what `_products` returns, beside all Q that is there anyway.

    What is left of a pattern beside these is never laid out: sums of products tell all that is asked of it.
    """
    count = products.shape[1]
    both = products.sum(axis=0)
    shares = inverse(both[:, :count].copy()) @ both[:, count:]
    left, informed_left = (
        one_squares
        - 2.0 * np.sum(shares * one[:, count:], axis=0)
        + np.sum(shares * (one[:, :count] @ shares), axis=0)
        for one, one_squares in ((both, squares.sum(axis=0)), (products[1], squares[1]))
    )
    tells = left > LEAST_LEFT * squares.sum(axis=0)
    if float(fit.theta[WIDTH]) > SLICED_SHARE * float(fit.theta[RADIUS]):
        tells[:OF_SLICES] = False
    told = np.where(tells, left, np.nan)
    sums = sums[..., count:] - sums[..., :count] @ shares
    # Only voxels that informed the fit tell the scatter, in proportion: in the others a ball that moved leaves motion.
    informed_share = np.maximum(informed_left / np.maximum(left, 1e-30), 1e-9)
    scatter = np.sqrt(np.sum(sums[1] ** 2, axis=0) / informed_share)
    return Movement(sums.sum(axis=(0, 1)) / told, ERROR_FACTOR * scatter / told)


@njit(cache=True, error_model="numpy", nogil=True)
def _products(
    jacobian: FloatArray,
    used: NDArray[np.intp],
    more: FloatArray,
    offsets: FloatArray,
    slices: NDArray[np.intp],
    residuals: FloatArray,
    informed: NDArray[np.bool_],
    beside: FloatArray,
    levels: int,
    radius: float,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Sum products of what every pattern of 1 mm adds to the ``used`` voxels (N,), what is there anyway, and residuals.

    There anyway are the ball's ``jacobian``, which has rows for other voxels, too, and ``more`` columns for the used.
    Returned are, of the voxels that did not inform the fit and of those that did, these times themselves and the
    patterns (2, Q, Q + P), the patterns' squares (2, P), and the residuals times both in each sector (2, S, Q + P).
    ``slices`` (N,) count from 0, below ``levels``.
    """
    first_more = jacobian.shape[1]
    count, size = first_more + more.shape[1], len(PATTERNS)
    products, squares = np.zeros((2, count, count + size)), np.zeros((2, size))
    sums, one = np.zeros((2, levels * SECTORS, count + size)), np.empty(count + size)
    for which in range(2):
        chosen = np.nonzero(informed == (which == 1))[0]
        for first in range(0, len(chosen), BLOCK):
            some = chosen[first : first + BLOCK]
            told = np.empty((count + size, len(some)))
            for column in range(len(some)):
                n = some[column]
                turn = math.atan2(offsets[n, 1], offsets[n, 0])
                for p in range(first_more):
                    one[p] = jacobian[used[n], p]
                for p in range(first_more, count):
                    one[p] = more[n, p - first_more]
                _fill_patterns(
                    one[:count], offsets[n, W] / radius, turn, slices[n] % 2 == 0, beside[n], one[count:]
                )
                sector = slices[n] * SECTORS + int((turn / (2.0 * math.pi) + 0.5) * SECTORS) % SECTORS
                for p in range(size):
                    squares[which, p] += one[count + p] ** 2
                for p in range(count + size):
                    sums[which, sector, p] += one[p] * residuals[n]
                    told[p, column] = one[p]
            add_products(told, len(some), products[which])
    return products, squares, sums


@njit(cache=True, error_model="numpy", nogil=True)
def _fill_patterns(
    derivatives: FloatArray, height: float, turn: float, is_even: bool, beside: FloatArray, patterns: FloatArray
) -> None:
    """Fill ``patterns`` with what each of 1 mm adds to a voxel; ``height`` is a share of the radius."""
    by_u, by_v, by_w = derivatives[U], derivatives[V], derivatives[W]
    cos, sin = math.cos(turn), math.sin(turn)
    outward = by_u * cos + by_v * sin
    twice_cos, twice_sin = cos * cos - sin * sin, 2.0 * sin * cos
    place = 0
    for jump in JUMPS:
        side = 0.5 if height > jump else -0.5
        for by in (by_u, by_v, by_w):
            patterns[place] = side * by
            place += 1
    odd = 0.5 if is_even else -0.5
    for pattern in (by_u * height, by_v * height, by_u * odd, by_v * odd):
        patterns[place] = pattern
        place += 1
    for which in (THIRD, FIFTH):
        cos, sin = cos * twice_cos - sin * twice_sin, sin * twice_cos + cos * twice_sin
        patterns[place], patterns[place + 1] = (outward + beside[which]) * cos, (outward + beside[which]) * sin
        place += 2
    across = by_w + beside[ACROSS_SLICES]
    patterns[place], patterns[place + 1] = across * twice_cos, across * twice_sin


def largest(ratios: FloatArray) -> float:
    """Return the largest absolute value of the known ratios (N,); 0 where none is known."""
    return float(np.max(np.abs(ratios), initial=0.0, where=np.isfinite(ratios)))
