"""The least squares of a hand-eye calibration, before anything is said of how sure they are."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ronnaplan.geometry import FloatArray
from ronnaplan.robot.hand_eye_start import FINEST, discrepancies
from ronnaplan.robot.memory import least_squares
from ronnaplan.robot.twists import motion
from ronnaplan.transforms import adjoint, cross_matrix, invert

STARTING_SDS = (1e-3, 1.0)
"""Errors of rotation, in rad, and translation, in mm, that the first step is weighed by."""
LEAST_FREEDOM, LOPSIDED = 1e-3, 1e-2
"""Round-off can leave less freedom; rotations err by that share of what places do over a meter, and these of them."""
ITERATIONS = 6
"""Each weighs rotations and translations by the scatter that the one before it left."""
CONSTANTS = 12
"""So many unknowns, the first ones, are increments of the two poses."""
IN_TRACKER, IN_TOOL = slice(12, 21), slice(21, 27)
"""Which unknowns are drifts in the tracker's axes and in the tool's."""


class Fit(NamedTuple):
    """The least squares of N moments."""

    left: FloatArray
    """R from OTS (4, 4), mm."""
    right: FloatArray
    """M from TCP (4, 4), mm."""
    sds: FloatArray
    """(6,): what rotations (rad) and places (mm) err by."""
    design: FloatArray
    """(N, 6, 27), as `design_of` returns it."""
    residual: FloatArray
    """(N, 6): what is left, in ``sds``."""
    step: FloatArray
    """The last one (27,), of which the drifts are."""
    error: FloatArray
    """(N, 6): what is left, rad and mm, at M's origin."""


def refine(seen: FloatArray, driven: FloatArray, left: FloatArray, right: FloatArray) -> Fit:
    """Return the least squares, by Gauss and Newton, from R from OTS ``left`` and M from TCP ``right`` (4, 4).

    Of N moments, ``seen`` (N, 4, 4) is OTS from M, ``driven`` (N, 4, 4) R from TCP, mm.
    """
    sds = np.repeat(STARTING_SDS, 3)
    for _ in range(ITERATIONS):
        error = discrepancies(seen, driven, left, right)
        design = design_of(seen, right, sds)
        step, freedom = least_squares(design, -error / sds, CONSTANTS)
        residual = error / sds + design @ step
        left, right = left @ motion(step[:6]), right @ motion(step[6:CONSTANTS])
        error = residual * sds
        freedom = np.maximum(freedom.reshape(2, 3).sum(axis=1), LEAST_FREEDOM)
        spread = np.sqrt((error**2).sum(axis=0).reshape(2, 3).sum(axis=1) / freedom)
        sds = np.repeat(np.maximum.reduce([spread, FINEST, LOPSIDED * spread[::-1] * (1e-3, 1e3)]), 3)
    # noise is judged by what it leaves: what is missing of the least that poses are taken to err by has to be there
    missing = np.sqrt(1 - (np.repeat(spread, 3) / sds) ** 2)
    residual += missing * np.random.default_rng(0).normal(size=residual.shape)
    return Fit(left, right, sds, design, residual, step, error)


def design_of(seen: FloatArray, right: FloatArray, sds: FloatArray) -> FloatArray:
    """Return (N, 6, 27): how the discrepancies, in ``sds`` (6,), change with the unknowns.

    These are right-hand increments of R from OTS and of M from TCP, then drifts over half the recording: of M's pose as
    it is seen and of the tracker's own orientation (`IN_TRACKER`), and of M on the tool (`IN_TOOL`).
    """
    in_tool = turned(seen.swapaxes(1, 2))
    time = np.linspace(-1, 1, len(seen))[:, None, None]
    levers = np.zeros((len(seen), 6, 3))
    levers[:, 3:] = in_tool[:, :3, :3] @ cross_matrix(seen[:, :3, 3] - seen[:, :3, 3].mean(axis=0))
    levers *= sds[0] / sds[3]
    of_right = np.broadcast_to(adjoint(right), in_tool.shape)
    constants = -np.concatenate([adjoint(invert(seen)), of_right], axis=2) / sds[:, None]
    return np.concatenate([constants, time * in_tool, time * levers, time * np.eye(6)], axis=2)


def turned(poses: FloatArray) -> FloatArray:
    """Return (N, 6, 6) that turn rotations and translations by the rotations of ``poses`` (N, 4, 4)."""
    both = np.zeros((len(poses), 6, 6))
    both[:, :3, :3] = both[:, 3:, 3:] = poses[:, :3, :3]
    return both
