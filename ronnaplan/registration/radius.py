"""How far off a place stays with a stated chance, of an error with its own size along each axis."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ronnaplan.errors import InputError
from ronnaplan.geometry import FloatArray, as_numbers, require_covariances

CHANCE = 0.95
"""That an error stays within the radius."""
LEAST_SIGMAS, MOST_SIGMAS = 1.95, 2.80
"""The radius in the largest standard deviation: 1.960 of an error along one axis only, 2.795 of one alike along all."""

NODES = 48
"""Of Gauss's rule over each of the two angles of an octant; leaves less than 1e-12 of the radius."""


def radius_95_mm(covariances_mm2: ArrayLike) -> FloatArray:
    """Return the radius (...) of the ball that holds a normal error of zero mean with a chance of 95 %.

    ``covariances_mm2`` (..., 3, 3) are such as `predict_tre` and ``Registration.tre`` return. The axes of the error may
    differ: in a direction of whitened space the error grows in proportion to a chi variable of three degrees of
    freedom, and the chance is the mean over all directions. (2.795 sigma where the axes are alike; the RMS error
    is 1.732 sigma there.) Raises `InputError` for what is no covariance.
    """
    from scipy.optimize import elementwise

    variances = _variances_mm2(covariances_mm2)
    largest = np.sqrt(variances[..., -1])
    shares = variances / np.where(largest > 0.0, largest, 1.0)[..., np.newaxis] ** 2
    squared, weights = _octant()

    def excess(sigmas: FloatArray, *axes: FloatArray) -> FloatArray:
        return _chance(sigmas, np.stack(axes, axis=-1), squared, weights) - CHANCE

    found = elementwise.find_root(
        excess,
        (np.full(largest.shape, LEAST_SIGMAS), np.full(largest.shape, MOST_SIGMAS)),
        args=tuple(np.moveaxis(shares, -1, 0)),
    )
    radii: FloatArray = np.where(largest > 0.0, found.x * largest, 0.0)
    return radii


def _variances_mm2(covariances_mm2: ArrayLike) -> FloatArray:
    """Return the variances (..., 3) along each covariance's own axes, in ascending order."""
    given = as_numbers(covariances_mm2, "the covariances", "(..., 3, 3) in mm^2")
    if given.shape[-2:] != (3, 3):
        raise InputError(f"the covariances have shape {given.shape}; expected (..., 3, 3) in mm^2")
    require_covariances(given, "the covariances")
    return np.asarray(np.maximum(np.linalg.eigvalsh(given), 0.0), dtype=np.float64)


def _octant() -> tuple[FloatArray, FloatArray]:
    """Return squared unit vectors (M, 3) over an octant of the sphere, its pole the last axis, and weights (M,)."""
    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    height, turn = (nodes + 1.0) / 2.0, (nodes + 1.0) * np.pi / 4.0
    across = np.sqrt(1.0 - height**2)[:, np.newaxis]
    vectors = np.broadcast_arrays(across * np.cos(turn), across * np.sin(turn), height[:, np.newaxis])
    return np.stack(vectors, axis=-1).reshape(-1, 3) ** 2, np.outer(weights, weights).ravel() / 4.0


def _chance(sigmas: FloatArray, shares: FloatArray, squared: FloatArray, weights: FloatArray) -> FloatArray:
    from scipy.special import gammainc

    growth = np.maximum(shares @ squared.T, 1e-300)
    chance: FloatArray = gammainc(1.5, sigmas[..., np.newaxis] ** 2 / 2.0 / growth) @ weights
    return chance
