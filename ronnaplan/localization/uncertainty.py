"""The covariance of a fitted centre: noise as it is in the image, plus what the model cannot know.

CT noise is correlated from voxel to voxel, so counting voxels as independent would overstate the accuracy. The
centre is a weighted sum of voxel values (`BallFit.influence_mm_per_hu`), so its covariance is that weighting
applied on both sides of the noise's autocovariance, which is measured from the residuals of the fit itself.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ronnaplan.geometry import FloatArray
from ronnaplan.localization.refine import BallFit

MAX_LAG = (1, 3, 3)
"""Farthest noise correlation that is measured, in slices, rows and columns."""

QUANTIZATION_VARIANCE_HU2 = 1.0 / 12.0
"""Variance of rounding to whole HU: no scan has less noise than this."""

MODEL_ERROR_MM = 0.002
"""Standard error per axis that stays however low the noise: edges that are not quite the model's."""


def center_covariance(fit: BallFit) -> FloatArray:
    """Covariance (3, 3) of the fitted centre in LPS, mm^2."""
    covariances = noise_autocovariance(fit)
    weights = _on_grid(fit, fit.influence_mm_per_hu)
    total = np.zeros((3, 3))
    for lag, covariance in covariances.items():
        first, second = _shifted(weights, lag)
        pairs = first.reshape(-1, 3).T @ second.reshape(-1, 3)
        total += covariance * (pairs if lag == (0, 0, 0) else pairs + pairs.T)
    total = _positive(total) + MODEL_ERROR_MM**2 * np.eye(3)
    axes = fit.neighbourhood.axes
    rotated: FloatArray = axes.T @ total @ axes
    return (rotated + rotated.T) / 2.0


def noise_autocovariance(fit: BallFit) -> dict[tuple[int, int, int], float]:
    """Autocovariance of the residuals (HU^2) by lag in slices, rows and columns; one of each +- pair of lags."""
    residuals = _on_grid(fit, np.where(fit.used, fit.residuals_hu, 0.0)[:, np.newaxis])[..., 0]
    present = _on_grid(fit, fit.used.astype(np.float64)[:, np.newaxis])[..., 0]
    freedom = max(float(fit.used.sum()) - len(fit.theta), 1.0) / max(float(fit.used.sum()), 1.0)
    result = {}
    for lag in _half_lags():
        first, second = _shifted(residuals, lag)
        count = float(np.vdot(*_shifted(present, lag)))
        if count >= 1.0:
            result[lag] = float(np.vdot(first, second)) / count / freedom
    result[(0, 0, 0)] = max(result.get((0, 0, 0), 0.0), QUANTIZATION_VARIANCE_HU2)
    return result


def _half_lags() -> list[tuple[int, int, int]]:
    dk, dj, di = MAX_LAG
    every = [(k, j, i) for k in range(-dk, dk + 1) for j in range(-dj, dj + 1) for i in range(-di, di + 1)]
    return [lag for lag in every if lag >= (0, 0, 0)]


def _on_grid(fit: BallFit, values: FloatArray) -> FloatArray:
    """Lay per-voxel values (N, C) out on their box of the scan (K, J, I, C), zero elsewhere."""
    indices = fit.neighbourhood.indices
    low = indices.min(axis=0)
    box = np.zeros((*(indices.max(axis=0) - low + 1), values.shape[1]))
    box[tuple((indices - low).T)] = values
    return box


def _shifted(box: NDArray[np.float64], lag: tuple[int, int, int]) -> tuple[FloatArray, FloatArray]:
    """The two views of ``box`` whose equal places are ``lag`` apart."""
    first = tuple(slice(max(0, -step), min(n, n - step)) for n, step in zip(box.shape, lag, strict=False))
    second = tuple(slice(max(0, step), min(n, n + step)) for n, step in zip(box.shape, lag, strict=False))
    return box[first], box[second]


def _positive(matrix: FloatArray) -> FloatArray:
    """Nearest symmetric matrix without negative variances (a measured autocovariance may give a tiny one)."""
    values, vectors = np.linalg.eigh((matrix + matrix.T) / 2.0)
    positive: FloatArray = (vectors * np.maximum(values, 0.0)) @ vectors.T
    return positive
