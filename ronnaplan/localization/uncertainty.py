"""The covariance of a fitted centre: what the image itself shows of noise and model error.

The centre is a weighted sum of voxel values (`BallFit.influence_mm_per_hu`), so what the residuals of one slice do to
it is their weighted sum. Slices are measured apart, so these sums are taken as independent, and the sum of their
squares is the cluster-robust "sandwich" estimate of the covariance (K.-Y. Liang and S. Zeger, Biometrika 73:13, 1986):
noise enters with its correlation within the slice as it is, and so does whatever else differs from slice to slice,
such as streaks and a blur that is not quite Gaussian.

What all slices share, no residual shows. It is stated from two signs of it: a background that slopes (streaks and
shading, which never just slope), and the slices' thickness. How much each stands for was fitted to the errors on
physically simulated patients, which `docs/localization.md` names.
"""

from __future__ import annotations

import numpy as np

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

SEEN_SHARE = 1.55
SYMMETRIC_MISFIT = 0.038
"""How much of what the slices show is error, and the misfit beyond noise (as a share of the contrast) at which only
half of that is: such a misfit is a blur that is not quite Gaussian, alike on opposite sides."""

SHARED_SLICES = 1.0
"""Within the slice plane the error is shared between the axes as evenly strong noise would share it, with the weight
of so many slices: by chance a few slices show too little along one of them."""

SLOPE_ERROR = 5.0
"""Standard error along a sloping background, as a multiple of slope x blur / contrast (across the slices their
thickness is the blur): a streak never just slopes."""

THICKNESS_ERROR = 0.0005
"""Standard error across the slices, as a share of their thickness: their profile is not quite a box."""

LEAST_ERROR_MM = 0.00005
"""Standard error per axis that stays in any scan: finite tables."""


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
    """Covariance (3, 3) along u, v, w from what the residuals of each slice do to the centre."""
    slices = fit.neighbourhood.indices[fit.used, 0]
    moves = (fit.influence_mm_per_hu * fit.residuals_hu[:, np.newaxis])[fit.used]
    sums = np.zeros((int(slices.max(initial=0)) + 1, 3))
    np.add.at(sums, slices, moves)
    count = len(np.unique(slices))
    freedom = count / max(count - 2, 1)  # centre and background have adapted to a few slices more than to many
    unexplained = max(fit.misfit**2 - (noise_hu / fit.contrast_hu) ** 2, 0.0)
    seen = SEEN_SHARE / (1.0 + unexplained / SYMMETRIC_MISFIT**2)
    return seen * freedom * _shared_in_plane(sums.T @ sums, fit, SHARED_SLICES / (count + SHARED_SLICES))


def _shared_in_plane(covariance: FloatArray, fit: BallFit, share: float) -> FloatArray:
    """Draw u and v of ``covariance`` (3, 3) by ``share`` towards what evenly strong noise would do to them."""
    even = fit.influence_mm_per_hu[:, :2].T @ fit.influence_mm_per_hu[:, :2]
    drawn = (1.0 - share) * covariance
    drawn[:2, :2] += share * even * np.trace(covariance[:2, :2]) / max(float(np.trace(even)), 1e-30)
    drawn[2, 2] = covariance[2, 2]
    return drawn


def _unseen_covariance(fit: BallFit) -> FloatArray:
    """Covariance (3, 3) along u, v, w from what all slices share."""
    blur_mm = np.array([fit.sigma_mm, fit.sigma_mm, fit.theta[5]])
    sloping_mm = SLOPE_ERROR * blur_mm * fit.theta[8:11] / fit.contrast_hu
    thickness_mm = np.array([0.0, 0.0, THICKNESS_ERROR * fit.theta[5]])
    covariance: FloatArray = np.outer(sloping_mm, sloping_mm) + np.diag(thickness_mm**2 + LEAST_ERROR_MM**2)
    return covariance


def _rms(values: FloatArray) -> float:
    return max(float(np.sqrt(np.mean(values**2))), QUANTIZATION_NOISE_HU) if values.size else 1.0
