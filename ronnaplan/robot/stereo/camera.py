"""Calibrated cameras: OpenCV's pinhole and distortion model, with pixel centers at whole numbers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ronnaplan.errors import InputError
from ronnaplan.geometry import FloatArray, Frame
from ronnaplan.pose import Pose, as_pose
from ronnaplan.sigmas import SIGMA_SQUARE

RIG = Frame("RIG")
"""The stereo pair's own frame: that of its left camera (x right, y down, z forward), mm."""
SMALLEST_FOCAL_PX = 1.0
"""With a shorter focal length all that there is would be in one pixel."""
UNDISTORTION_STEPS = 100
UNDISTORTED = 1e-10
"""Undistortion stops when no point moves by more on the plane at unit distance."""


@dataclass(frozen=True, eq=False)
class Camera:
    """One camera: ``matrix`` (3, 3) in pixels, ``distortion`` (k1, k2, p1, p2, k3) and its place in the rig."""

    matrix: FloatArray
    distortion: FloatArray
    rig_from_camera: FloatArray
    """(4, 4), mm."""
    size_px: tuple[int, int] | None = None
    """Columns and rows of the images that it was calibrated on; others are cropped or scaled, and not of it."""

    def __post_init__(self) -> None:
        if self.matrix.shape != (3, 3) or not np.isfinite(self.matrix).all() or self._too_short:
            raise InputError(
                f"a camera matrix is {self.matrix.tolist()}; expected 3 x 3 with positive focal lengths, of "
                f"{SMALLEST_FOCAL_PX:g} pixel or more"
            )
        as_pose(self.rig_from_camera, "rig_from_camera")

    @property
    def focal_px(self) -> float:
        """Mean focal length in pixels."""
        return float((self.matrix[0, 0] + self.matrix[1, 1]) / 2)

    @property
    def _too_short(self) -> bool:
        return bool(np.diag(self.matrix)[:2].min() < SMALLEST_FOCAL_PX)

    @property
    def center_mm(self) -> FloatArray:
        """The camera's projection center (3,) in the rig."""
        return self.rig_from_camera[:3, 3]

    def require_size(self, shape: tuple[int, ...]) -> None:
        """Raise `InputError` for an image of another ``shape`` (rows, columns) than those of the calibration."""
        if self.size_px is not None and shape[::-1] != self.size_px:
            told, own = ("x".join(map(str, size)) for size in (shape[::-1], self.size_px))
            raise InputError(
                f"an image of {told} pixels is not of this camera, which was calibrated on {own}; do not crop or scale"
            )

    def pixels(self, rays: ArrayLike) -> FloatArray:
        """Return the pixels (N, 2) that look along ``rays`` (N, 3), of any length, in the camera's own frame."""
        import cv2

        shown = cv2.projectPoints(
            np.asarray(rays, dtype=np.float64), np.zeros(3), np.zeros(3), self.matrix, self.distortion
        )[0]
        return np.asarray(shown[:, 0], dtype=np.float64)

    def rays(self, pixels: ArrayLike) -> FloatArray:
        """Return the unit directions (N, 3), in the camera's own frame, that ``pixels`` (N, 2) look along."""
        points = np.asarray(pixels, dtype=np.float64).reshape(-1, 2)
        plane = (points - self.matrix[:2, 2]) / np.diag(self.matrix)[:2]
        for _ in range(UNDISTORTION_STEPS):
            rays = np.column_stack([plane, np.ones(len(plane))])
            step = (points - self.pixels(rays)) / np.diag(self.matrix)[:2]
            plane = plane + step
            if np.abs(step).max(initial=0.0) < UNDISTORTED:
                break
        else:
            raise InputError(
                "a pixel has no ray: the distortion is not invertible there; calibrate the camera again"
            )
        rays = np.column_stack([plane, np.ones(len(plane))])
        directions: FloatArray = rays / np.linalg.norm(rays, axis=1, keepdims=True)
        return directions


@dataclass(frozen=True, eq=False)
class Boards:
    """The chessboards that cameras were calibrated on, from which follows how well the cameras are known where."""

    corners: tuple[int, int]
    """Columns and rows of inner corners."""
    square_mm: float
    rig_from_board: FloatArray
    """(N, 4, 4): where each board was, its first corner at its origin, x along its rows."""
    error_px: float
    """Standard deviation per axis of a corner's place in an image."""
    lens_px: float
    """By so much (RMS per axis) the lenses may bend otherwise than the cameras' model has it."""
    sigma_square: float = SIGMA_SQUARE
    """Standard error of the squares' side, as a part of it."""

    def __post_init__(self) -> None:
        for place in self.rig_from_board:
            as_pose(place, "rig_from_board")


@dataclass(frozen=True)
class StereoRig:
    """Two cameras on the robot's flange and where its TCP is in their frame."""

    left: Camera
    right: Camera
    tcp_from_rig: Pose
    boards: Boards | None = None
    """None where it is not told: then the cameras are taken for true."""

    def __post_init__(self) -> None:
        if self.boards is None:
            return
        for camera in (self.left, self.right):
            if camera.size_px is None:
                raise InputError(
                    "cameras were calibrated on boards, but have no size; expected that of their images"
                )
            away = (self.boards.rig_from_board[:, :3, 3] - camera.center_mm) @ camera.rig_from_camera[:3, 2]
            if away.min() <= 0:
                raise InputError(
                    "cameras were calibrated on a board behind them; expected all before both cameras"
                )
