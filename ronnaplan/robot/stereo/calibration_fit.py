"""The fit of two cameras and a board's shape to the board's corners: its slopes, normal matrix and steps.

A board is the same in all images, but hardly a plane, and printed boards are stretched. So its shape is fitted with the
cameras, but for its scale, which is taken from the side of its squares.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ronnaplan.errors import InputError
from ronnaplan.geometry import FloatArray
from ronnaplan.robot.stereo.board import grid_mm, shapes
from ronnaplan.robot.stereo.camera import Camera
from ronnaplan.transforms import exponential, invert, point_jacobian, rigid

LENS_ORDER = 4
"""A lens may bend otherwise in cosines over its image of up to so many half periods along both axes together."""
ORDERS = np.array([(i, j) for i in range(LENS_ORDER + 1) for j in range(LENS_ORDER + 1 - i)])
FREE = 15
"""Numbers of a camera: focal lengths and middle (4), distortion (5), and the motion of its place in the rig (6)."""
FIELDS = 2 * len(ORDERS) + 1
"""Of one camera: waves of x and of y, then its prism."""
IS_PRISM = np.tile(np.arange(FIELDS) == FIELDS - 1, 2)
"""Of the fields of both cameras."""
CAMERAS = 2 * FREE
"""Numbers of the left camera, then of the right; what is fitted holds those of the board's shape after these."""
BOARD_STEPS = 6
STEPS, FITTED_PX = 30, 2e-5
"""A fit is done when its step would move corners by less (RMS); what still moves after so many steps is open."""
SMALLEST_INFORMATION = 2e-10
"""Smallest over largest eigenvalue of the scaled normal matrix, but for the rig's own motion, of boards that determine
the cameras: eight boards of the studies have 7e-9 and more, eight at one place 2e-11."""
UNDETERMINED = "the boards do not determine the cameras; tilt them to all sides, all over both images"


@dataclass(frozen=True, eq=False)
class Told:
    """What the boards' corners tell once each board is where it fits best: sums over all corners."""

    inverse: FloatArray
    """(P, P), of the normal matrix of what is fitted, where the boards as a whole are held."""
    followed: FloatArray
    """(P, 2 F): how that follows the fields by which lenses bend otherwise."""
    step: FloatArray
    """(P): by how much it fits better."""
    lens: FloatArray
    """(2 F, 2 F): normal matrix of the fields, once all else follows them."""
    lens_misfit: FloatArray
    """(2 F): the fields' slope with the corners' residuals, likewise."""
    misfit: float
    """Sum of the squared residuals, likewise."""
    moved_px: float
    """By how much the step moves corners (RMS per axis)."""
    free: int
    """Residuals, less what was fitted."""


@dataclass(frozen=True, eq=False)
class Fit:
    """Two cameras and a board, and where the board was in each pair of images."""

    cameras: tuple[Camera, Camera]
    corners: tuple[int, int]
    grid_mm: FloatArray
    """(K, 3): the board's corners in its own frame."""
    rig_from_board: FloatArray
    """(N, 4, 4)."""
    residuals_px: FloatArray
    """(N, 2, K, 2): what was seen, less what is modelled."""

    @property
    def rms_px(self) -> float:
        """RMS distance of the corners from their modelled places."""
        return float(np.sqrt((self.residuals_px**2).sum(axis=-1).mean()))

    @property
    def settled(self) -> bool:
        """Whether a further step would move nothing."""
        return self.told.moved_px < FITTED_PX

    @property
    def sums_by_board(self) -> FloatArray:
        """Each board's sums (N, P + 2 F + 1) both ways, of what is fitted, the fields and the residuals.

        They are of what is left once the board is where it fits best; the sum over all is what `told` solves.
        """
        return np.array([own for own, _ in self._of_boards])

    @cached_property
    def told(self) -> Told:
        """What the boards tell of both cameras and their own shape."""
        return _told_by(self)

    @cached_property
    def _of_boards(self) -> list[tuple[FloatArray, FloatArray]]:
        """What `_told_of_board` says of each."""
        return [_told_of_board(self, n) for n in range(len(self.rig_from_board))]


def fitted(
    cameras: tuple[Camera, Camera],
    seen: Sequence[tuple[FloatArray, FloatArray]],
    corners: tuple[int, int],
    square_mm: float,
) -> Fit:
    """Return cameras and a board's shape that fit its corners as ``seen`` (K, 1, 2) best, near flat and ``cameras``.

    Raises `InputError` where the boards leave them open; what has not settled after all steps may be, too.
    """
    grid = grid_mm(corners, square_mm)
    for step in range(STEPS):
        placed = [_placed(cameras, pair, grid) for pair in seen]
        places, residuals = (np.array(one) for one in zip(*placed, strict=True))
        fit = Fit(cameras, corners, grid, places, residuals)
        if fit.settled or step == STEPS - 1:
            break
        left, right = (_stepped(one, fit.told.step[FREE * k :][:FREE]) for k, one in enumerate(cameras))
        rig = invert(left.rig_from_camera)
        cameras = _carried(left, rig), _carried(right, rig)
        grid = grid + shapes(corners) @ fit.told.step[CAMERAS:]
    return fit


def _told_by(fit: Fit) -> Told:
    total = np.sum(fit.sums_by_board, axis=0)
    held = np.sum([moves for _, moves in fit._of_boards], axis=0)
    count = len(total) - 2 * FIELDS - 1
    inverse = _held_inverse(total[:count, :count], held[:, :count])
    followed = inverse @ total[:count, count:]
    left = total[count:, count:] - total[count:, :count] @ followed
    prisms = np.flatnonzero(IS_PRISM)  # what waves move all boards by stays counted, as their size is guessed
    followed[:, prisms] += _with_boards(held[:, :count], held[:, count + prisms])
    step = followed[:, -1]
    moved_px = float(np.sqrt(max(float(step @ total[:count, -1]), 0.0) / fit.residuals_px.size))
    free = fit.residuals_px.size - 6 * len(fit.rig_from_board) - (count - 6)
    return Told(
        inverse, followed[:, :-1], step, left[:-1, :-1], left[:-1, -1], float(left[-1, -1]), moved_px, free
    )


def _told_of_board(fit: Fit, number: int) -> tuple[FloatArray, FloatArray]:
    """Return the sums of one board, and how it follows what is fitted as a whole (6, P + 2 F + 1)."""
    place, residual, by_shape = fit.rig_from_board[number], fit.residuals_px[number], shapes(fit.corners)
    count = CAMERAS + by_shape.shape[2]
    points = fit.grid_mm @ place[:3, :3].T + place[:3, 3]
    carried, bent = point_jacobian(points), place[:3, :3] @ by_shape
    rows = np.zeros((2, len(points), 2, count + 2 * FIELDS + 1))
    board = np.zeros((2, len(points), 2, 6))
    for k, camera in enumerate(fit.cameras):
        pixels, by_camera, by_point = shown_by(camera, points)
        rows[k, :, :, FREE * k : FREE * (k + 1)] = by_camera
        rows[k, :, :, CAMERAS:count] = by_point @ bent
        first = count + FIELDS * k
        rows[k, :, :, first : first + FIELDS] = fields_of(camera, pixels)
        rows[k, :, :, -1] = residual[k]
        board[k] = by_point @ carried
    flat, base = rows.reshape(-1, rows.shape[3]), board.reshape(-1, 6)
    follows = np.linalg.lstsq(base, flat, rcond=None)[0]
    flat = flat - base @ follows
    held = -np.einsum("kij,kil->jl", carried, carried) @ follows
    held[:, CAMERAS:count] += np.einsum("kij,kil->jl", carried, bent)
    return flat.T @ flat, held


def _with_boards(held: FloatArray, moved: FloatArray) -> FloatArray:
    """Return how both cameras move together (P, C) with boards that fields have ``moved`` (6, C) as a whole."""
    together = np.zeros((held.shape[1], 6))
    for k in (1, 2):
        together[FREE * k - 6 : FREE * k] = np.eye(6)
    return np.asarray(together @ np.linalg.solve(held @ together, moved))


def _held_inverse(normal: FloatArray, held: FloatArray) -> FloatArray:
    """Return the inverse (P, P) of a ``normal`` matrix whose null space ``held`` (6, P) holds."""
    scale = np.sqrt(np.maximum(np.diag(normal), np.finfo(float).tiny))
    scaled = normal / np.outer(scale, scale)
    spectrum = np.linalg.eigvalsh(scaled) if np.isfinite(scaled).all() else np.zeros(len(scaled))
    if not spectrum[len(held)] > SMALLEST_INFORMATION * spectrum[-1]:
        raise InputError(UNDETERMINED)
    rows = held / scale
    rows = rows / np.linalg.norm(rows, axis=1, keepdims=True)
    bordered = np.block([[scaled, rows.T], [rows, np.zeros((len(held), len(held)))]])
    inverse = np.linalg.inv(bordered)[: len(normal), : len(normal)] / np.outer(scale, scale)
    return np.asarray((inverse + inverse.T) / 2)


def _stepped(camera: Camera, step: FloatArray) -> Camera:
    """Return ``camera`` with its numbers (15) ``step`` on."""
    matrix = camera.matrix.copy()
    matrix[[0, 1, 0, 1], [0, 1, 2, 2]] += step[:4]
    stepped = replace(camera, matrix=matrix, distortion=camera.distortion + step[4:9])
    return _carried(stepped, rigid(exponential(step[9:12]), step[12:]))


def _carried(camera: Camera, motion: FloatArray) -> Camera:
    """Return ``camera`` moved in the rig by ``motion`` (4, 4)."""
    return replace(camera, rig_from_camera=motion @ camera.rig_from_camera)


def _placed(
    cameras: tuple[Camera, Camera], seen: tuple[FloatArray, FloatArray], grid: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return where a board is in the rig (4, 4) by its corners, and their residuals (2, K, 2)."""
    import cv2

    _, turn, shift = cv2.solvePnP(grid, seen[0], cameras[0].matrix, cameras[0].distortion)
    place = cameras[0].rig_from_camera @ rigid(exponential(np.ravel(turn)), np.ravel(shift))
    for _ in range(BOARD_STEPS):
        points = grid @ place[:3, :3].T + place[:3, 3]
        shown = [shown_by(camera, points) for camera in cameras]
        residuals = np.array([one[:, 0] - pixels for one, (pixels, _, _) in zip(seen, shown, strict=True)])
        slope = np.array([by_point @ point_jacobian(points) for _, _, by_point in shown])
        step = np.linalg.lstsq(slope.reshape(-1, 6), residuals.ravel(), rcond=None)[0]
        place = rigid(exponential(step[:3]), step[3:]) @ place
    return place, residuals


def shown_by(camera: Camera, points_mm: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the pixels (N, 2) that show ``points_mm`` (N, 3), and slopes by the camera (N, 2, 15) and by these."""
    import cv2

    turn, none = camera.rig_from_camera[:3, :3], np.zeros(3)
    pixels, slope = cv2.projectPoints(
        (points_mm - camera.center_mm) @ turn, none, none, camera.matrix, camera.distortion
    )
    slope = np.reshape(slope, (len(points_mm), 2, -1))
    by_point = slope[:, :, 3:6] @ turn.T
    by_camera = np.concatenate([slope[:, :, 6:15], -by_point @ point_jacobian(points_mm)], axis=2)
    return np.reshape(pixels, (-1, 2)), by_camera, by_point


def fields_of(camera: Camera, pixels: FloatArray) -> FloatArray:
    """Return by how much fields shift ``pixels`` (N, 2): (N, 2, F), waves of 1 pixel RMS, and as a prism does.

    A lens that bends aside is decentered or a prism, which boards hardly tell apart: the camera turned a little makes
    one of the other. The model has all of it as decentering, so the prism is as large as that.
    """
    phases = np.pi * (pixels + 0.5) / np.array(camera.size_px)
    waves = np.cos(phases[:, None, :] * ORDERS) * np.sqrt(1 + (ORDERS > 0))
    shifts = np.zeros((len(pixels), 2, FIELDS))
    shifts[:, 0, : len(ORDERS)] = shifts[:, 1, len(ORDERS) : -1] = waves.prod(axis=2)
    focal = np.diag(camera.matrix)[:2]
    out = (pixels - camera.matrix[:2, 2]) / focal
    shifts[:, :, -1] = (out**2).sum(axis=1)[:, None] * camera.distortion[[3, 2]] * focal
    return shifts
