"""A pose with its covariance as part of a document."""

from __future__ import annotations

from typing import Self

import numpy as np
from pydantic import model_validator

from ronnaplan.documents.fields import DocumentModel, Matrix4, PoseCovariance, told_by_reader
from ronnaplan.geometry import Frame
from ronnaplan.pose import Pose, as_pose

SAME_POSE_MM = 1e-6
"""Round-off of a pose that is written beside those that it is the product of (mm, and metres of a lever)."""


class PoseEntry(DocumentModel):
    """``matrix`` in mm; ``covariance`` in the convention of `ronnaplan.pose` (rotation in rad, then mm)."""

    matrix: Matrix4
    covariance: PoseCovariance

    @model_validator(mode="after")
    def _check(self) -> Self:
        with told_by_reader():
            as_pose(self.matrix, "matrix")
        return self

    def pose(self, to_frame: Frame, from_frame: Frame) -> Pose:
        """Return ``to_frame`` from ``from_frame``."""
        return Pose(as_pose(self.matrix, "matrix"), np.array(self.covariance), to_frame, from_frame)


def pose_entry(pose: Pose) -> dict[str, object]:
    """Return the content of the entry of ``pose``."""
    return {"matrix": pose.matrix.tolist(), "covariance": pose.covariance.tolist()}


def same_pose(one: Pose, other: Pose) -> bool:
    """Tell whether two poses, and their covariances, are the same but for the rounding of digits."""
    near = np.allclose(one.matrix, other.matrix, rtol=0.0, atol=SAME_POSE_MM)
    return near and np.allclose(one.covariance, other.covariance, rtol=1e-6, atol=1e-12)
