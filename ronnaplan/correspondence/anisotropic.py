"""The evidence of pairings whose points have anisotropic errors: each fitted by maximum likelihood."""

from __future__ import annotations

import numpy as np

from ronnaplan.correspondence.evidence import ROTATION_PRECISION, log_misfit
from ronnaplan.correspondence.pairing import IntArray
from ronnaplan.correspondence.problem import Problem
from ronnaplan.geometry import FloatArray
from ronnaplan.rigid import fit_likelihood
from ronnaplan.transforms import point_jacobian, transform_points


def anisotropic_log_evidence(
    problem: Problem, partners: IntArray, constants: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the log evidence (L,) and the chi^2 (L,) of pairings given as the OTS partner of each CT point (L, n)."""
    ct_mm2, ots_mm2 = problem.ct_errors.full(), problem.ots_errors.full()
    log_evidence, chi2 = np.empty(len(partners)), np.empty(len(partners))
    sizes = (partners >= 0).sum(axis=1)
    for size in np.unique(sizes):
        alike = np.flatnonzero(sizes == size)
        i = np.nonzero(partners[alike] >= 0)[1].reshape(-1, size)
        j = np.take_along_axis(partners[alike], i, axis=1)
        ct = problem.ct[i]
        chi2[alike], volume = fit_anisotropic(ct, problem.ots[j], ct_mm2[i], ots_mm2[j])
        scatter = ((ct - ct.mean(axis=1, keepdims=True)) ** 2).sum(axis=(1, 2))
        misfit = np.array([log_misfit(one, size) for one in chi2[alike]])
        log_evidence[alike] = constants[size] + volume - 0.5 * scatter / problem.spread_mm**2 + misfit
    return log_evidence, chi2


def fit_anisotropic(
    ct: FloatArray, ots: FloatArray, ct_mm2: FloatArray, ots_mm2: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Fit pairs (L, k, 3): chi^2 (L,), and -1/2 (sum ln det C + ln det of the information on the transform).

    C = R C_ct R^T + C_ots is a pair's covariance at the fitted rotation R.
    """
    matrix, _ = fit_likelihood(ct, ots, ct_mm2, ots_mm2)
    rotation = matrix[:, None, :3, :3]
    covariance = rotation @ ct_mm2 @ rotation.swapaxes(-1, -2) + ots_mm2
    inverse = np.linalg.inv(covariance)
    moved = transform_points(matrix, ct)
    residual = (ots - moved)[..., None]
    chi2 = (residual.swapaxes(-1, -2) @ inverse @ residual).sum(axis=(1, 2, 3))
    jacobian = point_jacobian(moved - moved.mean(axis=1, keepdims=True))
    information = (jacobian.swapaxes(-1, -2) @ inverse @ jacobian).sum(axis=1)
    information[:, :3, :3] += ROTATION_PRECISION * np.eye(3)
    volume = -0.5 * (np.linalg.slogdet(covariance)[1].sum(axis=1) + np.linalg.slogdet(information)[1])
    return chi2, np.where(np.isfinite(volume), volume, -np.inf)
