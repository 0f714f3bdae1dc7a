"""Where a ray crosses a surface of the head, and the surface's normal there, from the voxels about the crossing.

A small patch z(a, b) of third order is fitted with the blurred step it causes in every voxel at that voxel's true
place (nothing is interpolated): two levels, one on each side, joined by the integral of a Gaussian, averaged over
the slice's thickness. The surface is the half level between the two local media; the noise is averaged over all
voxels of the patch, some hundreds to thousands.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ronnaplan.ct.volume import CTVolume
from ronnaplan.geometry import FloatArray, axes_across, unit
from ronnaplan.minimize import minimize
from ronnaplan.planning.patch import (
    BLUR,
    HEIGHTS,
    INNER,
    OUTER,
    PARAMETERS,
    SLOPE_A,
    SLOPE_B,
    heights,
    normal_equations,
    polynomials,
    slopes,
)
from ronnaplan.planning.voxels import gap_mm, voxels_near

PATCH_RADIUS_MM = 12.0
"""The patch reaches this far to all sides for its slope and curvature; bone is smooth over two centimetres."""

NEAR_RADIUS_MM = 4.0
"""Its height, levels and blur come from the voxels this near to the ray, for bone is rough and uneven."""

HALF_DEPTH_MM = 2.5
"""Voxels within this of the surface are fitted; it holds the blur of any head protocol."""

LEAST_HALF_DEPTH_MM = 1.0
"""Never fewer than this, however thin the layer."""

LEAST_VOXELS = 30
"""A patch has thirteen parameters."""

LEAST_CONTRAST_HU = 80.0
"""A step smaller than this is no surface."""

CURVATURE_PRIOR_PER_MM = 1 / 20
"""Standard deviation of the curvature expected of scalp and skull: settles it where slices are too few to tell."""

BLUR_PRIOR_MM = 0.6
"""Typical blur (standard deviation) of a head CT; known within a factor of two."""

ODD_BLUR = math.log(3.5)
"""Logarithm of a blur in mm that no head protocol has: a fit with a larger one went astray."""

LEAST_OBLIQUITY = 0.1
"""Cosine between ray and normal below which the ray grazes the surface and crosses it nowhere in particular."""

NOISE_SHARE = 0.03
"""Expected misfit of a voxel as a share of the step: sets how much the priors weigh (little)."""

EXPECTED = np.array([*(12 * [0.0]), np.log(BLUR_PRIOR_MM)])
PRIOR = np.array(
    [
        *(3 * [0.0]),
        *(3 * [CURVATURE_PRIOR_PER_MM**-2]),
        *(4 * [CURVATURE_PRIOR_PER_MM**-4]),
        *(2 * [1e-9]),
        np.log(2.0) ** -2,
    ]
)
"""Expected parameters of a patch and the inverse of their variance; heights, slopes and levels are free."""

FIXED_SHAPE = np.array([1e-9, *(9 * [1e12]), 1e-9, 1e-9, np.log(2.0) ** -2])
"""The same when slopes and curvatures are known and height, levels and blur are to be found."""

ALIKE_VOXELS = 9
"""Noise and misfit of 3 x 3 neighbours in a slice go together: they count as one voxel in the standard error."""

MOST_STEPS, FIRST_DAMPING = 40, 1e-3
LEAST_PROMISE = 1e-4
"""A fit ends when the next step promises to lessen the misfit by less than this share."""

ROUNDS = 3
"""Times the voxels are chosen anew about the fitted patch."""


@dataclass(frozen=True, eq=False)
class Surface:
    """A crossing: ``position_mm`` (3,) in LPS, its ``reach_mm`` along the ray, and the outward unit ``normal``.

    ``sd_mm`` is the standard error along the ray; ``clear`` is False where no patch could be fitted: the place is
    then that of the plain threshold, and the normal is not known (the ray's direction stands for it).
    """

    position_mm: FloatArray
    reach_mm: float
    normal: FloatArray
    sd_mm: float
    clear: bool = True


@dataclass(frozen=True, eq=False)
class _Patch:
    """Parameters (13,): ten of the height (see `heights`), inner and outer level, log of the blur."""

    origin_mm: FloatArray
    axes: FloatArray
    parameters: FloatArray
    covariance: FloatArray

    @property
    def normal(self) -> FloatArray:
        a, b, c = self.axes
        normal: FloatArray = unit(c - self.parameters[SLOPE_A] * a - self.parameters[SLOPE_B] * b)
        return normal


def fit_crossing(
    volume: CTVolume,
    start_mm: FloatArray,
    outward: FloatArray,
    reach_mm: float,
    *,
    limits_hu: tuple[float, float],
    brighter_outside: bool = False,
    half_depth_mm: float = HALF_DEPTH_MM,
) -> Surface:
    """Refine the crossing near ``reach_mm`` along the ray from ``start_mm`` (3,) along unit ``outward`` (3,).

    ``limits_hu`` bound the values, so that a third medium nearby (air above thin skin over bone) does not count;
    ``brighter_outside`` tells which way the step goes. A fit that finds something else is not believed.
    """
    place = start_mm + reach_mm * outward
    depth = max(min(half_depth_mm, HALF_DEPTH_MM), LEAST_HALF_DEPTH_MM)
    patch = _fit(volume, place, outward, depth, limits_hu)
    if patch is None:
        return Surface(place, reach_mm, outward, depth, clear=False)
    shift, normal = _meet(patch, outward)
    obliquity = abs(float(patch.normal @ outward))
    step = float(patch.parameters[OUTER] - patch.parameters[INNER])
    odd = (step > 0) != brighter_outside or patch.parameters[BLUR] > ODD_BLUR
    if odd or abs(shift) > 2 * depth or obliquity < LEAST_OBLIQUITY:
        return Surface(place, reach_mm, outward, depth, clear=False)
    sd = float(np.sqrt(patch.covariance[0, 0])) / obliquity
    return Surface(place + shift * outward, reach_mm + shift, normal, sd)


def _fit(
    volume: CTVolume, place: FloatArray, outward: FloatArray, depth: float, limits_hu: tuple[float, float]
) -> _Patch | None:
    gap = gap_mm(volume, place)
    reach = float(np.hypot(max(PATCH_RADIUS_MM, 1.2 * gap), depth))
    offsets, values = voxels_near(volume, place, reach)
    values = np.clip(values, *limits_hu)
    if len(values) < LEAST_VOXELS:
        return None
    axes = _axes(_steepest(offsets, values, outward))
    local = offsets @ axes.T
    terms = polynomials(local[:, 0], local[:, 1])
    across = abs(float(axes[2] @ volume.grid.normal))
    needed = max(depth, 0.8 * gap * across)
    box = (volume.grid.thickness_mm or gap) * across
    whole = _whole(terms, local[:, 2], values, needed, box)
    if whole is None:
        return None
    near = np.hypot(local[:, 0], local[:, 1]) <= max(NEAR_RADIUS_MM, 0.75 * gap)
    chosen = near & (np.abs(local[:, 2] - heights(terms, whole[0])) <= needed)
    fitted = None
    if chosen.sum() >= LEAST_VOXELS:
        fitted = _solve(terms[:, chosen], local[chosen, 2], values[chosen], whole[0], box, shape=whole[0])
    parameters, covariance = fitted or whole
    # Between slices that leave a gap nothing was measured: a surface may lie anywhere in it.
    in_plane = BLUR_PRIOR_MM * float(np.sqrt(max(1.0 - across**2, 0.0)))
    unseen = max(gap * across - box - 2.0 * in_plane, 0.0)
    covariance[0, 0] += unseen**2 / 12.0
    return _Patch(place, axes, parameters, covariance)


def _whole(
    terms: FloatArray, c: FloatArray, values: FloatArray, needed: float, box: float
) -> tuple[FloatArray, FloatArray] | None:
    """Fit the whole patch to the voxels within ``needed`` of it, which are chosen anew about each fit."""
    fitted = np.zeros(PARAMETERS), np.empty((PARAMETERS, PARAMETERS))
    before = np.zeros(len(c), dtype=np.bool_)
    for _ in range(ROUNDS):
        chosen = np.abs(c - heights(terms, fitted[0])) <= needed
        if chosen.sum() < LEAST_VOXELS:
            return None
        if (chosen == before).all():
            break
        before = chosen
        found = _solve(terms[:, chosen], c[chosen], values[chosen], fitted[0], box)
        if found is None:
            return None
        fitted = found
    return fitted


def _steepest(offsets: FloatArray, values: FloatArray, outward: FloatArray) -> FloatArray:
    """Direction of the mean gradient, turned to the side of ``outward``: the first guess of the normal."""
    design = np.column_stack([np.ones(len(offsets)), offsets])
    gradient = np.linalg.lstsq(design.T @ design, design.T @ values, rcond=None)[0][1:]
    if not np.linalg.norm(gradient) > 0:
        return outward
    normal = unit(gradient.tolist())
    return normal if normal @ outward >= 0 else -normal


def _axes(normal: FloatArray) -> FloatArray:
    """Rows a, b, c with c the normal (3, 3)."""
    return np.vstack([axes_across(normal), normal])


def _solve(
    terms: FloatArray,
    c: FloatArray,
    values: FloatArray,
    start: FloatArray,
    box: float,
    shape: FloatArray | None = None,
) -> tuple[FloatArray, FloatArray] | None:
    """Return the parameters (13,) and their covariance (13, 13), or None when there is no step, or too little to tell.

    The squared misfit with the priors is least there. With ``shape`` (13,) only height, levels and blur are free, the
    rest stays.
    """
    expected, prior = (EXPECTED, PRIOR) if shape is None else (shape, FIXED_SHAPE)
    above = c > heights(terms, start)
    if above.all() or not above.any():
        return None
    inner, outer = np.median(values[~above]), np.median(values[above])
    if abs(outer - inner) < LEAST_CONTRAST_HU:
        return None
    guess = np.array([*start[:HEIGHTS], inner, outer, start[BLUR] or EXPECTED[BLUR]])
    variance = (NOISE_SHARE * float(outer - inner)) ** 2

    def equations(tried: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        square, right, normal = normal_equations(terms, c, values, tried, box)
        off = tried - expected
        cost = square / variance + float((prior * off**2).sum())
        return cost, right / variance - prior * off, normal / variance + np.diag(prior)

    found = minimize(
        equations,
        guess,
        lambda _step, promise, cost: promise < LEAST_PROMISE * cost,
        most_steps=MOST_STEPS,
        damping=FIRST_DAMPING,
    )
    best = found.place
    if not (np.isfinite(best).all() and abs(best[OUTER] - best[INNER]) >= LEAST_CONTRAST_HU):
        return None
    spread = ALIKE_VOXELS * max(float(found.cost) / max(len(values) - PARAMETERS, 1), 1e-6)
    try:
        covariance = spread * np.asarray(np.linalg.inv(found.curvature), dtype=np.float64)
    except np.linalg.LinAlgError:  # few voxels on a line do not tell how the surface bends
        return None
    return best, covariance


def _meet(patch: _Patch, outward: FloatArray) -> tuple[float, FloatArray]:
    """Return where the ray through the patch's place crosses it (mm from that place), and the normal (3,) there."""
    direction = patch.axes @ outward
    reach, by_a, by_b = 0.0, np.zeros(()), np.zeros(())
    for _ in range(20):
        a, b, c = reach * direction
        terms = polynomials(a, b)
        by_a, by_b = slopes(terms, patch.parameters)
        rate = direction[2] - by_a * direction[0] - by_b * direction[1]
        change = (heights(terms, patch.parameters) - c) / rate if abs(rate) > 1e-6 else 0.0
        reach += float(change)
        if abs(change) < 1e-6:
            break
    normal = unit(patch.axes[2] - by_a * patch.axes[0] - by_b * patch.axes[1])
    return reach, normal
