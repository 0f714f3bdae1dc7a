"""The localization errors a caller states, brought to one shape and checked."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ronnaplan.errors import InputError
from ronnaplan.geometry import FloatArray

SYMMETRY_TOLERANCE = 1e-6
"""Largest asymmetry of a covariance, relative to its largest entry."""

Covariances = ArrayLike | tuple[ArrayLike | None, ArrayLike | None] | None
"""Errors of paired points: None (equal, isotropic, unknown), those of the fixed points with the moving ones
exact, or a tuple (moving, fixed). Each is in mm^2 and its own frame: (N, 3, 3), or (3, 3) for all points."""


def as_pair(covariances: Covariances, count: int) -> tuple[FloatArray, FloatArray] | None:
    """Return the covariances of (moving, fixed), each (count, 3, 3), or None when none were stated.

    Each side may be zero (an exact point) but each point's sum must be positive definite; else `InputError`.
    """
    if covariances is None:
        return None
    sides = covariances if isinstance(covariances, tuple) else (None, covariances)
    if len(sides) != 2:
        raise InputError(f"covariances came as a tuple of {len(sides)}; expected (moving, fixed)")
    moving, fixed = (_one_side(side, count, name) for side, name in zip(sides, ("moving", "fixed"), strict=True))
    smallest = np.linalg.eigvalsh(moving)[:, 0] + np.linalg.eigvalsh(fixed)[:, 0]
    largest = np.trace(moving, axis1=-2, axis2=-1) + np.trace(fixed, axis1=-2, axis2=-1)
    bad = np.flatnonzero(~(smallest > 1e-12 * largest))
    if bad.size:
        raise InputError(
            f"the covariances of pair {bad[0]} are not positive definite "
            f"(smallest eigenvalue {smallest[bad[0]]:.3g} mm^2); state an error above zero in every direction"
        )
    return moving, fixed


def _one_side(values: ArrayLike | None, count: int, name: str) -> FloatArray:
    if values is None:
        return np.zeros((count, 3, 3))
    try:
        given = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name} covariances are not numbers; expected ({count}, 3, 3) in mm^2") from error
    if given.shape not in ((3, 3), (count, 3, 3)):
        raise InputError(
            f"{name} covariances have shape {given.shape}; expected (3, 3) or ({count}, 3, 3) in mm^2"
        )
    full = np.broadcast_to(given, (count, 3, 3))
    if not np.isfinite(full).all():
        raise InputError(f"{name} covariances have entries that are not finite; expected mm^2")
    scale = np.abs(full).max(axis=(-2, -1))
    skew = np.abs(full - full.swapaxes(-1, -2)).max(axis=(-2, -1))
    negative = np.linalg.eigvalsh(full)[:, 0] < -SYMMETRY_TOLERANCE * scale
    bad = np.flatnonzero((skew > SYMMETRY_TOLERANCE * scale) | negative)
    if bad.size:
        raise InputError(
            f"the covariance of {name} point {bad[0]} is not symmetric and positive: {full[bad[0]].tolist()}"
        )
    return full
