"""The evidence of pairings whose points have anisotropic errors: maximum likelihood by Gauss-Newton."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from ronnaplan.correspondence.evidence import ROTATION_PRECISION, log_misfit
from ronnaplan.correspondence.inputs import ErrorModel
from ronnaplan.geometry import FloatArray

if TYPE_CHECKING:
    from ronnaplan.correspondence.matching import Problem
    from ronnaplan.correspondence.pairing import IntArray

STEPS = 6
"""Gauss-Newton steps from the closed-form fit; each leaves about 1 % of the error, so 6 are ample."""


def anisotropic_log_evidence(problem: Problem, partners: IntArray, constants: FloatArray) -> FloatArray:
    """Return the log evidence (L,) of pairings given as the OTS partner of each CT point (L, n)."""
    ct_covariances, ots_covariances = full(problem.ct_errors), full(problem.ots_errors)
    result = np.empty(len(partners))
    for index, partner in enumerate(partners):
        i = np.flatnonzero(partner >= 0)
        j = partner[i]
        chi2, volume = fit_anisotropic(problem.ct[i], problem.ots[j], ct_covariances[i], ots_covariances[j])
        scatter = float(((problem.ct[i] - problem.ct[i].mean(axis=0)) ** 2).sum())
        result[index] = (
            constants[len(i)] + volume - 0.5 * scatter / problem.spread_mm**2 + float(log_misfit(chi2, len(i)))
        )
    return result


def full(errors: ErrorModel) -> FloatArray:
    """Return errors as covariances (N, 3, 3)."""
    if errors.covariances is not None:
        return errors.covariances
    return np.asarray(errors.variances[:, None, None] * np.eye(3))


def fit_anisotropic(
    ct: FloatArray, ots: FloatArray, ct_cov: FloatArray, ots_cov: FloatArray
) -> tuple[float, float]:
    """Fit pairs (k, 3), (k, 3): chi^2, and -1/2 (sum ln det C + ln det of the information on the transform).

    C = R C_ct R^T + C_ots is a pair's covariance at the fitted rotation R.
    """
    from scipy.spatial.transform import Rotation

    centre = ct.mean(axis=0)
    x = ct - centre
    rotation = Rotation.align_vectors(ots - ots.mean(axis=0), x)[0].as_matrix() if len(ct) > 1 else np.eye(3)
    shift = ots.mean(axis=0)
    information = np.eye(6)
    for step in range(STEPS + 1):
        moved = x @ rotation.T
        residual = ots - moved - shift
        covariance = rotation @ ct_cov @ rotation.T + ots_cov
        inverse = np.linalg.inv(covariance)
        jacobian = np.zeros((len(ct), 3, 6))
        jacobian[:, :, :3] = -cross_matrices(moved)
        jacobian[:, :, 3:] = np.eye(3)
        information = np.einsum("kac,kab,kbd->cd", jacobian, inverse, jacobian)
        information[:3, :3] += ROTATION_PRECISION * np.eye(3)
        if step < STEPS:
            update = np.linalg.solve(information, np.einsum("kac,kab,kb->c", jacobian, inverse, residual))
            rotation = Rotation.from_rotvec(update[:3]).as_matrix() @ rotation
            shift = shift + update[3:]
    chi2 = float(np.einsum("ka,kab,kb->", residual, inverse, residual))
    volume = -0.5 * float(np.linalg.slogdet(covariance)[1].sum() + np.linalg.slogdet(information)[1])
    return chi2, volume if math.isfinite(volume) else -math.inf


def cross_matrices(vectors: FloatArray) -> FloatArray:
    """Return the cross-product matrices (k, 3, 3) of vectors (k, 3)."""
    x, y, z = vectors.T
    zero = np.zeros_like(x)
    return np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]]).transpose(2, 0, 1)
