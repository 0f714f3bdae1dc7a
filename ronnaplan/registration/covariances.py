"""The localization errors a caller states, brought to one shape and checked, and what a fit makes of them."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ronnaplan.errors import InputError
from ronnaplan.geometry import FloatArray, as_numbers, require_covariances
from ronnaplan.rigid import corrected_points, freedom, pose_covariance
from ronnaplan.transforms import transform_points

SMALLEST_VARIANCE_MM2 = 1e-18
"""Keeps a perfect (synthetic) fit's covariance invertible; a nanometre is no marker's error."""

Covariances = ArrayLike | tuple[ArrayLike | None, ArrayLike | None] | None
"""Errors of paired points: None (equal, isotropic, unknown), those of the fixed points with the moving ones
exact, or a tuple (moving, fixed). Each is in mm^2 and its own frame: (N, 3, 3), or (3, 3) for all points; of a
standard deviation ``s`` mm along every axis it is ``s**2 * numpy.eye(3)``."""


def as_pair(covariances: Covariances, shape: tuple[int, ...]) -> tuple[FloatArray, FloatArray] | None:
    """Return the covariances of (moving, fixed), each (*shape, 3, 3), or None when none were stated.

    ``shape`` is that of the pairs: (N,), or (B, N) of a batch. Each side may be zero (an exact point) but each point's
    sum must be positive definite; else `InputError`.
    """
    if covariances is None:
        return None
    sides = covariances if isinstance(covariances, tuple) else (None, covariances)
    if len(sides) != 2:
        raise InputError(f"covariances came as a tuple of {len(sides)}; expected (moving, fixed)")
    names = ("moving covariances", "fixed covariances") if sides is covariances else ("", "covariances")
    moving, fixed = (_one_side(side, shape, name) for side, name in zip(sides, names, strict=True))
    smallest = np.linalg.eigvalsh(moving)[..., 0] + np.linalg.eigvalsh(fixed)[..., 0]
    largest = np.trace(moving, axis1=-2, axis2=-1) + np.trace(fixed, axis1=-2, axis2=-1)
    bad = np.argwhere(~(smallest > 1e-12 * largest))
    if len(bad):
        row = int(bad[0, -1]) if bad.size else 0
        raise InputError(
            f"the covariances of pair {row} are not positive definite "
            f"(smallest eigenvalue {smallest[tuple(bad[0])]:.3g} mm^2); state an error above zero in every direction"
        )
    whole = (*shape, 3, 3)
    return np.broadcast_to(moving, whole), np.broadcast_to(fixed, whole)


def _one_side(values: ArrayLike | None, shape: tuple[int, ...], name: str) -> FloatArray:
    """Return the covariances of one side, of the shape that they came in."""
    if values is None:
        return np.zeros((3, 3))
    shapes = [(*shape[k:], 3, 3) for k in range(len(shape), -1, -1)]
    expected = " or ".join(map(str, shapes)) + " in mm^2"
    given = as_numbers(values, name, expected)
    if given.ndim == 0:
        raise InputError(
            f"{name} came as the number {given:g}; expected {expected}: "
            f"a standard deviation of {given:g} mm along every axis is {given:g}**2 * numpy.eye(3), "
            f"a variance of {given:g} mm^2 is {given:g} * numpy.eye(3)"
        )
    if given.shape not in shapes:
        raise InputError(f"{name} have shape {given.shape}; expected {expected}")
    require_covariances(given, name)
    return given.copy()  # the caller's buffer may be filled again


def estimated_variance(matrix: FloatArray, moving_mm: FloatArray, fixed_mm: FloatArray) -> float:
    """Return the unbiased per-axis variance of the errors of pairs (N, 3), mm^2, from 3 N - 6 degrees of freedom."""
    residual = fixed_mm - transform_points(matrix, moving_mm)
    return max(float((residual**2).sum()) / freedom(len(moving_mm)), SMALLEST_VARIANCE_MM2)


def combined_covariances(matrix: FloatArray, moving_mm2: FloatArray, fixed_mm2: FloatArray) -> FloatArray:
    """Return the covariance (..., N, 3, 3) of the residuals' errors: both sides', in the fixed frame."""
    rotation = matrix[..., None, :3, :3]
    combined: FloatArray = rotation @ moving_mm2 @ rotation.swapaxes(-1, -2) + fixed_mm2
    return combined


def fitted_pose_covariance(
    matrix: FloatArray,
    moving_mm: FloatArray,
    fixed_mm: FloatArray,
    combined_mm2: FloatArray,
    stated: tuple[FloatArray, FloatArray] | None,
) -> FloatArray:
    """Return the covariance (..., 6, 6) of fitted ``matrix`` (..., 4, 4); unstated errors are all of the fixed side."""
    if stated is None:
        return pose_covariance(transform_points(matrix, moving_mm), combined_mm2)
    corrected, remaining = corrected_points(matrix, moving_mm, fixed_mm, *stated)
    return pose_covariance(corrected, combined_mm2, remaining, remaining)
