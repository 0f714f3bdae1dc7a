"""Which directions about a fitted ball show a ball, and what stands in the others.

What touches a marker (post, screw, skin, another marker) covers some directions only. They are recognized by the
residuals on the ball's surface and by what lies just outside it, and the fit does without them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kernelcache import njit
from ronnaplan.geometry import FloatArray
from ronnaplan.localization.cells import CELL_COUNT, cell_directions
from ronnaplan.localization.neighbourhood import Neighbourhood
from ronnaplan.localization.parameters import BLUR, CONTRAST, LEAST_SPREAD_MM2, RADIUS, WIDTH, U, V, W

OUTLIER_RATIO = 2.5
"""A direction disagrees when its residual exceeds the usual direction's by this factor."""

MODEL_ERROR_SHARE = 0.03
"""Share of the contrast by which a clean direction may always disagree: real blur is not quite Gaussian."""

NEIGHBOUR_SHARE = 0.03
NEIGHBOUR_HU = 400.0
"""Something just outside that exceeds the background by this share of the contrast, or by so much, is a neighbour."""

ATTACHED_SHARE = 0.5
"""Something just outside that exceeds the background by this share of the contrast is part of the same body."""

INSERT_SHARE = 0.06
"""Something deep inside that exceeds the ball by this share of the contrast is an insert, whose blur reaches out."""

BACKGROUND_QUANTILE = 0.3
"""The background is what this share of the directions reach at most: a ball may lie on skin, not in it."""

USUAL_QUANTILE = 0.3
"""The usual direction is a good one: with an insert and a post, more than half of them may be disturbed."""

SPREAD_SHARE = 0.15
NEIGHBOUR_ANGLE_DEG = 26.0
"""A neighbour brighter than this share of the contrast also spoils the directions this close to its own, for
blur carries its light there; one that is faint beside the ball does not."""

ROUND_SHARE = 0.015
ROUND_MM = 0.06
"""An edge that is off by no more than this share of the radius plus this is where the ball's edge should be."""


COVER_SHARE = 0.04
COVER_TO_DARK = 3.0
"""What lies on a marker is brighter just outside it by this share of the contrast, in more directions by this factor
than are as dark: streaks are both."""

COVERED_SHARE = 0.15
COVERED_SPREAD = 0.6
"""What carries a marker stands on one side of it. What is bright in more than this share of the directions, and to all
sides, so that their mean is shorter than this, lies on the marker (a post: 0.8; tape, hair: 0.3)."""


@dataclass(frozen=True)
class Verdict:
    """What the directions say.

    ``state`` (cells,) is 1 where a direction informs the fit, 0 where it is left out, -1 where no voxel lies on the
    surface. ``round_share`` is the share of the others whose edge is where the ball's should be, ``attached_share``
    the share of all in which a body as bright as the ball goes on outward. ``usual_rms_hu`` is a good direction's
    residual. ``beside`` (cells,) marks those with something just outside, ``excess_hu`` (cells,) how bright it is;
    ``is_covered`` says whether that lies to all sides instead of one.
    """

    state: NDArray[np.int8]
    round_share: float
    attached_share: float
    usual_rms_hu: float
    beside: NDArray[np.bool_]
    excess_hu: FloatArray
    is_covered: bool


def judge(
    around: Neighbourhood,
    cells: NDArray[np.intp],
    theta: FloatArray,
    residuals_hu: FloatArray,
    jacobian: FloatArray,
    explained_hu: FloatArray,
) -> Verdict:
    """Judge every direction.

    ``cells`` (N,) says in which each voxel lies, ``explained_hu`` (N,) what the model puts there beside the ball: its
    streaks and the skin.
    """
    contrast = theta[CONTRAST]
    depth, blur = edge_depth(around.offsets_mm, theta)
    edge = _on_surface(depth, blur)
    squares, seen = cell_means(residuals_hu**2, cells, edge)
    rms = np.sqrt(squares)
    usual = _quantile(rms[seen], USUAL_QUANTILE) if seen.any() else 0.0
    foreign = seen & (rms > OUTLIER_RATIO * max(usual, MODEL_ERROR_SHARE * contrast))

    excess = _excess_outside(around.values_hu - explained_hu, cells, _just_outside(depth, blur))
    beside = excess > min(NEIGHBOUR_SHARE * contrast, NEIGHBOUR_HU)
    directions = cell_directions()
    bright = (foreign | beside) & (excess > SPREAD_SHARE * contrast)
    close = directions @ directions[bright].T > np.cos(np.radians(NEIGHBOUR_ANGLE_DEG))
    inserts = _show_insert(residuals_hu, cells, _deep_inside(depth, blur), contrast)
    left_out = foreign | beside | close.any(axis=1) | inserts
    state = np.where(seen, np.where(left_out, 0, 1), -1).astype(np.int8)

    slope = jacobian[:, RADIUS]
    shifts, _ = cell_means(residuals_hu * slope, cells, edge)
    weights, _ = cell_means(slope**2, cells, edge)
    off_mm = np.abs(shifts) / np.maximum(weights, 1e-12)
    is_round = seen & (off_mm <= ROUND_SHARE * theta[RADIUS] + ROUND_MM)
    attached = excess > ATTACHED_SHARE * contrast
    round_share = float(is_round.sum() / max(int(seen.sum()), 1))
    covered = _is_covered(excess, COVER_SHARE * contrast)
    return Verdict(state, round_share, float(attached.mean()), usual, beside, excess, covered)


def _is_covered(excess_hu: FloatArray, bright_hu: float) -> bool:
    bright = excess_hu > bright_hu
    count, dark = np.count_nonzero(bright), np.count_nonzero(excess_hu < -bright_hu)
    if count <= max(COVERED_SHARE * CELL_COUNT, COVER_TO_DARK * dark):
        return False
    return float(np.linalg.norm(cell_directions()[bright].mean(axis=0))) < COVERED_SPREAD


def _excess_outside(unexplained_hu: FloatArray, cells: NDArray[np.intp], outside: NDArray[np.bool_]) -> FloatArray:
    """How much brighter than the background each direction (cells,) is just outside the ball; 0 where unseen."""
    means, seen = cell_means(unexplained_hu, cells, outside)
    if not seen.any():
        return np.zeros(CELL_COUNT)
    background = _quantile(means[seen], BACKGROUND_QUANTILE)
    return np.where(seen, means - background, 0.0)


def _show_insert(
    residuals_hu: FloatArray, cells: NDArray[np.intp], inside: NDArray[np.bool_], contrast: float
) -> NDArray[np.bool_]:
    """Directions (cells,) whose inside is brighter than the ball's usual one."""
    means, seen = cell_means(residuals_hu, cells, inside)
    if not seen.any():
        return seen
    bright: NDArray[np.bool_] = seen & (means - _quantile(means[seen], 0.5) > INSERT_SHARE * contrast)
    return bright


def _quantile(values: FloatArray, share: float) -> float:
    """Return what this share of ``values`` (N,) reach at most, as `numpy.quantile` does at length."""
    ordered = np.sort(values)
    place = share * (len(ordered) - 1)
    below = int(place)
    return float(ordered[below] + (place - below) * (ordered[min(below + 1, len(ordered) - 1)] - ordered[below]))


def cell_means(
    values: FloatArray, cells: NDArray[np.intp], chosen: NDArray[np.bool_]
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Mean of the chosen values in each cell (cells,), and which cells have any."""
    counts = np.bincount(cells[chosen], minlength=CELL_COUNT)
    sums = np.bincount(cells[chosen], weights=values[chosen], minlength=CELL_COUNT)
    return sums / np.maximum(counts, 1), counts > 0


@njit(cache=True, nogil=True)
def edge_depth(offsets_mm: FloatArray, theta: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Signed distance outward from the surface (N,) and the blur across the surface there (N,), both in mm."""
    depth, blur = np.empty(len(offsets_mm)), np.empty(len(offsets_mm))
    in_plane, along_w = theta[BLUR] ** 2, theta[WIDTH] ** 2 / 12.0
    for n in range(len(offsets_mm)):
        u, v, w = offsets_mm[n, U] - theta[U], offsets_mm[n, V] - theta[V], offsets_mm[n, W] - theta[W]
        square = u * u + v * v + w * w
        along = w * w / max(square, 1e-18)
        depth[n] = math.sqrt(square) - theta[RADIUS]
        blur[n] = math.sqrt(in_plane * (1.0 - along) + along_w * along + LEAST_SPREAD_MM2)
    return depth, blur


def on_surface(offsets_mm: FloatArray, theta: FloatArray) -> NDArray[np.bool_]:
    """Voxels (N,) in the blurred edge of the ball, where the center is told."""
    return _on_surface(*edge_depth(offsets_mm, theta))


def just_outside(offsets_mm: FloatArray, theta: FloatArray) -> NDArray[np.bool_]:
    """Voxels (N,) beyond the ball's blur but within the fit's reach: they show what touches the ball."""
    return _just_outside(*edge_depth(offsets_mm, theta))


def deep_inside(offsets_mm: FloatArray, theta: FloatArray) -> NDArray[np.bool_]:
    """Voxels (N,) within the fit's reach, but inside the ball's blur: they show what is in the ball."""
    return _deep_inside(*edge_depth(offsets_mm, theta))


def within_reach(offsets_mm: FloatArray, theta: FloatArray) -> NDArray[np.bool_]:
    """Voxels (N,) near the surface: farther out is what else is there, deep inside may be a metal insert."""
    depth, blur = edge_depth(offsets_mm, theta)
    near: NDArray[np.bool_] = np.abs(depth) < _reach(blur)
    return near


def _on_surface(depth: FloatArray, blur: FloatArray) -> NDArray[np.bool_]:
    near: NDArray[np.bool_] = np.abs(depth) < 2.0 * blur
    return near


def _just_outside(depth: FloatArray, blur: FloatArray) -> NDArray[np.bool_]:
    near: NDArray[np.bool_] = (depth > 2.0 * blur) & (depth < _reach(blur))
    return near


def _deep_inside(depth: FloatArray, blur: FloatArray) -> NDArray[np.bool_]:
    near: NDArray[np.bool_] = (depth < -2.0 * blur) & (depth > -_reach(blur))
    return near


def _reach(blur: FloatArray) -> FloatArray:
    return 3.0 * blur + 0.5
