"""How wrong two calibrated cameras may be, and what that does to the place of a sphere.

The cameras are those that fit a board's corners best, so that the corners' noise makes them wrong by the inverse of the
normal matrix (the Jacobian's square) of that fit. Lenses are no polynomials: what the cameras' model lacks makes them
wrong, too, where boards were seen, and more where they were not. So a lens may bend otherwise by any smooth field in
its image, as large as the corners' residuals tell.

All errors are those of places against the boards': where the boards as a whole seem to be is where the rig is, and a
motion that cameras and boards share is none. `calibrate_tcp` finds that motion, by the same cameras.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ronnaplan.errors import InputError
from ronnaplan.geometry import FloatArray
from ronnaplan.pose import exponential, point_jacobian, rigid
from ronnaplan.robot.board import grid_mm
from ronnaplan.robot.camera import Boards, Camera, StereoRig

LENS_ORDER = 4
"""A lens may bend otherwise in cosines over its image of up to so many half periods along both axes together."""
ORDERS = np.array([(i, j) for i in range(LENS_ORDER + 1) for j in range(LENS_ORDER + 1 - i)])
FREE = 15
"""Numbers of a camera: focal lengths and middle (4), distortion (5), and the motion of its place in the rig (6)."""
FIELDS = 2 * len(ORDERS)
"""Of one camera: of x and of y."""
BOARD_STEPS = 6
RING = np.linspace(0, 2 * np.pi, 24, endpoint=False)
"""Where on a sphere's outline it is looked at."""
LOOKED_AT = 12, 10
"""At so many columns and rows of the left image it is looked at whether places are known."""
SMALLEST_INFORMATION = 1e-9
"""Smallest over largest eigenvalue of the scaled normal matrix, but for the rig's own motion, of boards that determine
the cameras: eight boards of the studies have 1e-7 and more, eight at one place 2e-11."""
UNTOLD = 1e-8
"""Fields of a lens that move corners less, of the most (squared), than the cameras cannot follow, are not told."""


@dataclass(frozen=True, eq=False)
class CalibrationErrors:
    """What cameras do not know of themselves; numbers are of the left camera (15), then of the right."""

    covariance: FloatArray
    """(30, 30) by the noise of the boards' corners."""
    followed: FloatArray
    """(30, 2 F): how both cameras follow fields of 1 pixel by which their lenses bend otherwise, F of each camera."""
    field_px: float
    """Standard deviation of each field."""

    def of_places(
        self, rig: StereoRig, center_mm: FloatArray, across: Sequence[FloatArray], radius_mm: float
    ) -> FloatArray:
        """Return the covariance (4, 4) of where both images put a sphere's center along ``across`` (3, 2), at 1."""
        moved, bent = np.zeros((4, 2 * FREE)), np.zeros((4, 2 * FIELDS))
        for k, (camera, axes) in enumerate(zip((rig.left, rig.right), across, strict=True)):
            rows = slice(2 * k, 2 * k + 2)
            by_camera, by_field = _shifts(camera, center_mm, axes, radius_mm)
            moved[rows, FREE * k : FREE * (k + 1)] = by_camera
            bent[rows, FIELDS * k : FIELDS * (k + 1)] = by_field
        bent += moved @ self.followed
        return np.asarray(moved @ self.covariance @ moved.T + self.field_px**2 * bent @ bent.T)

    def of_center(self, rig: StereoRig, center_mm: FloatArray, radius_mm: float) -> FloatArray:
        """Return the covariance (3, 3) of a sphere's center that both images put where they see it."""
        across, slopes = [], []
        for camera in (rig.left, rig.right):
            away = center_mm - camera.center_mm
            axes = np.linalg.svd(away[None])[2][1:].T
            across.append(axes)
            slopes.append(axes.T / np.linalg.norm(away))
        gain = np.linalg.pinv(np.concatenate(slopes))
        return np.asarray(gain @ self.of_places(rig, center_mm, across, radius_mm) @ gain.T)


@dataclass(frozen=True, eq=False)
class _Told:
    """What the boards' corners tell once each board is where it fits best: sums over all corners."""

    inverse: FloatArray
    """(30, 30), of the normal matrix of the cameras, where the boards as a whole are held."""
    followed: FloatArray
    lens: FloatArray
    """(2 F, 2 F): normal matrix of the fields, once the cameras follow them."""
    lens_misfit: FloatArray
    """(2 F): the fields' slope with the corners' residuals, likewise."""
    misfit: float
    """Sum of the squared residuals, likewise."""
    free: int
    """Residuals, less what was fitted."""


@lru_cache(maxsize=4)
def errors_of(rig: StereoRig) -> CalibrationErrors | None:
    """Return what the cameras of ``rig`` do not know of themselves, or None where it is not told what they saw."""
    boards = rig.boards
    if boards is None:
        return None
    grid = grid_mm(boards.corners, boards.square_mm)
    unknown = np.zeros((len(boards.rig_from_board), 2, len(grid), 2))
    told = _told((rig.left, rig.right), boards.rig_from_board, grid, unknown)
    return CalibrationErrors(
        boards.error_px**2 * told.inverse, told.followed, boards.lens_px / float(np.sqrt(len(ORDERS)))
    )


def known_share(rig: StereoRig, largest_mm: float) -> float:
    """Return in which part of what both cameras see, as far away as the boards, they know places to ``largest_mm``.

    Places are of spheres as wide as the board's squares.
    """
    boards, errors = rig.boards, errors_of(rig)
    if boards is None or errors is None or rig.left.size_px is None or rig.right.size_px is None:
        return 1.0
    middle = np.append(grid_mm(boards.corners, boards.square_mm).mean(axis=0), 1.0)
    far = float(np.linalg.norm((boards.rig_from_board @ middle)[:, :3] - rig.left.center_mm, axis=1).mean())
    columns, rows = (
        (np.arange(count) + 0.5) / count * size for count, size in zip(LOOKED_AT, rig.left.size_px, strict=True)
    )
    pixels = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(
        -1, 2
    )  # but for the lens, which may not be invertible
    plane = (pixels - rig.left.matrix[:2, 2]) / np.diag(rig.left.matrix)[:2]
    rays = np.column_stack([plane, np.ones(len(plane))])
    rays *= far / np.linalg.norm(rays, axis=1, keepdims=True)
    places = rig.left.center_mm + rays @ rig.left.rig_from_camera[:3, :3].T
    shown = _shown(rig.right, places)[0]
    both = places[((shown >= 0) & (shown < rig.right.size_px)).all(axis=1)]
    known = [
        float(np.trace(errors.of_center(rig, place, boards.square_mm / 2))) <= largest_mm**2 for place in both
    ]
    return float(np.mean(known)) if known else 0.0


def judged(
    cameras: tuple[Camera, Camera],
    seen: Sequence[tuple[FloatArray, FloatArray]],
    corners: tuple[int, int],
    square_mm: float,
) -> Boards:
    """Return the boards whose corners were ``seen`` (K, 1, 2) by both cameras, and how far those are off.

    How large the fields are by which the lenses bend otherwise is that at which they explain as much of the residuals
    as they do, and one standard error of that more.
    """
    grid = grid_mm(corners, square_mm)
    placed = [_placed(cameras, pair, grid) for pair in seen]
    places = np.array([place for place, _ in placed])
    told = _told(cameras, places, grid, np.array([residuals for _, residuals in placed]))
    values, axes = np.linalg.eigh(told.lens)
    is_told = values > UNTOLD * values[-1]
    explained = float((((axes.T @ told.lens_misfit)[is_told]) ** 2 / values[is_told]).sum())
    variance = (told.misfit - explained) / (told.free - int(is_told.sum()))
    square = float((values**2).sum())
    larger = float(told.lens_misfit @ told.lens_misfit) - variance * float(values.sum())
    fields = (max(larger, 0.0) + variance * np.sqrt(2 * square)) / square
    return Boards(corners, square_mm, places, float(np.sqrt(variance)), float(np.sqrt(fields * len(ORDERS))))


def _told(cameras: tuple[Camera, Camera], places: FloatArray, grid: FloatArray, residuals: FloatArray) -> _Told:
    """Return what boards at ``places`` (N, 4, 4) tell of both cameras by their ``residuals`` (N, 2, K, 2)."""
    total = np.zeros((2 * FREE + 2 * FIELDS + 1,) * 2)
    held = np.zeros((6, 2 * FREE))
    for place, residual in zip(places, residuals, strict=True):
        points = grid @ place[:3, :3].T + place[:3, 3]
        carried = point_jacobian(points)
        rows = np.zeros((2, len(grid), 2, total.shape[0]))
        board = np.zeros((2, len(grid), 2, 6))
        for k, camera in enumerate(cameras):
            pixels, by_camera, by_point = _shown(camera, points)
            rows[k, :, :, FREE * k : FREE * (k + 1)] = by_camera
            first = 2 * FREE + FIELDS * k
            rows[k, :, :, first : first + FIELDS] = _fields(camera, pixels)
            rows[k, :, :, -1] = residual[k]
            board[k] = by_point @ carried
        flat, base = rows.reshape(-1, total.shape[0]), board.reshape(-1, 6)
        follows = np.linalg.lstsq(base, flat, rcond=None)[0]
        flat = flat - base @ follows
        total += flat.T @ flat
        held -= np.einsum("kij,kil->jl", carried, carried) @ follows[:, : 2 * FREE]
    cut = 2 * FREE
    inverse = _held_inverse(total[:cut, :cut], held)
    followed = inverse @ total[:cut, cut:]
    left = total[cut:, cut:] - total[cut:, :cut] @ followed
    free = residuals.size - 6 * len(places) - (cut - 6)
    return _Told(inverse, followed[:, :-1], left[:-1, :-1], left[:-1, -1], float(left[-1, -1]), free)


def _held_inverse(normal: FloatArray, held: FloatArray) -> FloatArray:
    """Return the inverse (30, 30) of a ``normal`` matrix whose null space ``held`` (6, 30) holds."""
    scale = np.sqrt(np.maximum(np.diag(normal), np.finfo(float).tiny))
    scaled = normal / np.outer(scale, scale)
    spectrum = np.linalg.eigvalsh(scaled) if np.isfinite(scaled).all() else np.zeros(len(scaled))
    if not spectrum[len(held)] > SMALLEST_INFORMATION * spectrum[-1]:
        raise InputError("the boards do not determine the cameras; tilt them to all sides, all over both images")
    rows = held / scale
    rows = rows / np.linalg.norm(rows, axis=1, keepdims=True)
    bordered = np.block([[scaled, rows.T], [rows, np.zeros((len(held), len(held)))]])
    inverse = np.linalg.inv(bordered)[: len(normal), : len(normal)] / np.outer(scale, scale)
    return np.asarray((inverse + inverse.T) / 2)


def _placed(
    cameras: tuple[Camera, Camera], seen: tuple[FloatArray, FloatArray], grid: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return where a board is in the rig (4, 4) by its corners, and their residuals (2, K, 2)."""
    import cv2

    _, turn, shift = cv2.solvePnP(grid, seen[0], cameras[0].matrix, cameras[0].distortion)
    place = cameras[0].rig_from_camera @ rigid(exponential(np.ravel(turn)), np.ravel(shift))
    for _ in range(BOARD_STEPS):
        points = grid @ place[:3, :3].T + place[:3, 3]
        shown = [_shown(camera, points) for camera in cameras]
        residuals = np.array([one[:, 0] - pixels for one, (pixels, _, _) in zip(seen, shown, strict=True)])
        slope = np.array([by_point @ point_jacobian(points) for _, _, by_point in shown])
        step = np.linalg.lstsq(slope.reshape(-1, 6), residuals.ravel(), rcond=None)[0]
        place = rigid(exponential(step[:3]), step[3:]) @ place
    return place, residuals


def _shown(camera: Camera, points_mm: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
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


def _fields(camera: Camera, pixels: FloatArray) -> FloatArray:
    """Return by how much fields of 1 pixel RMS shift ``pixels`` (N, 2): (N, 2, F)."""
    phases = np.pi * (pixels + 0.5) / np.array(camera.size_px)
    waves = np.cos(phases[:, None, :] * ORDERS) * np.sqrt(1 + (ORDERS > 0))
    field = waves.prod(axis=2)
    shifts = np.zeros((len(pixels), 2, 2, len(ORDERS)))
    shifts[:, 0, 0], shifts[:, 1, 1] = field, field
    return shifts.reshape(len(pixels), 2, FIELDS)


def _shifts(
    camera: Camera, center_mm: FloatArray, axes: FloatArray, radius_mm: float
) -> tuple[FloatArray, FloatArray]:
    """Return the shift of a sphere's center along ``axes`` (3, 2) at 1 by the camera (2, 15) and fields (2, F).

    The outline stays where it is in the image: what shows each of its points moves, and the cone through them with it.
    """
    away = center_mm - camera.center_mm
    far = float(np.linalg.norm(away))
    axis, half_angle = away / far, float(np.arcsin(min(radius_mm / far, 1.0)))
    aside = axes[:, 0] - axis * (axis @ axes[:, 0])
    aside /= np.linalg.norm(aside)
    square = np.cross(axis, aside)
    turned = np.column_stack([np.cos(RING), np.sin(RING)])
    outward = turned @ np.array([aside, square])
    reach = far * np.cos(half_angle)
    points = camera.center_mm + reach * (np.cos(half_angle) * axis + np.sin(half_angle) * outward)
    pixels, by_camera, by_point = _shown(camera, points)
    rays = np.stack([np.cos(half_angle) * outward - np.sin(half_angle) * axis, np.cross(axis, outward)], axis=2)
    moves = np.concatenate([-by_camera, _fields(camera, pixels)], axis=2)
    angles = np.linalg.solve(reach * by_point @ rays, moves)[:, 0]  # how far out each point moves, rad
    shift = np.array([aside, square]).T @ (2 * turned.T @ angles / len(RING))
    return np.split(axes.T @ shift, [FREE], axis=1)  # type: ignore[return-value]
