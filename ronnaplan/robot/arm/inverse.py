"""Inverse kinematics: every posture of an arm of one of three kinds (`wrist`), or one that nearly is."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ronnaplan.errors import InputError
from ronnaplan.geometry import FloatArray
from ronnaplan.pose import as_stack, require_poses
from ronnaplan.robot.arm.arm import SerialArm
from ronnaplan.robot.arm.forward import as_angles
from ronnaplan.robot.arm.wrist import wrist_of
from ronnaplan.transforms import invert

BRANCHES = 8


@dataclass(frozen=True, eq=False)
class Postures:
    """What brings the flange to M poses: ``angles_rad`` (M, 8, 6), NaN where there is no answer.

    ``within`` (M, 8) says which keep the joints' limits. Branch n is the same posture for all poses: bit 2 tells that
    the arm reaches back over its shoulder, bit 1 the elbow, bit 0 the flipped wrist. With a spherical shoulder bit 2
    tells on which side of the plane of axes 5 and 6 the shoulder is, and bit 0 that it is the shoulder that is flipped.
    The Jacobian's determinant changes its sign with every bit. Each angle is the turn of it that is nearest to the
    middle of its limits. Where axis 6 points along axis 4, of all ways to share their turn one is told: with a
    spherical wrist joint 4 at zero, with a parallel one joints 2, 3 and 4 at zero together; and joint 3 at zero where
    axis 3 of a spherical shoulder points along axis 1. Where the axes stand so but for errors there is no such way, and
    of postures there, or nearly there, some may be missing.
    """

    angles_rad: FloatArray
    within: NDArray[np.bool_]


def inverse(arm: SerialArm, poses: ArrayLike, tool: str | None = None) -> Postures:
    """Return all postures that bring ``tool``, or the flange, to ``poses`` (M, 4, 4), base from tool.

    All are of the arm as it is described, to `refined.REACHED` where its axes stand otherwise than a closed form needs.

    Raises `InputError` for an arm that has no closed form, and for ``poses`` of another shape or that are not rigid.
    """
    from ronnaplan.robot.arm.compiled import all_postures

    asked = np.ascontiguousarray(as_stack(poses, "the poses to reach"))
    require_poses(asked, "pose")
    if tool is not None:
        asked = np.ascontiguousarray(asked @ invert(arm.tool(tool)))
    angles, found = np.empty((len(asked), BRANCHES, 6)), np.empty(len(asked))
    all_postures(wrist_of(arm), asked, angles, found)
    bits = (found.astype(np.int64)[:, None] >> np.arange(BRANCHES)) & 1
    angles[bits == 0] = np.nan
    within = np.asarray(((angles >= arm.limits_rad[:, 0]) & (angles <= arm.limits_rad[:, 1])).all(axis=-1))
    return Postures(angles, within)


def turns(arm: SerialArm, angles_rad: ArrayLike) -> FloatArray:
    """Return (T, N) all that differs from ``angles_rad`` (N,) by whole turns of joints and keeps their limits.

    Raises `InputError` for other than one posture of finite angles.
    """
    angles = as_angles(arm, angles_rad)
    if angles.ndim != 1:
        raise InputError(
            f"joint angles of shape {angles.shape} were given; expected those of one posture, ({len(arm)},)"
        )
    each = []
    for angle, (least, greatest) in zip(angles, arm.limits_rad, strict=True):
        first, last = np.ceil((least - angle) / (2 * np.pi)), np.floor((greatest - angle) / (2 * np.pi))
        each.append([angle + 2 * np.pi * n for n in np.arange(first, last + 1)])
    return np.array(list(product(*each))).reshape(-1, len(arm))
