"""Which movement explains displaced markers: all of them as one body, or some of them by themselves.

An explanation says of the body whether it rests or moved, and of each marker whether it stayed with the body or came
loose. Explanations are compared by their evidence: the likelihood of the readings, averaged over the movements that
the explanation allows (Laplace's approximation; MacKay 2003, Information Theory, ch. 28). How far something moved is
unknown beforehand, so every direction and every power of ten is taken as equally likely.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ronnaplan.geometry import FloatArray
from ronnaplan.rigid import fit_likelihood, pose_covariance, spans_a_plane
from ronnaplan.transforms import transform_points

MOVES_PRIOR = 1e-3
"""Chance, before the readings, that the body moved, and likewise each marker by itself: one event explains more readily
than two."""
DECADES = 4.0
"""Movements range over so many powers of ten (0.1 mm to 1 m)."""
HEAD_RADIUS_MM = 80.0
"""A turn counts by how far it moves the surface of a ball of this radius."""


@dataclass(frozen=True, eq=False)
class Explanation:
    """Who moved, as far as the readings tell."""

    together: float
    """Probability that all markers moved with the body and none by itself."""
    loose: FloatArray
    """Probability of each marker (N,) that it moved by itself, given that some did."""


def explain_movement(
    before_mm: FloatArray, after_mm: FloatArray, before_mm2: FloatArray, after_mm2: FloatArray
) -> Explanation:
    """Weigh the explanations of markers (N, 3), with covariances (N, 3, 3), of which something is known to have moved.

    With the body at rest every set of loose markers is weighed; with the body moved, none or one loose marker.
    """
    stays, leaves = np.log1p(-MOVES_PRIOR), np.log(MOVES_PRIOR)
    noise = before_mm2 + after_mm2
    rested = stays + _log_rest(after_mm - before_mm, noise)
    left = leaves + _log_alone(after_mm - before_mm, noise)
    either = np.logaddexp(rested, left)
    one_or_more = -np.expm1(np.minimum((rested - either).sum(), -1e-12))
    weights = [stays + either.sum() + np.log(one_or_more)]
    shares = [np.exp(left - either) / one_or_more]
    for i, keep in enumerate(~np.eye(len(before_mm), dtype=bool)):
        if len(before_mm) == 3 or not spans_a_plane(before_mm[keep]):
            continue
        matrix, body = _log_body(before_mm[keep], after_mm[keep], before_mm2[keep], after_mm2[keep])
        off = after_mm[i : i + 1] - transform_points(matrix, before_mm[i : i + 1])
        weights.append(2 * leaves + (len(before_mm) - 1) * stays + body + _log_alone(off, noise[i : i + 1])[0])
        shares.append(~keep)
    apart = np.logaddexp.reduce(weights)
    together = leaves + len(before_mm) * stays + _log_body(before_mm, after_mm, before_mm2, after_mm2)[1]
    return Explanation(
        float(np.exp(together - np.logaddexp(together, apart))),
        np.exp(np.array(weights) - apart) @ np.array(shares),
    )


def _log_rest(vectors_mm: FloatArray, covariances_mm2: FloatArray) -> FloatArray:
    """Return the log density (N,) of vectors (N, 3) that only noise displaced."""
    whitened = np.linalg.solve(covariances_mm2, vectors_mm[..., None])[..., 0]
    log_volume = np.linalg.slogdet(2 * np.pi * covariances_mm2)[1]
    density: FloatArray = -0.5 * ((vectors_mm * whitened).sum(axis=-1) + log_volume)
    return density


def _log_alone(vectors_mm: FloatArray, covariances_mm2: FloatArray) -> FloatArray:
    """Return the log density (N,) of vectors (N, 3) of markers that moved by themselves: any length, any direction."""
    square = (vectors_mm**2).sum(axis=-1) + np.trace(covariances_mm2, axis1=-2, axis2=-1)
    sphere = 4 * np.pi * DECADES * np.log(10)
    density: FloatArray = -np.log(sphere) - 1.5 * np.log(square)
    return density


def _log_body(
    before_mm: FloatArray, after_mm: FloatArray, before_mm2: FloatArray, after_mm2: FloatArray
) -> tuple[FloatArray, float]:
    """Return the motion (4, 4) of the markers as one body, and the log density of their readings if it moved."""
    from scipy.spatial.transform import Rotation

    matrix, _ = fit_likelihood(before_mm, after_mm, before_mm2, after_mm2)
    noise = matrix[:3, :3] @ before_mm2 @ matrix[:3, :3].T + after_mm2
    mapped = transform_points(matrix, before_mm)
    center = mapped.mean(axis=0)
    shift = center - before_mm.mean(axis=0)
    turn = HEAD_RADIUS_MM * np.sqrt(2 / 3) * Rotation.from_matrix(matrix[:3, :3]).as_rotvec()
    square = shift @ shift + turn @ turn + np.trace(noise, axis1=-2, axis2=-1).mean()
    sphere = np.pi**3 * DECADES * np.log(10)  # that of six dimensions
    prior = -np.log(sphere) - 3 * np.log(square) + 3 * np.log(HEAD_RADIUS_MM * np.sqrt(2 / 3))
    spread = np.linalg.slogdet(2 * np.pi * pose_covariance(mapped - center, noise))[1]
    return matrix, float(_log_rest(after_mm - mapped, noise).sum() + prior + spread / 2)
