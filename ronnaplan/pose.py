"""Rigid poses between named frames, each with the covariance of its six degrees of freedom.

Convention throughout: a pose ``a_from_b`` maps coordinates of frame B into frame A. Its true value is
``exp(xi) @ matrix`` with ``xi = (rotation vector in rad, translation in mm)`` written in the axes of A about A's
origin, and ``xi`` is normal with mean zero and covariance ``covariance`` (Barfoot & Furgale 2014, IEEE Trans.
Robot. 30:679, there with translation first). First order in ``xi``: good while rotations are known to a few
degrees.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ronnaplan.errors import InputError, check_type
from ronnaplan.geometry import (
    FloatArray,
    Frame,
    as_covariances,
    as_numbers,
    as_points,
    require_covariances,
    rms_mm,
)
from ronnaplan.text import place
from ronnaplan.transforms import (
    carried,
    invert,
    nearest_rotations,
    orthonormality_excess,
    point_jacobian,
    rigid,
    transform_points,
)

POSE_TOLERANCE = 1e-4
"""Largest entry of ``R @ R.T - 1`` accepted in a pose that is offered (trackers print rotations with 4 to 6
digits); within it the nearest rotation is taken."""
FARTHEST_MM = 1e9
"""A pose with larger entries (1000 km) is damaged, like one with entries that are not finite."""
NEAREST_MM = 10.0
"""No tracker sees a tool so near to its origin, nor has a robot its TCP there: such poses are in metres."""


@dataclass(frozen=True, eq=False)
class Pose:
    """``to_frame`` from ``from_frame``: ``matrix`` (4, 4) in mm and ``covariance`` (6, 6) in rad and mm.

    Holds copies. Raises `InputError` for what `as_pose` refuses, and for a covariance that is none.
    """

    matrix: FloatArray
    covariance: FloatArray
    to_frame: Frame
    from_frame: Frame

    def __post_init__(self) -> None:
        for frame in (self.to_frame, self.from_frame):
            check_type(frame, Frame, "a pose's frame", "give Frame(...), such as Frame('R')")
        name = f"pose {self.to_frame} from {self.from_frame}"
        matrix = as_numbers(self.matrix, f"the entries of {name}", "a 4 x 4 rigid transform in mm").copy()
        if matrix.shape != (4, 4) or not _are_poses(matrix[np.newaxis])[0]:
            as_pose(matrix, name)
        covariance = as_numbers(self.covariance, f"the covariance of {name}", "(6, 6) in rad and mm").copy()
        if covariance.shape != (6, 6):
            raise InputError(
                f"the covariance of {name} has shape {covariance.shape}; expected (6, 6) in rad and mm"
            )
        require_covariances(covariance, f"the covariance of {name}")
        object.__setattr__(self, "matrix", matrix)
        object.__setattr__(self, "covariance", covariance)

    @classmethod
    def exact(cls, matrix: ArrayLike, to_frame: Frame, from_frame: Frame) -> Pose:
        """Return a pose (4, 4) that is taken as known without error, such as a robot's own nominal kinematics."""
        return cls(as_pose(matrix, f"pose {to_frame} from {from_frame}"), np.zeros((6, 6)), to_frame, from_frame)

    @property
    def rotation(self) -> FloatArray:
        """The rotation (3, 3)."""
        return self.matrix[:3, :3]

    @property
    def translation_mm(self) -> FloatArray:
        """The translation (3,): where ``from_frame``'s origin lies in ``to_frame``."""
        return self.matrix[:3, 3]

    @property
    def turn_deg(self) -> float:
        """By how many degrees it turns."""
        from scipy.spatial.transform import Rotation

        return float(np.degrees(Rotation.from_matrix(self.rotation).magnitude()))

    def __repr__(self) -> str:
        error_mm = rms_mm(self.point_covariances(np.zeros((1, 3))))[0]
        told = f"turned by {self.turn_deg:.1f} degrees, moved by {place(self.translation_mm)} mm"
        return f"Pose({self.to_frame} from {self.from_frame}: {told}, error at that place {error_mm:.3g} mm RMS)"

    def __matmul__(self, other: Pose) -> Pose:
        """Return ``a_from_b @ b_from_c = a_from_c``; their errors are independent. Raises `FrameMismatchError`."""
        check_type(other, Pose, "what a pose is multiplied by", "map points by apply; make a matrix a Pose.exact")
        self.from_frame.require(other.to_frame)
        covariance = self.covariance + carried(self.matrix, other.covariance)
        return Pose(self.matrix @ other.matrix, covariance, self.to_frame, other.from_frame)

    def inverse(self) -> Pose:
        """Return ``from_frame`` from ``to_frame``."""
        matrix = invert(self.matrix)
        return Pose(matrix, carried(matrix, self.covariance), self.from_frame, self.to_frame)

    def apply(self, points_mm: ArrayLike, frame: Frame | None = None) -> FloatArray:
        """Return ``points_mm`` (N, 3) of ``from_frame`` in ``to_frame``.

        ``frame`` is the frame the points say they are in; another than ``from_frame`` raises `FrameMismatchError`.
        """
        if frame is not None:
            self.from_frame.require(frame)
        return transform_points(self.matrix, as_points(points_mm))

    def point_covariances(self, points_mm: ArrayLike, covariances_mm2: ArrayLike | None = None) -> FloatArray:
        """Return the covariance (N, 3, 3), in ``to_frame``, of ``points_mm`` (N, 3) mapped by this pose.

        ``covariances_mm2`` (N, 3, 3), or (3, 3) for all, in ``from_frame``, is the points' own error; without it they
        are exact.
        """
        mapped_mm = self.apply(points_mm)
        jacobian = point_jacobian(mapped_mm)
        mapped = jacobian @ self.covariance @ jacobian.swapaxes(-1, -2)
        if covariances_mm2 is not None:
            own = as_covariances(covariances_mm2, len(mapped_mm), "covariances of points")
            mapped = mapped + self.rotation @ own @ self.rotation.T
        return mapped


def as_pose(matrix: ArrayLike, name: str = "pose", *, tolerance: float = POSE_TOLERANCE) -> FloatArray:
    """Return ``matrix`` as a proper rigid (4, 4) transform, its rotation made exactly orthonormal.

    ``tolerance`` is the largest `orthonormality_excess`; within it the nearest rotation is taken.

    Raises `InputError` for another shape, non-finite entries, a left-handed matrix, a scaled or sheared one, or a
    bottom row other than (0, 0, 0, 1).
    """
    pose = as_numbers(matrix, f"the entries of {name}", "a 4 x 4 rigid transform in mm").copy()
    if pose.shape != (4, 4):
        raise InputError(f"{name} has shape {pose.shape}; expected a 4 x 4 rigid transform")
    if not (np.abs(pose) < FARTHEST_MM).all():
        raise InputError(f"{name} has entries that are not finite; leave out poses the tracker marks as missing")
    if np.abs(pose[3] - (0, 0, 0, 1)).max() > POSE_TOLERANCE:
        raise InputError(f"{name} has the bottom row {pose[3].tolist()}; expected 0 0 0 1 (is it transposed?)")
    rotation = pose[:3, :3]
    if np.linalg.det(rotation) < 0:
        raise InputError(f"{name} is left-handed (a mirror image); expected a right-handed rotation")
    excess = orthonormality_excess(rotation)
    if excess > tolerance:
        raise InputError(
            f"{name} is not rigid: its axes miss orthonormality by {excess:.2g}; expected a pure rotation"
        )
    pose[:3, :3] = nearest_rotations(rotation)
    pose[3] = (0, 0, 0, 1)
    return pose


def as_poses(matrices: ArrayLike, name: str) -> FloatArray:
    """Return ``matrices`` (N, 4, 4), each as `as_pose` makes it; its `InputError` names the first that is none."""
    poses = as_stack(matrices, name)
    require_poses(poses, name)
    require_millimetres_away(poses, f"{name} lies")
    return rigid(nearest_rotations(poses[:, :3, :3]), poses[:, :3, 3])


def require_poses(stack: FloatArray, name: str) -> None:
    """Raise `InputError`, as `as_pose` does, that names the first of a ``stack`` (N, ., .) which is no pose."""
    sound = _are_poses(stack) if stack.shape[1:] == (4, 4) else np.zeros(len(stack), dtype=bool)
    for wrong in np.flatnonzero(~sound):
        as_pose(stack[wrong], f"{name} {wrong}")


def require_millimetres_away(matrices: FloatArray, told: str) -> None:
    """Raise `InputError`, beginning with ``told``, where all of ``matrices`` (N, 4, 4) look as if in metres."""
    farthest_mm = float(np.linalg.norm(matrices[:, :3, 3], axis=1).max(initial=0.0))
    if len(matrices) and farthest_mm < NEAREST_MM:
        raise InputError(
            f"{told} within {farthest_mm:.2g} mm of the origin in every pose, as if it were in metres; expected mm"
        )


def as_stack(matrices: ArrayLike, name: str) -> FloatArray:
    """Return ``matrices`` (N, ., .) as numbers, be they poses or not; `InputError` for what is no stack."""
    stack = as_numbers(matrices, name, "(N, 4, 4)")
    if stack.ndim != 3:
        raise InputError(f"{name} have shape {stack.shape}; expected (N, 4, 4)")
    return stack


def first_told(matrices: FloatArray) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return which of ``matrices`` (N, 4, 4) repeat no earlier one (K,), in order, and which of those each is (N,).

    A tracker errs a little otherwise each time: what is the same to the last digit was sent again, as programs do while
    a tool is hidden, and tells nothing new.
    """
    _, first, each = np.unique(matrices, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)
    return first[order], np.argsort(order)[each.ravel()]


def _are_poses(matrices: FloatArray) -> NDArray[np.bool_]:
    """Return which of ``matrices`` (N, 4, 4) `as_pose` takes."""
    near: NDArray[np.bool_] = np.asarray((np.abs(matrices) < FARTHEST_MM).all(axis=(1, 2)))
    rotation = np.where(near[:, None, None], matrices[:, :3, :3], np.eye(3))
    upright = np.abs(matrices[:, 3] - (0, 0, 0, 1)).max(axis=1) <= POSE_TOLERANCE
    excess = np.abs(rotation @ rotation.swapaxes(-1, -2) - np.eye(3)).max(axis=(1, 2))
    sound = near & upright & (np.linalg.det(rotation) >= 0) & (excess <= POSE_TOLERANCE)
    return np.asarray(sound)
