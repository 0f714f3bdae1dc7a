"""Which errors are far off: by how they scatter, in each direction as it is there."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ronnaplan.geometry import FloatArray
from ronnaplan.robot.by_pose_likelihood import of_volume_one

SLIP_SDS = 6.0
"""What is longer than this many robust standard deviations (per axis) is far off."""
MOST_WRONG = 1 / 3
"""Of more that are far off it is open whether they are wrong or the others, as where something was moved."""
MAXWELL_MEDIAN = 1.5382
"""Median length of a 3D normal vector of unit standard deviation per axis."""
FEWEST_FOR_DIRECTIONS = 24
"""Of fewer errors their shape is told so badly that it alone would name right ones: lengths in all axes count, too."""
TYLER_ROUNDS = 20
"""So many tell in which directions errors are larger."""


def robust_sd(lengths: FloatArray, least: float) -> float:
    """Return the robust standard deviation per axis of errors of such ``lengths`` (N,), ``least`` or more."""
    return max(float(np.median(lengths)) / MAXWELL_MEDIAN, least)


def too_long(errors: Sequence[FloatArray], least: float, usual: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which of the same ``errors``, each (N, 3) in axes of its own, are longer than those ``usual`` (N,) are."""
    length = np.linalg.norm(errors[0], axis=1)
    return np.asarray(length > SLIP_SDS * robust_sd(length[usual], least))


def too_long_for_direction(
    errors: Sequence[FloatArray], least: float, usual: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Return which of ``errors``, each (N, 3) in axes of its own, are longer than those ``usual`` (N,) in a direction.

    Where one axis errs most, as a tracker's depth, six deviations of all together are less than three of that one, and
    far more than six of the others. What of the usual is not too long tells the shape, in those axes in which it is
    likelier.
    """
    long = too_long(errors, least, usual)
    told = usual & ~long
    shaped = sorted((_alike(one, told) for one in errors), key=lambda one: _spread(one[told]))
    far = [too_long((one,), least, usual) for one in shaped]
    return far[0] if usual.sum() >= FEWEST_FOR_DIRECTIONS else np.asarray(np.all([long, *far], axis=0))


def _alike(errors: FloatArray, counted: NDArray[np.bool_]) -> FloatArray:
    """Return ``errors`` (N, 3) in axes, and units, in which those ``counted`` (N,) are alike in all directions.

    Their volume stays. That is told by their directions alone (Tyler 1987, Ann. Stat. 15:234), however far they go.
    """
    shape, told = np.eye(3), errors[counted]
    for _ in range(TYLER_ROUNDS if told.any() else 0):  # what is exact has no direction
        squares = np.einsum("ni,ij,nj->n", told, np.linalg.inv(shape), told)
        directions = told / np.sqrt(np.maximum(squares, np.finfo(float).tiny))[:, None]
        shape = of_volume_one(directions.T @ directions)
    return np.asarray(np.linalg.solve(np.linalg.cholesky(shape), errors.T).T)


def _spread(errors: FloatArray) -> float:
    """Return the mean logarithm of their lengths: the less, of one volume, the likelier is the shape."""
    squares = (errors**2).sum(axis=1)
    return float(np.log(np.maximum(squares, np.finfo(float).tiny)).mean())
