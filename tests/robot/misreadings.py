"""Poses as another program makes them of what a robot wrote, where it takes its numbers for others."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from ronnaplan.geometry import FloatArray

MISREAD = {
    "inverted": "each is inverted",
    "transposed": "the rotations are transposed",
    "scalar last": "the scalar is the quaternions' first number, not the last",
    "scalar first": "the scalar is the quaternions' last number, not the first",
    "A and C": "the angles about Z and X are exchanged",
    "fixed axes": "axes that turn along are taken for fixed ones",
}
"""How they are misread, and what is told of it."""


def misread(poses: FloatArray, how: str) -> FloatArray:
    """Return ``poses`` (N, 4, 4) as they are read."""
    if how == "inverted":
        return np.asarray(np.linalg.inv(poses), dtype=np.float64)
    turns = Rotation.from_matrix(poses[:, :3, :3])
    x, y, z, w = turns.as_quat().T
    wrong = {
        "transposed": turns.inv(),
        "scalar last": Rotation.from_quat(np.column_stack([w, x, y, z])),
        "scalar first": Rotation.from_quat(np.column_stack([y, z, w, x])),
        "A and C": Rotation.from_euler("ZYX", turns.as_euler("ZYX")[:, ::-1]),
        "fixed axes": Rotation.from_euler("xyz", turns.as_euler("XYZ")),
    }[how]
    read = poses.copy()
    read[:, :3, :3] = wrong.as_matrix()
    return read
