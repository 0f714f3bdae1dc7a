"""The covariance of a fitted centre: noise as it is in the image, plus what the model cannot know.

CT noise is correlated from voxel to voxel, so counting voxels as independent would overstate the accuracy. The
centre is a weighted sum of voxel values (`BallFit.influence_mm_per_hu`), so its covariance is that weighting
applied on both sides of the noise's autocovariance, which is measured from the residuals of the fit itself.
"""

from __future__ import annotations

import numpy as np

from ronnaplan.geometry import FloatArray
from ronnaplan.localization.refine import BallFit

MAX_LAG = (1, 3, 3)
"""Farthest noise correlation that is measured, in slices, rows and columns."""

MIN_PAIRS = 30
"""A correlation measured on fewer pairs of voxels is chance and is left at zero."""

QUANTIZATION_VARIANCE_HU2 = 1.0 / 12.0
"""Variance of rounding to whole HU: no scan has less noise than this."""

MODEL_ERROR_MM = 0.002
"""Standard error per axis that stays however low the noise: edges that are not quite the model's."""


def center_covariance(fit: BallFit) -> FloatArray:
    """Covariance (3, 3) of the fitted centre in LPS, mm^2."""
    noise_hu = _local_noise(fit)
    weights = _on_grid(fit, fit.influence_mm_per_hu * noise_hu[:, np.newaxis])
    correlation = noise_autocorrelation(fit, noise_hu)
    correlated = _correlate(weights, correlation)
    total = weights.reshape(-1, 3).T @ correlated.reshape(-1, 3)
    total = _positive(total) + MODEL_ERROR_MM**2 * np.eye(3)
    axes = fit.neighbourhood.axes
    rotated: FloatArray = axes.T @ total @ axes
    return (rotated + rotated.T) / 2.0


def cramer_rao_bound(fit: BallFit) -> FloatArray:
    """Least covariance (3, 3) in LPS, mm^2, of any unbiased fit of this model to the whole ball's voxels.

    For uncorrelated noise of the measured strength, and as if nothing touched the ball (S. Kay, Fundamentals of
    Statistical Signal Processing: Estimation Theory, 1993, section 3.9).
    """
    weighted = fit.jacobian / _local_noise(fit)[:, np.newaxis]
    information = weighted.T @ weighted
    bound = np.linalg.pinv(information, hermitian=True)[:3, :3]
    axes = fit.neighbourhood.axes
    rotated: FloatArray = axes.T @ bound @ axes
    return rotated


def _local_noise(fit: BallFit) -> FloatArray:
    """Noise (N,) in HU at each voxel: one level inside the ball and one outside, where air may clip it."""
    inside = np.linalg.norm(fit.neighbourhood.offsets_mm - fit.theta[:3], axis=1) < fit.theta[3]
    freedom = max(1.0 - len(fit.theta) / max(int(fit.used.sum()), 1), 0.1)
    noise = np.empty(len(inside))
    for zone in (inside, ~inside):
        squares = fit.residuals_hu[zone & fit.used] ** 2
        variance = float(squares.mean()) / freedom if squares.size else 0.0
        noise[zone] = np.sqrt(max(variance, QUANTIZATION_VARIANCE_HU2))
    return noise


def noise_autocorrelation(fit: BallFit, noise_hu: FloatArray) -> FloatArray:
    """Correlation of the noise by lag in slices, rows and columns, zero lag in the middle.

    The shape is twice `MAX_LAG` plus one along each axis; lags with fewer than `MIN_PAIRS` pairs are zero.
    """
    from scipy.signal import correlate

    relative = np.where(fit.used, fit.residuals_hu / noise_hu, 0.0)
    residuals = _on_grid(fit, relative[:, np.newaxis])[..., 0]
    present = _on_grid(fit, fit.used.astype(np.float64)[:, np.newaxis])[..., 0]
    padded = [np.pad(box, [(lag, lag) for lag in MAX_LAG]) for box in (residuals, present)]
    sums, counts = (
        correlate(big, box, mode="valid", method="fft")
        for big, box in zip(padded, (residuals, present), strict=True)
    )
    correlation: FloatArray = np.where(counts > MIN_PAIRS, sums / np.maximum(counts, 1.0), 0.0)
    correlation[MAX_LAG] = 1.0
    return correlation


def _correlate(weights: FloatArray, correlation: FloatArray) -> FloatArray:
    """Spread each channel of ``weights`` (K, J, I, C) over its neighbours by the correlation of the noise."""
    from scipy.signal import fftconvolve

    spread: FloatArray = fftconvolve(weights, correlation[..., np.newaxis], mode="same", axes=(0, 1, 2))
    return spread


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
