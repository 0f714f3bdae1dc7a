"""Which directions about a fitted ball show a ball, and what stands in the others.

What touches a marker (post, screw, skin, another marker) covers some directions only. They are recognized by the
residuals on the ball's surface and by what lies just outside it, and the fit does without them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from kernelcache import njit
from ronnaplan.geometry import FloatArray
from ronnaplan.localization.fit.algebra import quantile
from ronnaplan.localization.fit.ball import Discs, discs
from ronnaplan.localization.fit.cells import BACKGROUND_QUANTILE, CELL_COUNT, cell_directions, direction_cell
from ronnaplan.localization.fit.depth import SURFACE_BLURS, depth_and_blur, reach_mm, squares_within_reach
from ronnaplan.localization.fit.model import BLOCK, evaluate, has_skin, is_beyond_scale, shown_hu
from ronnaplan.localization.fit.neighbourhood import Neighbourhood
from ronnaplan.localization.fit.parameters import (
    BACKGROUND,
    CONTRAST,
    PARAMETERS,
    RADIUS,
    SKIN_PARAMETERS,
    U,
    V,
    W,
)

OUTLIER_RATIO = 2.5
"""A direction disagrees when its residual exceeds the usual direction's by this factor."""

MODEL_ERROR_SHARE = 0.03
"""Share of the contrast by which a clean direction may always disagree: real blur is not quite Gaussian."""

NEIGHBOUR_SHARE = 0.03
NEIGHBOUR_HU = 400.0
"""Something just outside that exceeds the background by this share of the contrast, or by so much, is a neighbour. The
share is of what the scale shows of the contrast: plastic is not faint beside the foot of a clipped edge."""

ATTACHED_SHARE = 0.5
"""Something just outside that exceeds the background by this share of the contrast is part of the same body."""

INSERT_SHARE = 0.06
"""Something deep inside that exceeds the ball by this share of the contrast is an insert, whose blur reaches out."""

VOID_SHARE = 0.2
"""Something deep inside that is fainter by this share of the contrast is a void, as moulding leaves one. It is more
than for inserts: under a kernel that overshoots, a ball is fainter by a tenth beside its post than elsewhere."""

DARK_QUANTILE, MOST_HELD = 0.05, 0.4
"""The share of what is seen is asked no closer than streaks darken so many directions, as they brighten others, and
only of what a mount holds: what has more beside it than the second lies in skin or gel."""

USUAL_QUANTILE = 0.3
"""The usual direction is a good one: with an insert and a post, more than half of them may be disturbed."""

SPREAD_SHARE = 0.15
NEIGHBOUR_ANGLE_DEG = 26.0
"""A neighbour brighter than this share of the contrast also spoils the directions this close to its own, for
blur carries its light there; one that is faint beside the ball does not."""

ROUND_SHARE, ROUND_MM = 0.015, 0.06
"""An edge that is off by no more than this share of the radius plus this is where the ball's edge should be."""

NOISE_ERRORS = 2.0
"""Nor does it tell where noise alone puts it: so many standard errors are allowed for besides."""

MAX_RAGGED = 0.14
"""A ball on skin is round but where it goes on into it and this share: plastic shows 0.11, pegs 0.17 to 0.30."""

COVER_SHARE, COVER_TO_DARK = 0.06, 3.0
"""What lies on a marker is brighter just outside it by this share of the contrast, in more directions by this factor
than are as dark: streaks are both. Haze is brighter by 0.04 to 0.06 beside a third of the markers of cone beams."""

COVERED_SHARE, COVERED_SPREAD = 0.15, 0.6
"""What carries a marker stands on one side of it. What is bright in more of the directions, and to all sides, so that
their mean is shorter than the second, lies on the marker (a post: 0.8; tape, hair: 0.3)."""


@dataclass(frozen=True)
class Verdict:
    """What the directions about a ball say, each of the `CELL_COUNT` (C)."""

    state: NDArray[np.int8]
    """1 where a direction informs the fit (C,), 0 where it is left out, -1 where no voxel lies on the surface."""
    off_mm: FloatArray
    """How far beyond where the ball's should be the edge is (C,), negative where it lies farther in."""
    off_mm_per_hu: FloatArray
    """What noise adds to that (C,)."""
    allowed_mm: float
    """How far off an edge may be without noise."""
    attached_share: float
    """Share of all directions in which a body as bright as the ball goes on outward."""
    usual_rms_hu: float
    """A good direction's residual."""
    beside: NDArray[np.bool_]
    """In which directions (C,) something is just outside."""
    excess_hu: FloatArray
    """How much brighter than the background that is (C,)."""
    is_covered: bool
    """Whether it lies to all sides instead of one."""
    noise_hu: float = 0.0
    """The noise that is allowed for."""

    @cached_property
    def off_share(self) -> FloatArray:
        """How far off each edge is (C,), as a share of what is allowed in this noise."""
        return self.off_mm / np.hypot(self.allowed_mm, NOISE_ERRORS * self.noise_hu * self.off_mm_per_hu)

    @cached_property
    def round_share(self) -> float:
        """Share of the directions seen whose edge is where the ball's should be."""
        off = np.abs(self.off_share[self.state >= 0])
        return np.count_nonzero(off <= 1.0) / len(off) if len(off) else 0.0

    @property
    def ragged_share(self) -> float:
        """Share of the directions seen in which there is neither a sphere's edge nor a body that goes on outward."""
        seen = np.count_nonzero(self.state >= 0) / len(self.state)
        return 1.0 - self.round_share - (self.attached_share / seen if seen > 0.0 else 0.0)

    def in_noise(self, noise_hu: float) -> Verdict:
        """Return what the directions say where voxels are as noisy as this."""
        return replace(self, noise_hu=noise_hu)


Judged = tuple[Verdict, NDArray[np.bool_]]
"""What the directions say, and which voxels (N,) of a neighbourhood are those of the directions that agree."""


def judge_directions(around: Neighbourhood, theta: FloatArray, layer_mm: float) -> Judged:
    """Judge every direction by the voxels (N,) within reach; tell which of these agree with the ball ``theta`` (P,)."""
    voxels = around.offsets_mm, around.values_hu, around.floors_hu
    told, agreeing = _survey(*voxels, theta, layer_mm, discs(theta), around.ceiling_hu, cell_directions())
    return Verdict(*told), agreeing


Told = tuple[NDArray[np.int8], FloatArray, FloatArray, float, float, float, NDArray[np.bool_], FloatArray, bool]
"""The first members of `Verdict`, in their order."""

SEEN, SQUARES, SHIFTS, STEEPNESS, OUTSIDE, UNEXPLAINED, CUT_OFF, INSIDE, WITHIN = range(9)
"""What is summed in each direction. On the surface: how many voxels there are, their squared residuals, and their
residuals times and their squares of the slope by the radius; just outside and deep inside: how many, and what the model
does not explain beside the ball, or at all; outside also how many the scale cut off, bright by what was given back."""


@njit(cache=True, error_model="numpy", nogil=True)
def _survey(
    offsets_mm: FloatArray,
    values_hu: FloatArray,
    floors_hu: FloatArray,
    theta: FloatArray,
    layer_mm: float,
    looked_up: Discs,
    ceiling_hu: float,
    directions: FloatArray,
) -> tuple[Told, NDArray[np.bool_]]:
    """What the voxels within reach tell of each direction, and which voxels (N,) those that agree are."""
    sums, end = np.zeros((9, CELL_COUNT)), len(theta) - (len(SKIN_PARAMETERS) - 1 if has_skin(theta) else 0)
    cells, zones, near = _within_reach(offsets_mm, values_hu, floors_hu, theta, end, sums)
    for first in range(0, len(near), BLOCK):
        some = near[first : first + BLOCK]
        model, jacobian = evaluate(offsets_mm[some], theta, layer_mm, *looked_up)
        for n in range(len(some)):
            at, cell = some[n], cells[some[n]]
            share = 0.0 if is_beyond_scale(values_hu[at], model[n], floors_hu[at], ceiling_hu) else 1.0
            residual, slope = share * (values_hu[at] - model[n]), share * jacobian[n, RADIUS]
            if zones[at] == OUTSIDE:
                for p in range(len(PARAMETERS), end):  # streaks and skin
                    sums[UNEXPLAINED, cell] -= share * jacobian[n, p] * theta[p]
            elif zones[at] == SEEN:
                sums[SEEN, cell] += 1.0
                sums[SQUARES, cell] += residual * residual
                sums[SHIFTS, cell] += residual * slope
                sums[STEEPNESS, cell] += slope * slope
            else:
                sums[INSIDE, cell] += 1.0
                sums[WITHIN, cell] += residual
    agreeing = np.zeros(len(cells), np.bool_)
    told = _weighed(sums, theta[CONTRAST], shown_hu(theta, ceiling_hu), theta[RADIUS], directions)
    for n in range(len(cells)):
        agreeing[n] = cells[n] >= 0 and told[0][cells[n]] == 1
    return told, agreeing


@njit(cache=True, error_model="numpy", nogil=True)
def _within_reach(
    offsets: FloatArray, values: FloatArray, floors: FloatArray, theta: FloatArray, end: int, sums: FloatArray
) -> tuple[NDArray[np.intp], NDArray[np.int8], NDArray[np.intp]]:
    """Cell (N,) of each voxel, -1 of those beyond reach, its zone (N,), and which (M,) the model is to be asked about.

    ``sums`` (9, cells) are begun with what lies outside, which parameters from `PARAMETERS` to ``end`` explain.
    """
    cells, zones = np.full(len(offsets), -1, dtype=np.intp), np.empty(len(offsets), dtype=np.int8)
    near, count = np.empty(len(offsets), dtype=np.intp), 0
    least, most = squares_within_reach(theta)
    for n in range(len(offsets)):
        u, v, w = offsets[n, U] - theta[U], offsets[n, V] - theta[V], offsets[n, W] - theta[W]
        if not least < u * u + v * v + w * w < most:
            continue
        depth, blur = depth_and_blur(u, v, w, theta)
        if abs(depth) >= reach_mm(blur):
            continue
        cell = direction_cell(u, v, w)
        cells[n] = cell
        zones[n] = OUTSIDE if depth > SURFACE_BLURS * blur else SEEN if depth > -SURFACE_BLURS * blur else INSIDE
        if zones[n] == OUTSIDE:
            sums[OUTSIDE, cell] += 1.0
            sums[UNEXPLAINED, cell] += values[n]
            sums[CUT_OFF, cell] += values[n] <= floors[n] and values[n] > theta[BACKGROUND]
            if end == len(PARAMETERS):  # the model explains nothing outside
                continue
        near[count] = n
        count += 1
    return cells, zones, near[:count]


@njit(cache=True)
def unlike_inside(inside_hu: FloatArray, contrast_hu: float) -> NDArray[np.bool_]:
    """In which directions (C,) what is deep inside a ball is an insert's, or a void's."""
    unlike_hu = inside_hu - quantile(inside_hu, 0.5)
    return (unlike_hu > INSERT_SHARE * contrast_hu) | (unlike_hu < -VOID_SHARE * contrast_hu)


@njit(cache=True)
def _weighed(sums: FloatArray, contrast: float, seen_hu: float, radius: float, directions: FloatArray) -> Told:
    """Return what the ``sums`` (9, cells) tell, where so much of the ``contrast`` is ``seen_hu``."""
    means = np.full((3, CELL_COUNT), np.nan)
    rms, outside, within = means[0], means[1], means[2]
    for cell in range(CELL_COUNT):
        if sums[SEEN, cell] > 0.0:
            rms[cell] = math.sqrt(sums[SQUARES, cell] / sums[SEEN, cell])
        if sums[OUTSIDE, cell] > 0.0:
            outside[cell] = sums[UNEXPLAINED, cell] / sums[OUTSIDE, cell]
        if sums[INSIDE, cell] > 0.0:
            within[cell] = sums[WITHIN, cell] / sums[INSIDE, cell]
    usual = quantile(rms, USUAL_QUANTILE)
    usual = 0.0 if math.isnan(usual) else usual  # nothing of its surface is seen
    foreign = rms > OUTLIER_RATIO * max(usual, MODEL_ERROR_SHARE * contrast)
    excess = outside - quantile(outside, BACKGROUND_QUANTILE)
    faint = max(NEIGHBOUR_SHARE * seen_hu, -OUTLIER_RATIO * quantile(excess, DARK_QUANTILE))
    excess[np.isnan(outside)], much = 0.0, min(NEIGHBOUR_SHARE * contrast, NEIGHBOUR_HU)
    beside = excess > min(faint, much)
    if len(np.nonzero(beside)[0]) > MOST_HELD * CELL_COUNT:
        beside = excess > much
    bright = (foreign | beside) & (excess > SPREAD_SHARE * contrast)
    left_out = foreign | beside | near_any(directions, bright, math.cos(math.radians(NEIGHBOUR_ANGLE_DEG)))
    left_out |= unlike_inside(within, contrast)
    state, attached = np.full(CELL_COUNT, -1, np.int8), 0
    for cell in range(CELL_COUNT):
        attached += excess[cell] > ATTACHED_SHARE * contrast
        if sums[SEEN, cell] > 0.0:
            state[cell] = 0 if left_out[cell] else 1
    steepness = np.maximum(sums[STEEPNESS], 1e-12)
    shown = excess * (sums[CUT_OFF] <= 0.5 * sums[OUTSIDE])  # how bright it is elsewhere, is hidden
    return (
        state,
        sums[SHIFTS] / steepness,
        1.0 / np.sqrt(steepness),
        ROUND_SHARE * radius + ROUND_MM,
        attached / CELL_COUNT,
        usual,
        beside,
        excess,
        _is_covered(shown, COVER_SHARE * contrast, directions),
    )


@njit(cache=True)
def near_any(directions: FloatArray, chosen: NDArray[np.bool_], cosine: float) -> NDArray[np.bool_]:
    """Which of the ``directions`` (N, 3) are closer to one of the ``chosen`` than the angle of this ``cosine``."""
    near = np.zeros(len(directions), np.bool_)
    for other in np.nonzero(chosen)[0]:
        for n in range(len(directions)):
            along = 0.0
            for axis in range(3):
                along += directions[n, axis] * directions[other, axis]
            if along > cosine:
                near[n] = True
    return near


@njit(cache=True)
def _is_covered(excess: FloatArray, bright: float, directions: FloatArray) -> bool:
    count, dark, total = 0, 0, np.zeros(3)
    for cell in range(len(excess)):
        dark += excess[cell] < -bright
        if excess[cell] > bright:
            count += 1
            for axis in range(3):
                total[axis] += directions[cell, axis]
    if count <= max(COVERED_SHARE * CELL_COUNT, COVER_TO_DARK * dark):
        return False
    return math.sqrt(total[0] ** 2 + total[1] ** 2 + total[2] ** 2) / count < COVERED_SPREAD
