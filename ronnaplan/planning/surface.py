"""Where a ray crosses a surface of the head, and the surface's normal there, from the voxels about the crossing.

A small patch z(a, b) of second order is fitted with the blurred step it causes in every voxel at that voxel's true
place (nothing is interpolated): two levels, one on each side, joined by the integral of a Gaussian, averaged over
the slice's thickness. The surface is the half level between the two local media; the noise is averaged over all
voxels of the patch, some hundreds to thousands.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ronnaplan.ct.volume import CTVolume
from ronnaplan.geometry import FloatArray, unit
from ronnaplan.localization.neighbourhood import gather

PATCH_RADIUS_MM = 8.0
"""The patch reaches this far to all sides; bone is smooth over a centimetre or so."""

HALF_DEPTH_MM = 2.5
"""Voxels within this of the surface are fitted; it holds the blur of any head protocol."""

LEAST_HALF_DEPTH_MM = 1.0
"""Never fewer than this, however thin the layer."""

LEAST_VOXELS = 30
"""A patch has nine parameters."""

LEAST_CONTRAST_HU = 80.0
"""A step smaller than this is no surface."""

CURVATURE_PRIOR_PER_MM = 1 / 20
"""Standard deviation of the curvature expected of scalp and skull: settles it where slices are too few to tell."""

BLUR_PRIOR_MM = 0.6
"""Typical blur (standard deviation) of a head CT; known within a factor of two."""

NOISE_SHARE = 0.03
"""Expected misfit of a voxel as a share of the step: sets how much the priors weigh (little)."""

EXPECTED = np.array([*(8 * [0.0]), np.log(BLUR_PRIOR_MM)])
PRIOR = np.array([0, 0, 0, *(3 * [CURVATURE_PRIOR_PER_MM**-2]), 1e-9, 1e-9, np.log(2.0) ** -2])
"""Expected parameters of a patch and the inverse of their variance; heights, slopes and levels are free."""

MOST_STEPS = 40
ROUNDS = 3
"""Times the voxels are chosen anew about the fitted patch."""


@dataclass(frozen=True, eq=False)
class Surface:
    """A crossing: ``position_mm`` (3,) in LPS, its ``reach_mm`` along the ray, and the outward unit ``normal``.

    ``sd_mm`` is the standard error along the ray; ``clear`` is False where no patch could be fitted and the values
    are those of the plain threshold.
    """

    position_mm: FloatArray
    reach_mm: float
    normal: FloatArray
    sd_mm: float
    clear: bool = True


@dataclass(frozen=True, eq=False)
class _Patch:
    """Parameters (9,): height, two slopes, three curvatures, inner and outer level, log of the blur."""

    origin_mm: FloatArray
    axes: FloatArray
    parameters: FloatArray
    covariance: FloatArray

    @property
    def normal(self) -> FloatArray:
        a, b, c = self.axes
        normal: FloatArray = unit(c - self.parameters[1] * a - self.parameters[2] * b)
        return normal


def fit_crossing(
    volume: CTVolume,
    start_mm: FloatArray,
    outward: FloatArray,
    reach_mm: float,
    *,
    limits_hu: tuple[float, float],
    half_depth_mm: float = HALF_DEPTH_MM,
) -> Surface:
    """Refine the crossing near ``reach_mm`` along the ray from ``start_mm`` (3,) along unit ``outward`` (3,).

    ``limits_hu`` bound the values, so that a third medium nearby (air above thin skin over bone) does not count.
    """
    place = start_mm + reach_mm * outward
    depth = max(min(half_depth_mm, HALF_DEPTH_MM), LEAST_HALF_DEPTH_MM)
    patch = _fit(volume, place, outward, depth, limits_hu)
    if patch is None:
        return Surface(place, reach_mm, outward, depth, clear=False)
    shift, normal = _meet(patch, place, outward)
    obliquity = abs(float(patch.normal @ outward))
    if abs(shift) > 2 * depth or obliquity < 0.1:
        return Surface(place, reach_mm, patch.normal, depth, clear=False)
    sd = float(np.sqrt(patch.covariance[0, 0])) / obliquity
    return Surface(place + shift * outward, reach_mm + shift, normal, sd)


def _fit(
    volume: CTVolume, place: FloatArray, outward: FloatArray, depth: float, limits_hu: tuple[float, float]
) -> _Patch | None:
    gap = _gap(volume, place)
    reach = float(np.hypot(max(PATCH_RADIUS_MM, 1.2 * gap), depth))
    near = gather(volume, place, reach)
    offsets = near.offsets_mm @ near.axes
    values = np.clip(near.values_hu, *limits_hu)
    if len(values) < LEAST_VOXELS:
        return None
    axes = _axes(_steepest(offsets, values, outward))
    local = offsets @ axes.T
    across = abs(float(axes[2] @ volume.grid.normal))
    needed = max(depth, 0.8 * gap * across)
    box = (volume.grid.thickness_mm or gap) * across
    parameters, covariance = np.zeros(9), np.empty((9, 9))
    before = np.zeros(len(local), dtype=np.bool_)
    for _ in range(ROUNDS):
        chosen = np.abs(local[:, 2] - _basis(local) @ parameters[:6]) <= needed
        if chosen.sum() < LEAST_VOXELS:
            return None
        if (chosen == before).all():
            break
        before = chosen
        fitted = _solve(local[chosen], values[chosen], parameters, box)
        if fitted is None:
            return None
        parameters, covariance = fitted
    # Between slices that leave a gap nothing was measured: a surface may lie anywhere in it.
    unseen = max(gap * across - box - 2.0 * float(np.exp(parameters[8])), 0.0)
    covariance[0, 0] += unseen**2 / 12.0
    return _Patch(place, axes, parameters, covariance)


def _gap(volume: CTVolume, place: FloatArray) -> float:
    """Distance between the slices about ``place``."""
    positions = volume.grid.slice_positions_mm
    k = int(np.clip(np.searchsorted(positions, place @ volume.grid.normal), 1, len(positions) - 1))
    return float(positions[k] - positions[k - 1])


def _steepest(offsets: FloatArray, values: FloatArray, outward: FloatArray) -> FloatArray:
    """Direction of the mean gradient, turned to the side of ``outward``: the first guess of the normal."""
    design = np.column_stack([np.ones(len(offsets)), offsets])
    gradient = np.linalg.lstsq(design, values, rcond=None)[0][1:]
    if not np.linalg.norm(gradient) > 0:
        return outward
    normal = unit(gradient.tolist())
    return normal if normal @ outward >= 0 else -normal


def _axes(normal: FloatArray) -> FloatArray:
    """Rows a, b, c with c the normal (3, 3)."""
    a = unit(np.cross(normal, np.eye(3)[np.abs(normal).argmin()]))
    return np.stack([a, np.cross(normal, a), normal])


def _basis(local: FloatArray) -> FloatArray:
    """Terms (N, 6) of the height z(a, b)."""
    a, b = local[:, 0], local[:, 1]
    return np.column_stack([np.ones_like(a), a, b, a * a / 2, a * b, b * b / 2])


def _solve(
    local: FloatArray, values: FloatArray, start: FloatArray, box: float
) -> tuple[FloatArray, FloatArray] | None:
    """Return the parameters (9,) and their covariance (9, 9), or None when there is no step.

    Damped Gauss-Newton (Levenberg and Marquardt) on the squared misfit with the priors.
    """
    basis = _basis(local)
    above = local[:, 2] > basis @ start[:6]
    if above.all() or not above.any():
        return None
    inner, outer = np.median(values[~above]), np.median(values[above])
    if abs(outer - inner) < LEAST_CONTRAST_HU:
        return None
    guess = np.array([*start[:6], inner, outer, start[8] or EXPECTED[8]])
    variance = (NOISE_SHARE * (outer - inner)) ** 2
    damping, cost = 1e-3, np.inf
    information = gradient = np.empty(0)
    best = guess
    for _ in range(MOST_STEPS):
        model, slopes = _step(local, basis, guess, box)
        misfit = values - model
        cost_now = float(misfit @ misfit) / variance + float((PRIOR * (guess - EXPECTED) ** 2).sum())
        if cost_now < cost:
            better, best, cost, damping = cost - cost_now, guess, cost_now, damping / 10
            information = slopes.T @ slopes / variance + np.diag(PRIOR)
            gradient = slopes.T @ misfit / variance - PRIOR * (guess - EXPECTED)
            if better < 1e-4:
                break
        else:
            damping *= 10
        guess = best + np.linalg.solve(information + damping * np.diag(np.diag(information)), gradient)
    if not (np.isfinite(best).all() and abs(best[7] - best[6]) >= LEAST_CONTRAST_HU):
        return None
    spread = max(cost / max(len(values) - 9, 1), 1e-6)
    covariance = spread * np.asarray(np.linalg.inv(information), dtype=np.float64)
    return best, covariance


def _step(
    local: FloatArray, basis: FloatArray, parameters: FloatArray, box: float
) -> tuple[FloatArray, FloatArray]:
    """Return the modelled values (N,) and their derivatives (N, 9)."""
    from scipy.special import ndtr

    a, b = local[:, 0], local[:, 1]
    inner, outer, blur = parameters[6], parameters[7], np.exp(np.clip(parameters[8], -3.0, 1.5))
    slope_a = parameters[1] + parameters[3] * a + parameters[4] * b
    slope_b = parameters[2] + parameters[4] * a + parameters[5] * b
    shrink = 1.0 / np.sqrt(1.0 + slope_a**2 + slope_b**2)
    distance = (local[:, 2] - basis @ parameters[:6]) * shrink
    width = max(box, 0.1 * blur)
    high, low = (distance + width / 2) / blur, (distance - width / 2) / blur
    bell_high, bell_low = (np.exp(-(y**2) / 2) / np.sqrt(2 * np.pi) for y in (high, low))
    share = blur / width * (high * ndtr(high) + bell_high - low * ndtr(low) - bell_low)
    rate = (ndtr(high) - ndtr(low)) / width
    by_blur = (bell_high - bell_low) / width * blur
    step = outer - inner
    slopes = np.column_stack([-step * (rate * shrink)[:, None] * basis, 1.0 - share, share, step * by_blur])
    return inner + step * share, slopes


def _meet(patch: _Patch, place: FloatArray, outward: FloatArray) -> tuple[float, FloatArray]:
    """Return where the ray through ``place`` crosses the patch (mm from ``place``), and the normal (3,) there."""
    direction = patch.axes @ outward
    h = patch.parameters
    reach = 0.0
    slope_a = slope_b = 0.0
    for _ in range(20):
        a, b, c = reach * direction
        slope_a, slope_b = h[1] + h[3] * a + h[4] * b, h[2] + h[4] * a + h[5] * b
        height = float((_basis(np.array([[a, b, c]])) @ h[:6])[0])
        rate = direction[2] - slope_a * direction[0] - slope_b * direction[1]
        change = (height - c) / rate if abs(rate) > 1e-6 else 0.0
        reach += change
        if abs(change) < 1e-6:
            break
    normal = unit(patch.axes[2] - slope_a * patch.axes[0] - slope_b * patch.axes[1])
    return reach, normal
