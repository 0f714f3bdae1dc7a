"""The fit of a blurred ball to the voxels about a candidate.

Least squares (Levenberg-Marquardt) over centre, radius, blur, slice thickness, contrast, background and the
background's slope. What touches the marker (post, screw, skin, another marker) covers some directions only: the
directions whose voxels disagree with the ball are left out, and the fit is repeated, until the choice is stable.
Clipped voxels inform only as far as the model stays below the top of the scale.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ronnaplan.geometry import FloatArray
from ronnaplan.localization.model import PARAMETERS, disc_nodes, disc_table, evaluate, voxel_model
from ronnaplan.localization.neighbourhood import CELL_COUNT, Neighbourhood, cell_directions, direction_cells

TYPICAL_BLUR_MM = 0.5
"""Where the search for the in-plane blur begins; CT kernels lie between 0.25 and 0.9 mm."""

BLUR_BOUNDS_MM = (0.12, 2.5)
"""In-plane blur of any CT at all; a fit that ends here is no ball seen by a scanner."""

RADIUS_PRIOR = 0.1
"""Standard deviation of the radius about the stated one, as a share of it: the data decide unless they cannot."""

THICKNESS_PRIOR = 0.3
"""Standard deviation of the effective slice thickness about the nominal one, as a share of it."""

SLOPE_PRIOR_HU_PER_MM = 10.0
"""Standard deviation of the background's slope (streaks and cupping reach about 5 HU/mm)."""

PRIOR_NOISE_HU = 10.0
"""Noise at which the priors above are meant; it only sets their weight against the voxels."""

MAX_STEPS = 40
"""Steps of one descent; a ball needs five to ten, clipped metal up to thirty."""

CLIPPED_START = 2.0
"""Where the inside is clipped, the search for the true contrast begins at this many times the visible one."""

STEP_TOLERANCE_MM = 1e-5
"""The fit ends when a step moves the centre by less: a hundredth of a micrometre matters to nobody."""

FIRST_LOOK_VOXELS = 3000
"""The first descent uses about this many of the voxels: enough to see that most candidates are no balls."""

HOPELESS_MISFIT = 0.15
"""A first fit whose median direction disagrees by more than this share of the contrast is not pursued."""

MAX_WANDER = 0.5
"""A fit that moves by more than this share of the radius has left its candidate, and is not pursued."""

OUTLIER_RATIO = 2.5
"""A direction disagrees when its residual exceeds the median direction's by this factor."""

MODEL_ERROR_SHARE = 0.02
"""Share of the contrast by which a clean direction may always disagree: real blur is not quite Gaussian."""

NEIGHBOUR_SHARE = 0.03
"""Something just outside that exceeds the background by this share of the contrast is a neighbour."""

BACKGROUND_QUANTILE = 0.3
"""The background is what this share of the directions reach at most: a ball may lie on skin, not in it."""

MAX_ROUNDS = 6
"""Rounds of leaving directions out and fitting again; real markers settle in two to four."""

NEIGHBOUR_ANGLE_DEG = 26.0
"""Directions this close to a disagreeing one are left out with it: blur carries the neighbour's light there."""


@dataclass(frozen=True)
class BallFit:
    """A fitted ball.

    ``theta`` holds the model's `PARAMETERS` with the centre relative to the neighbourhood's origin along u, v, w.
    ``used`` (N,) marks the voxels that informed the fit, ``residuals_hu`` (N,) is data minus model, and
    ``influence_mm_per_hu`` (N, 3) is how far one HU at a voxel moves the centre. ``cell_state`` (cells,) is
    1 where a direction informed the fit, 0 where it disagreed, -1 where the scan has no voxels.
    """

    neighbourhood: Neighbourhood
    theta: FloatArray
    used: NDArray[np.bool_]
    residuals_hu: FloatArray
    influence_mm_per_hu: FloatArray
    cell_state: NDArray[np.int8]
    converged: bool

    @property
    def center_mm(self) -> FloatArray:
        """Centre (3,) in LPS."""
        center: FloatArray = self.neighbourhood.origin_mm + self.theta[:3] @ self.neighbourhood.axes
        return center

    @property
    def diameter_mm(self) -> float:
        """Fitted diameter."""
        return float(2.0 * self.theta[3])

    @property
    def sigma_mm(self) -> float:
        """Fitted in-plane blur (standard deviation)."""
        return float(self.theta[4])

    @property
    def contrast_hu(self) -> float:
        """Ball above background."""
        return float(self.theta[6])

    @property
    def coverage(self) -> float:
        """Share of the ball's surface that agreed with the model and informed the fit."""
        return float(np.mean(self.cell_state == 1))

    @property
    def unseen(self) -> float:
        """Share of the ball's surface for which the scan has no voxels."""
        return float(np.mean(self.cell_state == -1))

    @property
    def misfit(self) -> float:
        """Root mean square residual on the surface that informed the fit, as a share of the contrast."""
        near = self.used & on_surface(self.neighbourhood.offsets_mm, self.theta)
        if not near.any():
            return float("inf")
        return float(np.sqrt(np.mean(self.residuals_hu[near] ** 2)) / abs(self.contrast_hu))


def margin_mm(thickness_mm: float, sigma_mm: float = TYPICAL_BLUR_MM) -> float:
    """How far beyond the ball's surface its blur can be seen."""
    return 3.0 * sigma_mm + 0.6 * thickness_mm


def fit_ball(around: Neighbourhood, diameter_mm: float, thickness_mm: float, ceiling_hu: float) -> BallFit:
    """Fit a ball of about ``diameter_mm`` to the voxels ``around`` a candidate.

    ``thickness_mm`` is the nominal slice thickness, ``ceiling_hu`` the value at which the scan clips (infinite
    where it does not).
    """
    theta = _start(around, diameter_mm, thickness_mm, ceiling_hu)
    prior_mean, prior_weight = _prior(diameter_mm, thickness_mm)
    state = np.ones(CELL_COUNT, dtype=np.int8)
    used = _thinned(len(around.values_hu))
    converged = False
    for _ in range(MAX_ROUNDS):
        theta, converged = _descend(around, used, theta, prior_mean, prior_weight, ceiling_hu)
        cells = direction_cells(around.offsets_mm - theta[:3])
        residuals = _residuals(around, theta, ceiling_hu)[0]
        previous, (state, usual_rms) = state, _judge_directions(around, residuals, cells, theta)
        used = _within_reach(around.offsets_mm, theta) & (state[cells] == 1)
        if _is_hopeless(theta, usual_rms, diameter_mm) or used.sum() < 3 * len(PARAMETERS):
            converged = False
            break
        if np.array_equal(state, previous):
            break
    residuals, jacobian = _residuals(around, theta, ceiling_hu)
    influence = _influence(jacobian, used, prior_weight)
    return BallFit(around, theta, used, residuals, influence, state, converged)


def _thinned(count: int) -> NDArray[np.bool_]:
    """Mark about `FIRST_LOOK_VOXELS` of ``count`` voxels, spread evenly without a pattern (golden ratio)."""
    spread = np.arange(count) * 0.6180339887498949 % 1.0
    marked: NDArray[np.bool_] = spread < FIRST_LOOK_VOXELS / max(count, 1)
    return marked


def _is_hopeless(theta: FloatArray, usual_rms_hu: float, diameter_mm: float) -> bool:
    wandered = float(np.linalg.norm(theta[:3])) > MAX_WANDER * diameter_mm / 2.0
    return wandered or usual_rms_hu > HOPELESS_MISFIT * theta[6]


def _start(around: Neighbourhood, diameter_mm: float, thickness_mm: float, ceiling_hu: float) -> FloatArray:
    """First guess: the stated size, the candidate's centre, and levels read off the inside and the outside."""
    distance = np.linalg.norm(around.offsets_mm, axis=1)
    inside = around.values_hu[distance < 0.3 * diameter_mm]
    outside = around.values_hu[distance > 0.5 * diameter_mm + TYPICAL_BLUR_MM]
    high = float(np.median(inside)) if inside.size else float(around.values_hu.max())
    low = float(np.quantile(outside, BACKGROUND_QUANTILE)) if outside.size else float(around.values_hu.min())
    contrast = max(high - low, 1.0) * (CLIPPED_START if high >= ceiling_hu else 1.0)
    levels = [contrast, low]
    return np.array([0.0, 0.0, 0.0, diameter_mm / 2, TYPICAL_BLUR_MM, thickness_mm, *levels, 0.0, 0.0, 0.0])


def _prior(diameter_mm: float, thickness_mm: float) -> tuple[FloatArray, FloatArray]:
    """Mean (P,) and weight (P,), in HU^2 per parameter^2, of what is known before the voxels are read."""
    mean = np.zeros(len(PARAMETERS))
    mean[3], mean[5] = diameter_mm / 2, thickness_mm
    spread = np.full(len(PARAMETERS), np.inf)
    spread[3], spread[5] = RADIUS_PRIOR * diameter_mm / 2, THICKNESS_PRIOR * thickness_mm
    spread[8:11] = SLOPE_PRIOR_HU_PER_MM
    return mean, (PRIOR_NOISE_HU / spread) ** 2


@njit(cache=True, nogil=True)
def _normal_equations(
    offsets: FloatArray,
    values: FloatArray,
    used: NDArray[np.bool_],
    theta: FloatArray,
    ceiling: float,
    table: FloatArray,
    nodes: FloatArray,
    weights: FloatArray,
) -> tuple[float, FloatArray, FloatArray]:
    """Half the squared residuals, their gradient (P,) and Gauss-Newton matrix (P, P) over the used voxels."""
    size = len(theta)
    cost = 0.0
    slope = np.zeros(size)
    matrix = np.zeros((size, size))
    gradient = np.empty(size)
    for n in range(len(values)):
        if not used[n]:
            continue
        du = offsets[n, 0] - theta[0]
        dv = offsets[n, 1] - theta[1]
        dw = offsets[n, 2] - theta[2]
        model = voxel_model(du, dv, dw, theta, table, nodes, weights, gradient)
        if values[n] >= ceiling and model >= ceiling:
            continue
        residual = values[n] - model
        cost += 0.5 * residual * residual
        for p in range(size):
            slope[p] += gradient[p] * residual
            for q in range(p + 1):
                matrix[p, q] += gradient[p] * gradient[q]
    for p in range(size):
        for q in range(p):
            matrix[q, p] = matrix[p, q]
    return cost, slope, matrix


def _descend(
    around: Neighbourhood,
    used: NDArray[np.bool_],
    theta: FloatArray,
    prior_mean: FloatArray,
    prior_weight: FloatArray,
    ceiling_hu: float,
) -> tuple[FloatArray, bool]:
    """Levenberg-Marquardt from ``theta``; returns the best parameters and whether the steps came to rest."""
    kernel = (disc_table(), *disc_nodes())

    def equations(at: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        cost, slope, matrix = _normal_equations(around.offsets_mm, around.values_hu, used, at, ceiling_hu, *kernel)
        pull = prior_mean - at
        cost += 0.5 * float(prior_weight @ pull**2)
        return cost, slope + prior_weight * pull, matrix + np.diag(prior_weight)

    damping = 1e-3
    cost, slope, matrix = equations(theta)
    for _ in range(MAX_STEPS):
        scaled = matrix + damping * np.diag(np.diag(matrix) + 1e-9)
        step = np.linalg.solve(scaled, slope)
        trial = _bounded(theta + step)
        new_cost, new_slope, new_matrix = equations(trial)
        if not new_cost <= cost:
            damping *= 5.0
            if damping > 1e8:
                return theta, True
            continue
        moved = float(np.abs(trial[:5] - theta[:5]).max())
        theta, cost, slope, matrix = trial, new_cost, new_slope, new_matrix
        damping = max(damping / 10.0, 1e-9)
        if moved < STEP_TOLERANCE_MM:
            return theta, True
    return theta, False


def _bounded(theta: FloatArray) -> FloatArray:
    theta[3] = max(theta[3], 0.2)
    theta[4] = np.clip(theta[4], *BLUR_BOUNDS_MM)
    theta[5] = max(theta[5], 0.02)
    return theta


def _residuals(around: Neighbourhood, theta: FloatArray, ceiling_hu: float) -> tuple[FloatArray, FloatArray]:
    """Data minus model (N,) and the Jacobian (N, P); both zero where clipped data agree with a higher model."""
    model, jacobian = evaluate(around.offsets_mm, theta, disc_table(), *disc_nodes())
    residuals = around.values_hu - model
    clipped = (around.values_hu >= ceiling_hu) & (model >= ceiling_hu)
    residuals[clipped] = 0.0
    jacobian[clipped] = 0.0
    return residuals, jacobian


def _edge_width(offsets_mm: FloatArray, theta: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Signed distance from the surface (N,) and the blur across the surface there (N,), both in mm."""
    offsets = offsets_mm - theta[:3]
    distance = np.linalg.norm(offsets, axis=1)
    along = offsets[:, 2] / np.maximum(distance, 1e-9)
    blur = np.sqrt(theta[4] ** 2 * (1.0 - along**2) + theta[5] ** 2 / 12.0 * along**2 + 0.01)
    return distance - theta[3], blur


def on_surface(offsets_mm: FloatArray, theta: FloatArray) -> NDArray[np.bool_]:
    """Voxels (N,) in the blurred edge of the ball, where the centre is told."""
    depth, blur = _edge_width(offsets_mm, theta)
    near: NDArray[np.bool_] = np.abs(depth) < 2.0 * blur
    return near


def _just_outside(offsets_mm: FloatArray, theta: FloatArray) -> NDArray[np.bool_]:
    """Voxels (N,) beyond the ball's blur but within the fit's reach: they show what touches the ball."""
    depth, blur = _edge_width(offsets_mm, theta)
    near: NDArray[np.bool_] = (depth > 2.0 * blur) & (depth < 3.0 * blur + 0.5)
    return near


def _within_reach(offsets_mm: FloatArray, theta: FloatArray) -> NDArray[np.bool_]:
    """Voxels (N,) inside the ball or within its blur; farther ones tell nothing but what else is there."""
    depth, blur = _edge_width(offsets_mm, theta)
    near: NDArray[np.bool_] = depth < 3.0 * blur + 0.5
    return near


def _judge_directions(
    around: Neighbourhood, residuals: FloatArray, cells: NDArray[np.intp], theta: FloatArray
) -> tuple[NDArray[np.int8], float]:
    """Say of each direction whether it agrees with the ball (1), disagrees (0) or was not scanned (-1).

    A direction disagrees when its edge is not the ball's, or when something brighter than the background lies
    just outside. Beside it, the median direction's root mean square residual on the surface, in HU.
    """
    edge = on_surface(around.offsets_mm, theta)
    squares, seen = _cell_means(residuals**2, cells, edge)
    rms = np.sqrt(squares)
    usual = float(np.median(rms[seen])) if seen.any() else 0.0
    foreign = seen & (rms > OUTLIER_RATIO * max(usual, MODEL_ERROR_SHARE * theta[6]))

    outside, has_outside = _cell_means(around.values_hu, cells, _just_outside(around.offsets_mm, theta))
    if has_outside.any():
        background = float(np.quantile(outside[has_outside], BACKGROUND_QUANTILE))
        foreign |= has_outside & (outside > background + NEIGHBOUR_SHARE * theta[6])

    directions = cell_directions()
    close = directions @ directions[foreign].T > np.cos(np.radians(NEIGHBOUR_ANGLE_DEG))
    state = np.where(close.any(axis=1), 0, 1)
    return np.where(seen, state, -1).astype(np.int8), usual


def _cell_means(
    values: FloatArray, cells: NDArray[np.intp], chosen: NDArray[np.bool_]
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Mean of the chosen values in each cell (cells,), and which cells have any."""
    counts = np.bincount(cells[chosen], minlength=CELL_COUNT)
    sums = np.bincount(cells[chosen], weights=values[chosen], minlength=CELL_COUNT)
    return sums / np.maximum(counts, 1), counts > 0


def _influence(jacobian: FloatArray, used: NDArray[np.bool_], prior_weight: FloatArray) -> FloatArray:
    """How far one HU at each voxel moves the centre: (N, 3) in mm/HU, zero for voxels that were left out."""
    informed = np.where(used[:, np.newaxis], jacobian, 0.0)
    matrix = informed.T @ informed + np.diag(prior_weight)
    influence: FloatArray = informed @ np.linalg.pinv(matrix, hermitian=True)[:, :3]
    return influence
