"""The covariance of a fitted centre: noise as it is in the image, plus what the model cannot know.

CT noise is correlated from voxel to voxel, so counting voxels as independent would misstate the accuracy. The
centre is a weighted sum of voxel values (`BallFit.influence_mm_per_hu`), so its covariance is that weighting
applied on both sides of the noise's autocovariance, which is measured from the residuals of the fit itself.

At usual doses noise is the smaller part. The larger is what
the model leaves over: streaks, blur that is not quite Gaussian, neighbours. It shows in two ways: as misfit that
noise does not explain, which stands for an edge displaced by a share of misfit x blur, and as a background that
slopes. Both shares were fitted to the errors on physically simulated patients (``benchmarks/localization.py``
with the seeds 100 to 102).
"""

from __future__ import annotations

import numpy as np

from ronnaplan.geometry import FloatArray
from ronnaplan.localization.directions import cell_means, edge_depth, on_surface
from ronnaplan.localization.neighbourhood import direction_cells
from ronnaplan.localization.refine import BallFit

MAX_LAG = (1, 3, 3)
"""Farthest noise correlation that is measured, in slices, rows and columns."""

MIN_PAIRS = 30
"""A correlation measured on fewer pairs of voxels is chance and is left at zero."""

MIN_FLAT_VOXELS = 30
"""A zone with fewer voxels says nothing of the noise."""

MIN_FREEDOM = 0.3
"""Share of a zone's voxels that is left at least after each direction has used one for its mean."""

QUANTIZATION_NOISE_HU = 12.0**-0.5
"""Standard deviation of rounding to whole HU: no scan has less noise than this."""

MISFIT_BLUR_SHARE = 0.45
"""Standard error per axis that the unexplained misfit stands for, as a share of misfit x blur."""

SLOPE_REACH_MM = np.array([1.7, 1.7, 5.6])
"""Standard errors along u, v, w that a sloping background (a streak, which never just slopes) stands for, as
slope / contrast x slice thickness x this."""

LEAST_ERROR_MM = 0.0007
"""Standard error per axis that stays in any scan: finite tables, edges that are not quite the model's."""


def center_covariance(fit: BallFit) -> FloatArray:
    """Covariance (3, 3) of the fitted centre in LPS, mm^2: noise and model error."""
    total = _noise_covariance(fit) + _model_covariance(fit)
    axes = fit.neighbourhood.axes
    rotated: FloatArray = axes.T @ total @ axes
    return (rotated + rotated.T) / 2.0


def cramer_rao_bound(fit: BallFit) -> FloatArray:
    """Least covariance (3, 3) in LPS, mm^2, of any unbiased fit of this model to the whole ball's voxels.

    For uncorrelated noise of the measured strength, and as if nothing touched the ball (S. Kay, Fundamentals of
    Statistical Signal Processing: Estimation Theory, 1993, section 3.9).
    """
    information = fit.jacobian.T @ fit.jacobian / noise_level(fit) ** 2
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


def noise_autocorrelation(fit: BallFit) -> FloatArray:
    """Correlation of the noise by lag in slices, rows and columns, zero lag in the middle.

    The shape is twice `MAX_LAG` plus one along each axis; lags with fewer than `MIN_PAIRS` pairs are zero.
    """
    from scipy.signal import correlate

    scale = _rms(fit.residuals_hu[fit.used])
    residuals = _on_grid(fit, np.where(fit.used, fit.residuals_hu / scale, 0.0)[:, np.newaxis])[..., 0]
    present = _on_grid(fit, fit.used.astype(np.float64)[:, np.newaxis])[..., 0]
    boxes = (residuals, present)
    padded = [np.pad(box, [(lag, lag) for lag in MAX_LAG]) for box in boxes]
    sums, counts = (
        correlate(big, box, mode="valid", method="fft") for big, box in zip(padded, boxes, strict=True)
    )
    correlation: FloatArray = np.where(counts > MIN_PAIRS, sums / np.maximum(counts, 1.0), 0.0)
    correlation[MAX_LAG] = 1.0
    return correlation


def _noise_covariance(fit: BallFit) -> FloatArray:
    """Covariance (3, 3) along u, v, w from noise alone."""
    from scipy.signal import fftconvolve

    weights = _on_grid(fit, fit.influence_mm_per_hu * noise_level(fit))
    correlation = noise_autocorrelation(fit)[..., np.newaxis]
    spread = fftconvolve(weights, correlation, mode="same", axes=(0, 1, 2))
    return _positive(weights.reshape(-1, 3).T @ spread.reshape(-1, 3))


def _model_covariance(fit: BallFit) -> FloatArray:
    """Covariance (3, 3) along u, v, w from what is not noise."""
    near = fit.used & on_surface(fit.neighbourhood.offsets_mm, fit.theta)
    unexplained_hu2 = max(_rms(fit.residuals_hu[near]) ** 2 - noise_level(fit) ** 2, 0.0)
    from_misfit = MISFIT_BLUR_SHARE * np.sqrt(unexplained_hu2) / fit.contrast_hu * fit.sigma_mm
    slope = float(np.linalg.norm(fit.theta[8:11])) / fit.contrast_hu
    from_slope = SLOPE_REACH_MM * fit.theta[5] * slope
    return np.diag(from_misfit**2 + from_slope**2 + LEAST_ERROR_MM**2)


def _rms(values: FloatArray) -> float:
    return max(float(np.sqrt(np.mean(values**2))), QUANTIZATION_NOISE_HU) if values.size else 1.0


def _on_grid(fit: BallFit, values: FloatArray) -> FloatArray:
    """Lay per-voxel values (N, C) out on their box of the scan (K, J, I, C), zero elsewhere."""
    indices = fit.neighbourhood.indices
    low = indices.min(axis=0)
    box = np.zeros((*(indices.max(axis=0) - low + 1), values.shape[1]))
    box[tuple((indices - low).T)] = values
    return box


def _positive(matrix: FloatArray) -> FloatArray:
    """Nearest symmetric matrix without negative variances (a measured autocovariance may give a tiny one)."""
    values, vectors = np.linalg.eigh((matrix + matrix.T) / 2.0)
    positive: FloatArray = (vectors * np.maximum(values, 0.0)) @ vectors.T
    return positive
