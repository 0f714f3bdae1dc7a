"""The outline of a bright sphere in one image, and the direction to its center.

A sphere's outline lies on a circular cone about the line from the camera to its center, so its image is an ellipse
whose center is *not* the image of the sphere's center. The cone is therefore fitted to the outline's undistorted
rays, which gives the direction to the center without that bias.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ronnaplan.errors import InputError
from ronnaplan.geometry import FloatArray
from ronnaplan.robot.camera import Camera
from ronnaplan.robot.circles import SMALLEST_RADIUS_PX, Circle, Image, find_circles
from ronnaplan.robot.limb import FIRST_BLUR_PX, Limb, find_limb

CONSENSUS_PX = 2.0
"""A first outline is the one that most edges lie as near to, so that hidden or spoilt parts do not pull it."""
PASSES, STEPS = 6, 2
"""The limb is fitted anew about the outline found, at most so often and in so many steps each."""
SETTLED_SDS = 0.5
"""It is settled when the direction moves by less than this share of the half-angle's standard deviation."""
LARGEST_FEEDBACK = 0.75
"""Light is told from within the outline found: at most this share of the outline's error comes back by it."""
FLOOR_PX = 0.01
"""What the model of the limb errs in a sector at best."""
COMMON_LIGHT = 0.6
"""The light's error shifts the outline to one side as a whole by this share of what each sector allows for."""
LARGEST_SD_PX = 0.5
"""Sectors that know their edge worse are left out."""
LARGEST_MISFIT = 1.5
"""So are those that the model fits worse than the typical one by this factor."""
OUTLIER_SDS = 4.0
SMALLEST_COVERAGE = 0.5
"""Share of the outline that must agree with the cone; the rest may be hidden or spoilt by a reflection."""
LARGEST_RMS_PX = 0.3
"""Points that scatter more about their outline are no sphere's."""
LARGEST_OVAL_PX = 0.15
"""Points of a flat disc's outline go in a wave about a cone: more than this, beyond its error, is no sphere's."""
WAVES = (2, 3, 4)
OUTLINE_POINTS = 180
ITERATIONS = 20


@dataclass(frozen=True, eq=False)
class Outline:
    """One sphere-like outline."""

    direction: FloatArray
    """Unit direction (3,) from the camera to the sphere's center, in the camera's own frame."""
    direction_covariance: FloatArray
    """Covariance (3, 3) of the direction; zero along it (rad^2)."""
    half_angle: float
    """Half the angle (rad) under which the sphere is seen."""
    half_angle_sd: float
    points_px: FloatArray
    """The outline points (N, 2) that the fit used."""
    rms_px: float
    """RMS distance of those points from the fitted outline."""

    def distance_mm(self, diameter_mm: float) -> float:
        """Return how far the center of a sphere of ``diameter_mm`` is."""
        return float(diameter_mm / 2 / np.sin(self.half_angle))


def find_outlines(image: Image, camera: Camera) -> list[Outline]:
    """Return every outline in ``image`` (rows, columns; grey) that could be a bright sphere's, largest first.

    Raises `InputError` for an image that is not two-dimensional or not finite.
    """
    small = image.ndim != 2 or min(image.shape) < 4 * SMALLEST_RADIUS_PX
    if small or (image.dtype.kind == "f" and not np.isfinite(image).all()):
        raise InputError(
            f"a camera image has shape {image.shape}; expected grey values (rows, columns), all finite"
        )
    outlines = [_outline(image, circle, camera) for circle in find_circles(image)]
    return sorted((one for one in outlines if one is not None), key=lambda one: -one.half_angle)


def _outline(grey: Image, circle: Circle, camera: Camera) -> Outline | None:
    """Return the outline near ``circle``, if it is a sphere's.

    What light falls on the sphere is told from within the outline, so the two are found in turns. By the second pass is
    known which share of an outline's error comes back to it that way: later steps are as much longer, and the last
    one's error as much larger.
    """
    rays = camera.rays(circle.edges_px)
    axis, half_angle, near = _consensus(rays, CONSENSUS_PX / camera.focal_px)
    seen, blur_px = circle.edges_px[near], FIRST_BLUR_PX
    found, last, feedback = None, np.zeros(4), 0.0
    for k in range(PASSES):
        limb = find_limb(grey, _shown(axis, half_angle, camera), seen, steps=STEPS, blur_px=blur_px)
        found = _fit_cone(limb, camera) if limb is not None else None
        if limb is None or found is None:
            return None
        across = _across(axis)
        step = np.append(across @ (found.direction @ across), found.half_angle - half_angle)
        if k == 1:
            feedback = float(np.clip(step @ last / (last @ last + 1e-30), 0.0, LARGEST_FEEDBACK))
        if k and np.linalg.norm(step[:3]) < SETTLED_SDS * found.half_angle_sd:
            break
        axis = axis + step[:3] / (1 - feedback)
        axis, half_angle = axis / np.linalg.norm(axis), found.half_angle
        seen, blur_px, last = found.points_px, limb.blur_px, step
    if found is None or found.rms_px > LARGEST_RMS_PX:
        return None
    return replace(found, direction_covariance=found.direction_covariance / (1 - feedback) ** 2)


def _shown(axis: FloatArray, half_angle: float, camera: Camera) -> FloatArray:
    """Return the closed outline (N, 2) in pixels that a cone has in the image."""
    import cv2

    turn = np.linspace(0, 2 * np.pi, OUTLINE_POINTS, endpoint=False)
    across = _across(axis)
    rays = np.cos(half_angle) * axis + np.sin(half_angle) * (
        np.column_stack([np.cos(turn), np.sin(turn)]) @ across.T
    )
    shown = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), camera.matrix, camera.distortion)[0][:, 0]
    return np.asarray(shown, dtype=np.float64)


def _fit_cone(limb: Limb, camera: Camera) -> Outline | None:
    """Fit the circular cone of a sphere's outline to the ``limb``, leaving out sectors that disagree."""
    total = len(limb.points_px)
    clear = (limb.sds_px < LARGEST_SD_PX) & (limb.misfits < LARGEST_MISFIT * np.median(limb.misfits))
    clear &= np.roll(clear, 1) & np.roll(clear, -1)  # what spoils a sector reaches into the next
    if clear.sum() < SMALLEST_COVERAGE * total:
        return None
    points, sds = limb.points_px[clear], np.hypot(limb.sds_px[clear], FLOOR_PX) / camera.focal_px
    rays = camera.rays(points)
    axis, half_angle, kept = _consensus(rays, CONSENSUS_PX / camera.focal_px)
    for _ in range(ITERATIONS):
        axis, half_angle, information, residual = _refine_cone(rays, kept, axis, half_angle, sds)
        deviation = np.abs(residual / sds)
        scale = max(1.4826 * float(np.median(deviation[kept])), 1.0)
        closer = deviation < OUTLIER_SDS * scale
        if closer.sum() < SMALLEST_COVERAGE * total:
            return None
        if (closer == kept).all():
            break
        kept = closer
    rms_px = float(np.sqrt((residual[kept] ** 2).mean()) * camera.focal_px)
    waves, waves_sd = _waves(rays[kept], sds[kept], residual[kept], axis)
    oval = float(np.linalg.norm(waves[:2])) * camera.focal_px
    if oval > LARGEST_OVAL_PX + 3 * float(np.linalg.norm(waves_sd[:2])) * camera.focal_px:
        return None
    scatter = float(((residual[kept] / sds[kept]) ** 2).sum()) / (kept.sum() - 3)
    covariance = np.linalg.inv(information) * max(scatter, float(((waves / waves_sd) ** 2).mean()), 1.0)
    by_light = float(np.sqrt((limb.light_sds_px[clear][kept] ** 2).mean())) / camera.focal_px
    covariance[:2, :2] += (COMMON_LIGHT * by_light) ** 2 * np.eye(2)
    across = _across(axis)
    return Outline(
        axis,
        across @ covariance[:2, :2] @ across.T,
        half_angle,
        float(np.sqrt(covariance[2, 2])),
        points[kept],
        rms_px,
    )


def _waves(
    rays: FloatArray, sds: FloatArray, residual: FloatArray, axis: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return how much the residuals go in waves of two, three and four periods about a cone (6), and their sds.

    An error of the light shifts the edge slowly along the outline. What of it has one period shifts the center and is
    not seen; it is taken to be as large as those of more.
    """
    x, y = (rays @ _across(axis)).T
    turn = np.arctan2(y, x)
    columns = [wave(k * turn) for k in WAVES for wave in (np.cos, np.sin)]
    design = np.column_stack([np.ones_like(x), np.cos(turn), np.sin(turn), *columns]) / sds[:, None]
    covariance = np.linalg.inv(design.T @ design)
    return (covariance @ design.T @ (residual / sds))[3:], np.sqrt(np.diag(covariance)[3:])


def _consensus(rays: FloatArray, tolerance: float) -> tuple[FloatArray, float, NDArray[np.bool_]]:
    """Return axis and half-angle of the cone that most ``rays`` (N, 3) lie within ``tolerance`` (rad) of, and which do.

    The cone is sought among those through three rays a third of the outline apart: the tips of unit rays on a cone lie
    in one plane.
    """
    third = len(rays) // 3
    corners = np.stack([rays, np.roll(rays, third, axis=0), np.roll(rays, -third, axis=0)], axis=1)
    normals = np.linalg.solve(corners, np.ones((len(rays), 3, 1)))[..., 0]
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    axes, half_angles = normals / lengths, np.arccos(np.clip(1 / lengths, -1, 1))
    near = np.abs(np.arccos(np.clip(axes @ rays.T, -1, 1)) - half_angles) < tolerance
    best = int(near.sum(axis=1).argmax())
    return axes[best], float(half_angles[best, 0]), near[best]


def _refine_cone(
    rays: FloatArray, kept: NDArray[np.bool_], axis: FloatArray, half_angle: float, sds: FloatArray
) -> tuple[FloatArray, float, FloatArray, FloatArray]:
    """Take one Gauss-Newton step on the rays' angles to the axis; return also information and residuals."""
    across = _across(axis)
    sideways = rays @ across
    distance = np.linalg.norm(sideways, axis=1)
    angle = np.arctan2(distance, rays @ axis)
    design = np.column_stack([-sideways / distance[:, None], -np.ones(len(rays))])
    weighted = design[kept] / sds[kept, None] ** 2
    information = weighted.T @ design[kept]
    step = np.linalg.solve(information, -weighted.T @ (angle - half_angle)[kept])
    moved = axis + across @ step[:2]
    residual = angle - half_angle + design @ step
    return moved / np.linalg.norm(moved), half_angle + float(step[2]), information, residual


def _across(axis: FloatArray) -> FloatArray:
    """Return two unit vectors (3, 2) square to ``axis`` and to each other."""
    return np.linalg.svd(axis[None])[2][1:].T
