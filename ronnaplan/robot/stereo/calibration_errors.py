"""How wrong two calibrated cameras may be, and what that does to the place of a sphere.

The cameras are those that fit a board's corners best, so that the corners' noise makes them wrong by the inverse of the
normal matrix (the Jacobian's square) of that fit. How long the squares are is known to a stated part: it makes all
distances wrong alike. Lenses are no polynomials: what the cameras' model lacks makes them wrong, too, where boards
were seen, and more where they were not. So a lens may bend otherwise by any smooth field in its image, as large as the
corners' residuals tell; and as far as it bends aside it may be a prism, for which the model has it decentered.

All errors are those of places against the boards': where the boards as a whole seem to be is where the rig is, and a
motion that cameras and boards share is none. `calibrate_tcp` finds that motion, by the same cameras.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from ronnaplan.geometry import FloatArray, axes_across, rms_mm
from ronnaplan.robot.stereo.board import grid_mm
from ronnaplan.robot.stereo.calibration_fit import (
    CAMERAS,
    FIELDS,
    FREE,
    IS_PRISM,
    ORDERS,
    Fit,
    fields_of,
    shown_by,
)
from ronnaplan.robot.stereo.camera import Boards, Camera, StereoRig

RING = np.linspace(0, 2 * np.pi, 24, endpoint=False)
"""Where on a sphere's outline it is looked at."""
LOOKED_AT = 12, 10
"""At so many columns and rows of the left image it is looked at whether places are known."""
UNTOLD = 1e-8
"""Fields of a lens that move corners less, of the most (squared), than the cameras cannot follow, are not told."""
KEEP_TO_BOARDS = (
    "bring the sphere nearer to where the calibration's boards were, or calibrate with more boards, larger in the "
    "images and there, too"
)
MEASURE_SQUARES = (
    "most of that is how well the side of the board's squares is known: measure the board over its whole length, and "
    "calibrate anew with the side and its error (--square, --sigma-square)"
)


@dataclass(frozen=True, eq=False)
class CalibrationErrors:
    """What cameras do not know of themselves; numbers are of the left camera (15), then of the right."""

    covariance: FloatArray
    """(30, 30) by the noise of the boards' corners, their shape left open, and by the side of their squares."""
    followed: FloatArray
    """(30, 2 F): how both cameras follow the fields by which their lenses bend otherwise, F of each camera."""
    sds: FloatArray
    """(2 F): standard deviation of each field; of a prism all that bends aside."""

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
        bent = (bent + moved @ self.followed) * self.sds
        return np.asarray(moved @ self.covariance @ moved.T + bent @ bent.T)

    def of_center(self, rig: StereoRig, center_mm: FloatArray, radius_mm: float) -> FloatArray:
        """Return the covariance (3, 3) of a sphere's center that both images put where they see it."""
        across, slopes = [], []
        for camera in (rig.left, rig.right):
            away = center_mm - camera.center_mm
            distance_mm = np.linalg.norm(away)
            axes = axes_across(away / distance_mm)
            across.append(axes.T)
            slopes.append(axes / distance_mm)
        gain = np.linalg.pinv(np.concatenate(slopes))
        return np.asarray(gain @ self.of_places(rig, center_mm, across, radius_mm) @ gain.T)


@lru_cache(maxsize=4)
def errors_of(rig: StereoRig) -> CalibrationErrors | None:
    """Return what the cameras of ``rig`` do not know of themselves, or None where it is not told what they saw."""
    boards = rig.boards
    if boards is None:
        return None
    grid = grid_mm(boards.corners, boards.square_mm)  # slopes are those of the flat board to first order
    unknown = np.zeros((len(boards.rig_from_board), 2, len(grid), 2))
    told = Fit((rig.left, rig.right), boards.corners, grid, boards.rig_from_board, unknown).told
    noise = boards.error_px**2 * told.inverse[:CAMERAS, :CAMERAS]
    scaled = _scaled(rig, boards.rig_from_board @ np.append(grid.mean(axis=0), 1.0)) * boards.sigma_square
    sds = np.where(IS_PRISM, 1.0, boards.lens_px / np.sqrt(len(ORDERS)))
    return CalibrationErrors(noise + np.outer(scaled, scaled), told.followed[:CAMERAS], sds)


def with_exact_squares(rig: StereoRig) -> StereoRig:
    """Return ``rig`` as if the side of its boards' squares were known."""
    return rig if rig.boards is None else replace(rig, boards=replace(rig.boards, sigma_square=0.0))


def remedy(rig: StereoRig, center_mm: FloatArray, radius_mm: float) -> str:
    """Say what makes the cameras of ``rig`` know a sphere about ``center_mm`` (3,) better."""
    whole, of_images = (
        0.0 if errors is None else float(np.trace(errors.of_center(rig, center_mm, radius_mm)))
        for errors in (errors_of(rig), errors_of(with_exact_squares(rig)))
    )
    return MEASURE_SQUARES if 2 * of_images < whole else KEEP_TO_BOARDS


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
    pixels = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
    # Where that is but for the lens, which may not be invertible.
    plane = (pixels - rig.left.matrix[:2, 2]) / np.diag(rig.left.matrix)[:2]
    rays = np.column_stack([plane, np.ones(len(plane))])
    rays *= far / np.linalg.norm(rays, axis=1, keepdims=True)
    places = rig.left.center_mm + rays @ rig.left.rig_from_camera[:3, :3].T
    shown = shown_by(rig.right, places)[0]
    both = places[((shown >= 0) & (shown < rig.right.size_px)).all(axis=1)]
    known = [rms_mm(errors.of_center(rig, place, boards.square_mm / 2)) <= largest_mm for place in both]
    return float(np.mean(known)) if known else 0.0


def judged(fit: Fit, square_mm: float, sigma_square: float) -> Boards:
    """Return the boards whose corners cameras fit, and how far those are off.

    How large the fields are by which the lenses bend otherwise is that at which they explain as much of the residuals
    as they do, and one standard error of that more.
    """
    told = fit.told
    lens, lens_misfit = told.lens[np.ix_(~IS_PRISM, ~IS_PRISM)], told.lens_misfit[~IS_PRISM]
    values, axes = np.linalg.eigh(lens)
    is_told = values > UNTOLD * values[-1]
    explained = float((((axes.T @ lens_misfit)[is_told]) ** 2 / values[is_told]).sum())
    variance = (told.misfit - explained) / (told.free - int(is_told.sum()))
    square = float((values**2).sum())
    larger = float(lens_misfit @ lens_misfit) - variance * float(values.sum())
    fields = (max(larger, 0.0) + variance * np.sqrt(2 * square)) / square
    error_px, lens_px = float(np.sqrt(variance)), float(np.sqrt(fields * len(ORDERS)))
    return Boards(fit.corners, square_mm, fit.rig_from_board, error_px, lens_px, sigma_square)


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
    pixels, by_camera, by_point = shown_by(camera, points)
    rays = np.stack([np.cos(half_angle) * outward - np.sin(half_angle) * axis, np.cross(axis, outward)], axis=2)
    moves = np.concatenate([-by_camera, fields_of(camera, pixels)], axis=2)
    angles = np.linalg.solve(reach * by_point @ rays, moves)[:, 0]  # how far out each point moves, rad
    shift = np.array([aside, square]).T @ (2 * turned.T @ angles / len(RING))
    return np.split(axes.T @ shift, [FREE], axis=1)  # type: ignore[return-value]


def _scaled(rig: StereoRig, middles: FloatArray) -> FloatArray:
    """Return how the cameras' numbers (30) follow the side of the boards' squares, as a part of it.

    All that is seen of boards with their ``middles`` (N, 4) then is farther from where they are as a whole.
    """
    moved = np.zeros(CAMERAS)
    for k, camera in enumerate((rig.left, rig.right)):
        moved[FREE * (k + 1) - 3 : FREE * (k + 1)] = camera.center_mm - middles[:, :3].mean(axis=0)
    return moved
