"""How distinguishable a marker layout is, told from its CT points alone, before any tracker reading."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from kernelcache import njit
from ronnaplan.bounds import SMALLEST_SIGMA_MM
from ronnaplan.correspondence.collinear import COLLINEAR_SIGMAS
from ronnaplan.correspondence.evidence import (
    FEW_PAIRS,
    MOST_ODDS_IF_LARGER,
    SCALE_PRIORS,
    SCALES,
    fit,
    fits_as_well,
    log_misfit,
    log_misfit_at,
)
from ronnaplan.correspondence.exact import LISTED_NATS
from ronnaplan.correspondence.graph import distances
from ronnaplan.correspondence.inputs import check_probability, checked_points
from ronnaplan.correspondence.pairing import LEAST_PROBABILITY, IntArray
from ronnaplan.correspondence.rivals import LEAST_REGULAR
from ronnaplan.errors import InputError
from ronnaplan.geometry import MIRROR, FloatArray, require_sigma
from ronnaplan.rigid import freedom
from ronnaplan.sigmas import SIGMA_CT_MM, SIGMA_OTS_MM

MOST_LAYOUT_POINTS = 32
"""Larger sets are point clouds, not marker layouts."""

GREATEST_REFUSAL = 0.01
"""A layout is unambiguous when correspondence would refuse it less often than this."""

MOST_LAYOUT_VISITS = 1_000_000
"""Orders tried before the search stops with the nearest rival found so far."""

MIRROR_REACH_MM = 20.0
"""Layouts farther from their mirror image are not told apart by how far: left-handed readings of them are noticed."""

QUADRATURE_STEPS = 60
LOWEST_SIGMAS = 2.4
"""Equally probable values of each chi^2 at which a refusal is looked at; the lowest lies so far below the mean."""


@dataclass(frozen=True, eq=False)
class Layout:
    """How distinguishable a marker layout is.

    Attributes
    ----------
    rival_distance_mm
        How far the markers are from fitting onto themselves in another order: the root sum of squared residuals of
        the best such fit.  Zero for a symmetric layout (equilateral triangle, square, two points at one place).
    rival
        (n,) that other order: marker i would be taken for marker ``rival[i]``.
    line_distance_mm
        Root-mean-square distance of the markers from their best line; zero when collinear.
    mirror_distance_mm
        How far the markers are from fitting onto their mirror image in any order, their own among them, as a root sum
        of squares, too; `MIRROR_REACH_MM` at most.  Of a layout that is flat, or alike on the left and the right, it is
        zero: nothing tells left-handed readings of it.  Of dense layouts of more than 20 markers, of which the search
        stops before all orders are tried (`MOST_LAYOUT_VISITS`), it may be less.

    """

    rival_distance_mm: float
    rival: IntArray
    line_distance_mm: float
    mirror_distance_mm: float

    def __repr__(self) -> str:
        return (
            f"Layout({len(self.rival)} markers, nearest rival order {self.rival_distance_mm:.2f} mm away, "
            f"{self.line_distance_mm:.2f} mm RMS from a line, {self.mirror_distance_mm:.2f} mm from its mirror image)"
        )

    def refusal_probability(
        self,
        sigma_ct_mm: float = SIGMA_CT_MM,
        sigma_ots_mm: float = SIGMA_OTS_MM,
        least_probability: float = LEAST_PROBABILITY,
    ) -> float:
        """Return how often `match_points` refuses this layout for its nearest rival (all seen, no outliers).

        With d the rival distance over the standard deviation of a pair's difference, the rival's chi^2 lies above
        the truth's by d^2 on average, with standard deviation 2 d; the truth's own has 3 n - 6 degrees of freedom,
        and both count as the evidence counts them, the scale of the errors unknown; of few pairs, the rival also as
        were its errors the largest; and of regular layouts, whether it fits as well.  Raises `InputError` for what
        `match_points` cannot use.
        """
        require_sigma(sigma_ct_mm, "the CT error")
        require_sigma(sigma_ots_mm, "the tracker error")
        check_probability(least_probability)
        sigma = max(math.hypot(sigma_ct_mm, sigma_ots_mm), SMALLEST_SIGMA_MM)
        if self.line_distance_mm < COLLINEAR_SIGMAS * sigma:
            return 1.0
        d, size = max(self.rival_distance_mm / sigma, 1e-9), len(self.rival)
        agree = int((self.rival == np.arange(size)).sum())
        regular = size >= LEAST_REGULAR and 2 * agree <= size
        needed = math.log(least_probability / (1.0 - least_probability))
        if_larger = -math.log(MOST_ODDS_IF_LARGER) if size <= FEW_PAIRS else -math.inf
        # Of errors of the largest scale that is admitted a gap tells least: where it still does, nothing is refused.
        most_needed = max(needed, if_larger - math.log(SCALE_PRIORS[-1]), LISTED_NATS if regular else -math.inf)
        if d * (d - 2.0 * LOWEST_SIGMAS) > 2.0 * max(SCALES) ** 2 * most_needed:
            return 0.0
        from scipy.special import gammaincinv, ndtri  # which take longer to load than most layouts to judge

        levels = (np.arange(QUADRATURE_STEPS) + 0.5) / QUADRATURE_STEPS
        truths = np.asarray(2.0 * gammaincinv(freedom(size) / 2.0, levels), dtype=np.float64)
        gaps = d * d + 2.0 * d * ndtri(levels)
        return float(refused_share(truths, gaps, size, needed, if_larger, regular))


@njit(cache=True, nogil=True, error_model="numpy")
def refused_share(
    truths: FloatArray, gaps: FloatArray, size: int, needed: float, if_larger: float, regular: bool
) -> float:
    """Return the share of the truth's chi^2 and the rival's excess at which neither is ``needed`` nats ahead.

    Or not ``if_larger`` nats ahead of the other were its errors the largest of `SCALES`, or, where the layout is
    ``regular``, the other is listed and fits as well.
    """
    refused = 0
    for truth in truths:
        for gap in gaps:
            rival = max(truth + gap, 0.0)
            least, other = min(truth, rival), max(truth, rival)
            best = log_misfit(least, size)
            behind = best - log_misfit(other, size)
            if (
                behind < needed
                or best - log_misfit_at(other, size, SCALES[-1]) < if_larger
                or (regular and behind < LISTED_NATS and fits_as_well(least, size, other, size))
            ):
                refused += 1
    return refused / (len(truths) * len(gaps))


def describe_layout(points: ArrayLike) -> Layout:
    """Describe the layout of markers at ``points`` (n, 3), in mm, n from 3 to 32; under 1 ms for eight markers.

    Mirror images do not count as rivals, for no head turns into its mirror image; a flat layout that equals its
    mirror image does, for it can be turned over.  How near the mirror image is tells whether left-handed readings would
    be noticed.  Raises `InputError` for unusable points.
    """
    checked = checked_points(points, "marker positions")
    if len(checked) > MOST_LAYOUT_POINTS:
        raise InputError(f"{len(checked)} markers were given; a layout has at most {MOST_LAYOUT_POINTS}")
    square, rival = nearest_rival(checked, checked, math.inf)
    about = checked.T - checked.mean(axis=0)[:, np.newaxis]  # by numpy's `cov` it takes longer
    values = np.maximum(np.linalg.eigvalsh(about @ about.T * (1.0 / len(checked))), 0.0)
    in_own_order = 4.0 * len(checked) * float(values[0])  # as far as the markers lie off their best plane, twice
    mirrored = nearest_rival(checked, checked * MIRROR, min(in_own_order, MIRROR_REACH_MM**2))[0]
    return Layout(math.sqrt(square), rival, math.sqrt(float(values[0] + values[1])), math.sqrt(mirrored))


def mirror_distance(points: ArrayLike) -> float:
    """Return how far markers (n, 3), in mm, are from fitting onto their mirror image in another order.

    It counts where only distances are known, which do not tell a layout from its mirror image; see `describe_layout`.
    """
    checked = checked_points(points, "marker positions")
    return math.sqrt(nearest_rival(checked, checked * MIRROR, math.inf)[0])


@njit(cache=True, nogil=True, error_model="numpy")
def swapped_pairs(
    points: FloatArray, goals: FloatArray, weight: FloatArray, index: IntArray
) -> tuple[float, IntArray]:
    """Return the least chi^2 among the orders (n,) that exchange two of the points (n, 3), and that order."""
    n = len(points)
    best, rival = np.inf, index.copy()
    for a in range(n):
        for b in range(a):
            order = index.copy()
            order[a], order[b] = b, a
            chi2 = fit(points, goals, weight, index, order, n, 1.0)[0]
            if chi2 < best:
                best, rival = chi2, order
    return best, rival


@njit(cache=True, nogil=True, error_model="numpy")
def nearest_rival(points: FloatArray, goals: FloatArray, bound: float) -> tuple[float, IntArray]:
    """Return the least sum of squared residuals over every order but the given one, and that order.

    What does not fit within ``bound`` is not sought: then that is returned, with an order of two exchanged points.

    ``goals`` (n, 3), which the points are fitted onto, are the points or their mirror image: distances are the same.

    Branch and bound: the residuals of a partial order never exceed those of its completions, and those of any two
    points are at least half their squared difference in distance.
    """
    n = len(points)
    d, weight, index = distances(points), np.ones((n, n)), np.arange(n)
    best, rival = swapped_pairs(points, goals, weight, index)
    best = min(best, bound)
    order, used = np.full(n, -1), np.zeros(n, np.bool_)
    depth = visits = 0
    while depth >= 0 and visits < MOST_LAYOUT_VISITS:
        if order[depth] >= 0:
            used[order[depth]] = False
        order[depth] = next_choice(d, order, used, depth, best)
        if order[depth] < 0:
            depth -= 1
            continue
        visits += 1
        if depth >= 2:
            chi2 = fit(points, goals, weight, index, order, depth + 1, 1.0)[0]
            if chi2 >= best:
                continue
            if depth == n - 1:
                if is_another(order, index):
                    best, rival = chi2, order.copy()
                continue
        used[order[depth]] = True
        depth += 1
    return best, rival


@njit(cache=True, nogil=True)
def is_another(order: IntArray, index: IntArray) -> bool:
    """Return whether two orders (n,) differ."""
    differing = 0
    for a in range(len(index)):
        differing += order[a] != index[a]
    return differing > 0


@njit(cache=True, nogil=True, error_model="numpy")
def next_choice(d: FloatArray, order: IntArray, used: NDArray[np.bool_], depth: int, best: float) -> int:
    """Return the next unused partner of point ``depth`` whose distances (n, n) alone do not exceed the bound, or -1."""
    for choice in range(order[depth] + 1, len(d)):
        if used[choice]:
            continue
        fits = True
        for a in range(depth):
            if 0.5 * (d[a, depth] - d[order[a], choice]) ** 2 >= best:
                fits = False
                break
        if fits:
            return choice
    return -1
