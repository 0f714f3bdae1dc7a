"""Motions as six numbers: a rotation vector in rad, then a translation in mm."""

from __future__ import annotations

import numpy as np

from ronnaplan.geometry import FloatArray
from ronnaplan.transforms import exponential, invert, rigid


def motion(twist: FloatArray) -> FloatArray:
    """Return the motion (4, 4) by a ``twist`` (6,)."""
    return rigid(exponential(twist[:3]), twist[3:])


def twist(motions: FloatArray) -> FloatArray:
    """Return the twists (..., 6) of ``motions`` (..., 4, 4)."""
    from scipy.spatial.transform import Rotation

    turns = Rotation.from_matrix(motions[..., :3, :3]).as_rotvec()
    return np.concatenate([turns, motions[..., :3, 3]], axis=-1)


def apart(poses: FloatArray, others: FloatArray) -> FloatArray:
    """Return the twists (..., 6) of ``others`` (..., 4, 4) as ``poses`` (..., 4, 4) see them."""
    return twist(invert(poses) @ others)
