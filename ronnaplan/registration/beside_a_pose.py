"""What else than the pose would let pairs agree: further unknowns, fitted beside a small movement of all together.

All is to first order about a rigid fit, and weighted with the covariances of what it leaves.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ronnaplan.geometry import FloatArray
from ronnaplan.transforms import point_jacobian, transform_points

POSE = 6
"""The first unknowns are the pose anew."""


@dataclass(frozen=True, eq=False)
class BesideAPose:
    """What K unknowns explain of the residuals of N pairs, and what these leave then."""

    unknowns: FloatArray
    """(K,), in the units of what they do."""
    chi_square: float
    """Of what is left, with the unknowns in their own standard deviations."""
    rigid_chi_square: float
    """The same without any of the unknowns."""
    freedom: int
    """3 N - 6 - K."""
    rows: FloatArray
    """Equations (3 N + K, 6 + K), each of unit variance."""

    @property
    def probability(self) -> float:
        """Chance that errors as stated leave as much, or more."""
        from scipy.special import gammaincc

        return float(gammaincc(self.freedom / 2, self.chi_square / 2))

    @property
    def variances(self) -> FloatArray:
        """Of the unknowns (K,), by errors as stated."""
        return np.diag(np.linalg.inv(self.rows.T @ self.rows))[POSE:]


def fitted_beside(
    residual_mm: FloatArray, covariances_mm2: FloatArray, motion: FloatArray, moves: FloatArray, sds: ArrayLike
) -> BesideAPose:
    """Return what unknowns explain of residuals (N, 3), mm, of the covariances (N, 3, 3), all in one frame.

    ``motion`` (N, 3, 6) is what a movement of all does to each, ``moves`` (N, 3, K) what the unknowns do, of which
    ``sds`` (K,), or one for all, are the standard deviations before anything is known of them: they hold what the
    points do not tell.
    """
    count = moves.shape[2]
    whitening = np.linalg.inv(np.linalg.cholesky(covariances_mm2))
    of_points = (whitening @ np.concatenate([motion, moves], axis=2)).reshape(-1, POSE + count)
    rows = np.vstack([of_points, np.eye(POSE + count)[POSE:] / np.reshape(sds, (-1, 1))])
    target = np.append((whitening @ residual_mm[..., None]).ravel(), np.zeros(count))
    solution = np.linalg.lstsq(rows, target)[0]
    left = float(((target - rows @ solution) ** 2).sum())
    return BesideAPose(solution[POSE:], left, float((target**2).sum()), residual_mm.size - POSE - count, rows)


def moved_together(matrix: FloatArray, points_mm: FloatArray) -> FloatArray:
    """Return what a movement about their middle does to points (N, 3) that ``matrix`` (4, 4) maps: (N, 3, 6)."""
    mapped = transform_points(matrix, points_mm)
    return point_jacobian(mapped - mapped.mean(axis=0))
