"""The fit of a blurred ball to the voxels about a candidate.

Least squares (Levenberg-Marquardt) over centre, radius, blur, slice thickness, contrast, background and the
background's slope; where the ball lies on something flat, that half-space is fitted with it. Directions in which
anything else touches the marker are left out, and the fit is repeated until the choice is stable. Clipped voxels
inform only as far as the model stays below the top of the scale.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ronnaplan.geometry import FloatArray
from ronnaplan.localization.directions import BACKGROUND_QUANTILE, Verdict, judge, on_surface, within_reach
from ronnaplan.localization.model import PARAMETERS, disc_nodes, disc_table, evaluate, voxel_model
from ronnaplan.localization.neighbourhood import Neighbourhood, cell_directions, direction_cells

TYPICAL_BLUR_MM = 0.5
"""Where the search for the in-plane blur begins; CT kernels lie between 0.25 and 0.9 mm."""

BLUR_BOUNDS_MM = (0.12, 2.5)
"""In-plane blur of any CT at all; a fit that ends here is no ball seen by a scanner."""

RADIUS_PRIOR = 0.1
"""Standard deviation of the radius about the stated one, as a share of it: the data decide unless they cannot."""

THICKNESS_PRIOR = 0.3
"""Standard deviation of the effective slice thickness about the nominal one, as a share of it."""

SLOPE_PRIOR_PER_MM = 0.01
"""Standard deviation of the background's slope, as a share of the contrast: streaks and cupping reach half of it."""

SKIN_PRIOR_HU = 2000.0
SKIN_PRIOR_PLACE = 0.3
"""Standard deviations of the skin's level, and of its distance and direction as a share of the distance."""

PRIOR_NOISE_HU = 10.0
"""Noise at which the priors above are meant; it only sets their weight against the voxels."""

FROZEN_WEIGHT = 1e15
"""Weight (HU^2 per mm^2) against which no data move a parameter."""

MAX_STEPS = 40
"""Steps of one descent; a ball needs five to ten, clipped metal up to thirty."""

CLIPPED_START = 2.0
"""Where the inside is clipped, the search for the true contrast begins at this many times the visible one."""

STEP_TOLERANCE_MM = 2e-5
"""A descent ends when the next step would move the centre by less than this."""

FIRST_DAMPING = 1e-5
"""Levenberg-Marquardt damping at the start of a descent, as a share of the matrix's diagonal."""

FIRST_LOOK_VOXELS = 3000
"""The first descent uses about this many of the voxels: enough to see that most candidates are no balls."""

HOPELESS_MISFIT = 0.15
"""A first fit whose median direction disagrees by more than this share of the contrast is not pursued."""

MAX_WANDER = 0.5
"""A fit that moves by more than this share of the radius has left its candidate, and is not pursued."""

MAX_ROUNDS = 8
"""Rounds of leaving directions out and fitting again; real markers settle in two to four."""

SKIN_SHARES = (0.2, 0.65)
"""A ball that lies on something flat has neighbours in a share of its directions between these."""

SKIN_LEVEL = 0.35
"""What a ball lies on is no brighter than this share of the ball's own contrast."""


SKIN_QUANTILE = 0.8
"""The skin's level is read off the brighter of the neighbouring directions."""


@dataclass(frozen=True)
class BallFit:
    """A fitted ball.

    ``theta`` (P,) holds the model's `PARAMETERS` (and `SKIN_PARAMETERS` where it lies on something), with the
    centre relative to the neighbourhood's origin along u, v, w. ``used`` (N,) marks the voxels that informed the
    fit, ``residuals_hu`` (N,) is data minus model, ``jacobian`` (N, P) the model's derivatives, and
    ``influence_mm_per_hu`` (N, 3) how far one HU at a voxel moves the centre.
    """

    neighbourhood: Neighbourhood
    theta: FloatArray
    used: NDArray[np.bool_]
    residuals_hu: FloatArray
    jacobian: FloatArray
    influence_mm_per_hu: FloatArray
    verdict: Verdict
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
        """Share of the ball's directions that informed the fit."""
        return float(np.mean(self.verdict.state == 1))

    @property
    def unseen(self) -> float:
        """Share of the ball's directions for which the scan has no voxels."""
        return float(np.mean(self.verdict.state == -1))

    @property
    def misfit(self) -> float:
        """Root mean square residual on the surface that informed the fit, as a share of the contrast."""
        near = self.used & on_surface(self.neighbourhood.offsets_mm, self.theta)
        if not near.any():
            return float("inf")
        return float(np.sqrt(np.mean(self.residuals_hu[near] ** 2)) / abs(self.contrast_hu))


@dataclass(frozen=True)
class _Prior:
    """Mean (P,) and weight (P,), in HU^2 per parameter^2, of what is known before the voxels are read."""

    mean: FloatArray
    weight: FloatArray

    @classmethod
    def of(cls, mean: FloatArray, spread: FloatArray) -> _Prior:
        return cls(mean, (PRIOR_NOISE_HU / spread) ** 2)


def margin_mm(thickness_mm: float, sigma_mm: float = TYPICAL_BLUR_MM) -> float:
    """How far beyond the ball's surface its blur can be seen."""
    return 3.0 * sigma_mm + 0.6 * thickness_mm


def fit_ball(around: Neighbourhood, diameter_mm: float, thickness_mm: float, ceiling_hu: float) -> BallFit:
    """Fit a ball of about ``diameter_mm`` to the voxels ``around`` a candidate.

    ``thickness_mm`` is the nominal slice thickness, ``ceiling_hu`` the value at which the scan clips (infinite
    where it does not).
    """
    theta = _start(around, diameter_mm, thickness_mm, ceiling_hu)
    prior = _ball_prior(theta)
    # What is brighter than the ball (an insert, a screw) must not draw the first fit to itself.
    dimmed = replace(around, values_hu=np.minimum(around.values_hu, theta[6] + theta[7]))
    few = _thinned(len(around.values_hu))
    theta, _ = _descend(dimmed, few, theta, _frozen(prior, theta), ceiling_hu)
    theta, converged = _descend(dimmed, few, theta, prior, ceiling_hu)
    verdict, _ = _judged(around, theta, ceiling_hu)
    if not converged or _is_hopeless(theta, verdict, diameter_mm):
        return _ball_fit(around, theta, prior, verdict, few, ceiling_hu, converged=False)
    fits = [_settle(around, theta, prior, ceiling_hu, diameter_mm)]
    if _lies_on_something(theta, verdict):
        fits.append(_settle(around, *_with_skin(theta, prior, verdict, around), ceiling_hu, diameter_mm))
    return max(fits, key=lambda fit: (fit.converged, fit.coverage))


def _settle(
    around: Neighbourhood, theta: FloatArray, prior: _Prior, ceiling_hu: float, diameter_mm: float
) -> BallFit:
    """Leave out the directions that disagree and fit again, until the choice is stable."""
    if len(theta) > len(PARAMETERS):  # the skin's level and place are a guess: fit them before judging by them
        theta, _ = _descend(around, within_reach(around.offsets_mm, theta), theta, prior, ceiling_hu)
    previous = np.empty(0, dtype=np.int8)
    converged = True
    for _ in range(MAX_ROUNDS):
        verdict, cells = _judged(around, theta, ceiling_hu)
        used = within_reach(around.offsets_mm, theta) & (verdict.state[cells] == 1)
        if _is_hopeless(theta, verdict, diameter_mm) or used.sum() < 3 * len(theta):
            converged = False
        if not converged or np.array_equal(verdict.state, previous):
            break
        previous = verdict.state
        theta, converged = _descend(around, used, theta, prior, ceiling_hu)
    return _ball_fit(around, theta, prior, verdict, used, ceiling_hu, converged=converged)


def _ball_fit(
    around: Neighbourhood,
    theta: FloatArray,
    prior: _Prior,
    verdict: Verdict,
    used: NDArray[np.bool_],
    ceiling_hu: float,
    *,
    converged: bool,
) -> BallFit:
    residuals, jacobian = _residuals(around, theta, ceiling_hu)
    influence = _influence(jacobian, used, prior.weight)
    return BallFit(around, theta, used, residuals, jacobian, influence, verdict, converged)


def _thinned(count: int) -> NDArray[np.bool_]:
    """Mark about `FIRST_LOOK_VOXELS` of ``count`` voxels, spread evenly without a pattern (golden ratio)."""
    spread = np.arange(count) * 0.6180339887498949 % 1.0
    marked: NDArray[np.bool_] = spread < FIRST_LOOK_VOXELS / max(count, 1)
    return marked


def _start(around: Neighbourhood, diameter_mm: float, thickness_mm: float, ceiling_hu: float) -> FloatArray:
    """First guess: the stated size, the candidate's centre, and levels read off the inside and the outside."""
    distance = np.linalg.norm(around.offsets_mm, axis=1)
    inside = around.values_hu[distance < 0.3 * diameter_mm]
    outside = around.values_hu[distance > 0.5 * diameter_mm + TYPICAL_BLUR_MM]
    high = float(np.median(inside)) if inside.size else float(around.values_hu.max())
    low = float(np.quantile(outside, BACKGROUND_QUANTILE)) if outside.size else float(around.values_hu.min())
    contrast = max(high - low, 1.0) * (CLIPPED_START if high >= ceiling_hu else 1.0)
    return np.array([0, 0, 0, diameter_mm / 2, TYPICAL_BLUR_MM, thickness_mm, contrast, low, 0, 0, 0], np.float64)


def _ball_prior(start: FloatArray) -> _Prior:
    spread = np.full(len(PARAMETERS), np.inf)
    spread[3], spread[5] = RADIUS_PRIOR * start[3], THICKNESS_PRIOR * start[5]
    spread[8:11] = SLOPE_PRIOR_PER_MM * start[6]
    return _Prior.of(np.where(np.isfinite(spread), start, 0.0), spread)


def _frozen(prior: _Prior, start: FloatArray) -> _Prior:
    """Hold radius, blur and thickness at their first guesses, so that the centre finds its place first."""
    weight = prior.weight.copy()
    weight[3:6] = FROZEN_WEIGHT
    return _Prior(np.where(weight == FROZEN_WEIGHT, start, prior.mean), weight)


def _lies_on_something(theta: FloatArray, verdict: Verdict) -> bool:
    share = float(verdict.beside.mean())
    return SKIN_SHARES[0] <= share <= SKIN_SHARES[1] and _level_beside(verdict) < SKIN_LEVEL * theta[6]


def _level_beside(verdict: Verdict) -> float:
    """How bright the neighbours are, in HU over the background; partial voxels make some look fainter."""
    return float(np.quantile(verdict.excess_hu[verdict.beside], SKIN_QUANTILE))


def _with_skin(
    theta: FloatArray, prior: _Prior, verdict: Verdict, around: Neighbourhood
) -> tuple[FloatArray, _Prior]:
    """Add a half-space that the ball touches, on the side where the neighbours are."""
    toward = cell_directions()[verdict.beside].mean(axis=0)
    place = toward / np.linalg.norm(toward) / theta[3]
    spread = np.array([SKIN_PRIOR_HU, *[SKIN_PRIOR_PLACE / theta[3]] * 3])
    skin = np.array([_level_beside(verdict), *place])
    added = _Prior.of(skin, spread)
    lowest = float(np.quantile(around.values_hu, 0.05))
    return np.concatenate([[*theta[:7], lowest, 0.0, 0.0, 0.0], skin]), _Prior(
        np.concatenate([prior.mean, added.mean]), np.concatenate([prior.weight, added.weight])
    )


def _is_hopeless(theta: FloatArray, verdict: Verdict, diameter_mm: float) -> bool:
    wandered = float(np.linalg.norm(theta[:3])) > MAX_WANDER * diameter_mm / 2.0
    return wandered or verdict.usual_rms_hu > HOPELESS_MISFIT * theta[6]


def _judged(around: Neighbourhood, theta: FloatArray, ceiling_hu: float) -> tuple[Verdict, NDArray[np.intp]]:
    cells = direction_cells(around.offsets_mm - theta[:3])
    residuals, jacobian = _residuals(around, theta, ceiling_hu)
    skin = theta[11] * jacobian[:, 11] if len(theta) > len(PARAMETERS) else np.zeros(len(residuals))
    return judge(around, cells, theta, residuals, jacobian, skin), cells


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
    around: Neighbourhood, used: NDArray[np.bool_], theta: FloatArray, prior: _Prior, ceiling_hu: float
) -> tuple[FloatArray, bool]:
    """Levenberg-Marquardt from ``theta``; returns the best parameters and whether the steps came to rest."""
    kernel = (disc_table(), *disc_nodes())

    def equations(at: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        cost, slope, matrix = _normal_equations(around.offsets_mm, around.values_hu, used, at, ceiling_hu, *kernel)
        pull = prior.mean - at
        cost += 0.5 * float(prior.weight @ pull**2)
        return cost, slope + prior.weight * pull, matrix + np.diag(prior.weight)

    damping = FIRST_DAMPING
    cost, slope, matrix = equations(theta)
    for _ in range(MAX_STEPS):
        step = np.linalg.solve(matrix + damping * np.diag(np.diag(matrix) + 1e-9), slope)
        trial = _bounded(theta + step)
        if float(np.abs(trial[:3] - theta[:3]).max()) < STEP_TOLERANCE_MM:
            return trial, True
        if float(np.linalg.norm(trial[:3])) > 2.0 * MAX_WANDER * theta[3]:
            return trial, False
        new_cost, new_slope, new_matrix = equations(trial)
        if new_cost < cost:
            theta, cost, slope, matrix = trial, new_cost, new_slope, new_matrix
            damping = max(damping / 10.0, 1e-9)
        else:
            damping *= 10.0
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


def _influence(jacobian: FloatArray, used: NDArray[np.bool_], prior_weight: FloatArray) -> FloatArray:
    """How far one HU at each voxel moves the centre: (N, 3) in mm/HU, zero for voxels that were left out."""
    informed = np.where(used[:, np.newaxis], jacobian, 0.0)
    matrix = informed.T @ informed + np.diag(prior_weight)
    influence: FloatArray = informed @ np.linalg.pinv(matrix, hermitian=True)[:, :3]
    return influence
