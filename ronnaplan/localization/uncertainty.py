"""The covariance of a fitted centre: what the image itself shows of noise and model error.

The centre is a weighted sum of voxel values (`BallFit.influence_mm_per_hu`), so what the residuals of one slice do to
it is their weighted sum. Slices are measured apart, so these sums are taken as independent, and the sum of their
squares is the cluster-robust "sandwich" estimate of the covariance (K.-Y. Liang and S. Zeger, Biometrika 73:13, 1986):
noise enters with its correlation within the slice as it is, and so does whatever else differs from slice to slice,
such as streaks and a blur that is not quite Gaussian.

What all slices share, no residual shows. It is stated from signs of it: a background that slopes (streaks and
shading, which never just slope), a blur and slices that are not small beside the ball. How much each stands for was
fitted to the errors on simulated patients, which `docs/localization.md` names.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ronnaplan.geometry import FloatArray
from ronnaplan.localization.directions import cell_means, edge_depth
from ronnaplan.localization.neighbourhood import direction_cells
from ronnaplan.localization.refine import BallFit

MIN_FLAT_VOXELS = 30
"""A zone with fewer voxels says nothing of the noise."""

MIN_FREEDOM = 0.3
"""Share of a zone's voxels that is left at least after each direction has used one for its mean."""

QUANTIZATION_NOISE_HU = 12.0**-0.5
"""Standard deviation of rounding to whole HU: no scan has less noise than this."""

SEEN_SHARE = 0.87
CORRELATION_POWER = 0.5
NOISE_POWER = 0.25
"""How much of what the slices show is error. It grows with the correlation within the slice: what is correlated over a
sector is also so over distances that a ball is too small to show. And with the share of noise in the residuals: the
rest is mostly a blur that is not quite Gaussian, alike on opposite sides."""

LEAST_NOISE_SHARE = 0.01
"""Noise is counted as at least this share of the residuals."""

SECTORS = 8
"""Each slice of the ball is cut into so many sectors to see the correlation within it."""

NEIGHBOUR_BOUNDS = (-0.5, 0.3)
"""Neighbouring slices that err alike add their correlation, within these bounds: a few slices tell it roughly."""

EVEN_SHARE = 0.6
"""How much is added of what residuals of the same size without any correlation would do: the ball's few slices may
show too little by chance."""

SHARED_SLICES = 1.0
"""Within the slice plane the error is shared between the axes as evenly strong noise would share it, with the weight
of so many slices: by chance a few slices show too little along one of them."""

SLOPE_ERROR = 5.0
"""Standard error along a sloping background, as a multiple of slope x blur / contrast (across the slices their
thickness is the blur): a streak never just slopes."""

CURVED_BLUR_ERROR = 0.018
"""Standard error within the slice plane, as a share of blur^3 / radius^2: the blur is not quite Gaussian, which shows
where it is not small beside the ball."""

POLE_ERROR = 0.0015
"""Standard error across the slices, as a share of thickness^2 / radius, the depth of the ball's pole in a slice: the
slices' profile is not quite a box."""

LEAST_ERROR_MM = 0.00005
"""Standard error per axis that stays in any scan: finite tables."""

SMALLEST = 1e-30
"""Keeps ratios of squares finite where a fit leaves nothing over."""


def center_covariance(fit: BallFit, noise_hu: float) -> FloatArray:
    """Covariance (3, 3) of the fitted centre in LPS, mm^2: noise (``noise_hu``) and model error."""
    total = _seen_covariance(fit, noise_hu) + _unseen_covariance(fit)
    axes = fit.neighbourhood.axes
    rotated: FloatArray = axes.T @ total @ axes
    return (rotated + rotated.T) / 2.0


def cramer_rao_bound(fit: BallFit, noise_hu: float) -> FloatArray:
    """Least covariance (3, 3) in LPS, mm^2, of any unbiased fit of this model to the whole ball's voxels.

    For uncorrelated noise of ``noise_hu``, and as if nothing touched the ball (S. Kay, Fundamentals of
    Statistical Signal Processing: Estimation Theory, 1993, section 3.9).
    """
    information = fit.jacobian.T @ fit.jacobian / noise_hu**2
    bound = np.linalg.pinv(information, hermitian=True)[:3, :3]
    axes = fit.neighbourhood.axes
    rotated: FloatArray = axes.T @ bound @ axes
    return rotated


def noise_level(fit: BallFit) -> float:
    """Standard deviation of the noise (HU) where the ball and its surroundings are flat.

    Robust to streaks (each direction's mean is taken off) and to air at the bottom of the scale (only the upper
    half of the values counts); the quieter of inside and outside, for what disturbs only adds.
    """
    depth, blur = edge_depth(fit.neighbourhood.offsets_mm, fit.theta)
    cells = direction_cells(fit.neighbourhood.offsets_mm - fit.theta[:3])
    measured = fit.jacobian[:, 7] != 0.0  # clipped voxels have no noise
    flat = fit.used & measured & (np.abs(depth) > 2.0 * blur)
    levels = []
    for zone in (flat & (depth < 0), flat & (depth > 0)):
        if np.count_nonzero(zone) < MIN_FLAT_VOXELS:
            continue
        means, seen = cell_means(fit.residuals_hu, cells, zone)
        left_over = (fit.residuals_hu - means[cells])[zone]
        middle = np.median(left_over)
        spread = 1.4826 * float(np.median(left_over[left_over >= middle] - middle))
        freedom = max(1.0 - np.count_nonzero(seen) / len(left_over), MIN_FREEDOM)
        levels.append(spread / float(np.sqrt(freedom)))
    return max(min(levels, default=_rms(fit.residuals_hu[fit.used])), QUANTIZATION_NOISE_HU)


def _seen_covariance(fit: BallFit, noise_hu: float) -> FloatArray:
    """Covariance (3, 3) along u, v, w from what the residuals do to the centre, slice by slice."""
    influence, residuals = fit.influence_mm_per_hu[fit.used], fit.residuals_hu[fit.used]
    moves = influence * residuals[:, np.newaxis]
    mean_square = max(float(residuals @ residuals) / max(len(residuals), 1), SMALLEST)
    even = influence.T @ influence * mean_square
    slices = np.unique(fit.neighbourhood.indices[fit.used, 0], return_inverse=True)[1]
    sums = _sums(moves, slices)
    sectors = _sums(moves, slices * SECTORS + _sectors(fit))
    size = max(float(np.sum(sums**2)), SMALLEST)
    correlation = max(float(np.sum(sectors**2)), SMALLEST) / max(float(np.trace(even)), SMALLEST)
    alike = np.clip(2.0 * float(np.sum(sums[1:] * sums[:-1])) / size, *NEIGHBOUR_BOUNDS)
    noise_share = np.clip(noise_hu**2 / mean_square, LEAST_NOISE_SHARE, 1.0)
    seen = SEEN_SHARE * correlation**CORRELATION_POWER * noise_share**NOISE_POWER * (1.0 + alike)
    freedom = len(sums) / max(len(sums) - 2, 1)  # the fit has adapted to a few slices more than to many
    shared = _shared_in_plane(sums.T @ sums, even, SHARED_SLICES / (len(sums) + SHARED_SLICES))
    covariance: FloatArray = seen * freedom * shared + EVEN_SHARE * even
    return covariance


def _sectors(fit: BallFit) -> NDArray[np.intp]:
    """In which sector of its slice each used voxel lies."""
    offsets = fit.neighbourhood.offsets_mm[fit.used] - fit.theta[:3]
    turn = np.arctan2(offsets[:, 1], offsets[:, 0]) / (2.0 * np.pi) + 0.5
    sectors: NDArray[np.intp] = (turn * SECTORS).astype(np.intp) % SECTORS
    return sectors


def _sums(moves: FloatArray, groups: NDArray[np.intp]) -> FloatArray:
    """Sum of ``moves`` (N, 3) in each of the ``groups`` (N,)."""
    sums = np.zeros((int(groups.max(initial=0)) + 1, 3))
    np.add.at(sums, groups, moves)
    return sums


def _shared_in_plane(covariance: FloatArray, even: FloatArray, share: float) -> FloatArray:
    """Draw u and v of ``covariance`` (3, 3) by ``share`` towards what ``even`` noise would do to them."""
    drawn = (1.0 - share) * covariance
    scale = np.trace(covariance[:2, :2]) / max(float(np.trace(even[:2, :2])), SMALLEST)
    drawn[:2, :2] += share * scale * even[:2, :2]
    drawn[2, 2] = covariance[2, 2]
    return drawn


def _unseen_covariance(fit: BallFit) -> FloatArray:
    """Covariance (3, 3) along u, v, w from what all slices share."""
    radius_mm, blur_mm, thickness_mm = fit.theta[3:6]
    sloping_mm = SLOPE_ERROR * np.array([blur_mm, blur_mm, thickness_mm]) * fit.theta[8:11] / fit.contrast_hu
    curved_mm = CURVED_BLUR_ERROR * blur_mm**3 / radius_mm**2
    pole_mm = POLE_ERROR * thickness_mm**2 / radius_mm
    own_mm = np.array([curved_mm, curved_mm, pole_mm])
    covariance: FloatArray = np.outer(sloping_mm, sloping_mm) + np.diag(own_mm**2 + LEAST_ERROR_MM**2)
    return covariance


def _rms(values: FloatArray) -> float:
    return max(float(np.sqrt(np.mean(values**2))), QUANTIZATION_NOISE_HU) if values.size else 1.0
