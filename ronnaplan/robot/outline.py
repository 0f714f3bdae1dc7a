"""The outline of a bright sphere in one image, and the direction to its center.

A sphere's outline lies on a circular cone about the line from the camera to its center, so its image is an ellipse
whose center is *not* the image of the sphere's center. The cone is therefore fitted to the outline's undistorted
rays, which gives the direction to the center without that bias.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ronnaplan.errors import InputError
from ronnaplan.geometry import FloatArray
from ronnaplan.robot.camera import Camera

SMALLEST_RADIUS_PX = 8.0
"""Smaller bright blobs are stray reflections, or too coarse to measure."""
SMALLEST_ROUNDNESS = 0.75
"""4 pi area / perimeter^2 of an outline, 1 for a circle; streaks and merged blobs fall below."""
SMALLEST_CONTRAST_SDS = 5.0
"""A blob must stand out from its surroundings by this many noise standard deviations."""
PROFILE_STEP_PX = 0.25
PROFILE_REACH = 0.25
"""Edges are sought within this share of the radius (at least `PROFILE_LEAST_PX`) about the coarse outline."""
PROFILE_LEAST_PX = 5.0
LEVEL_SPOKES = 9
"""The brightness on both sides of the edge is averaged over so many neighbouring profiles: light may fall unevenly."""
CONSENSUS_PX = 1.0
"""A first outline is the one that most points lie as near to, so that hidden or spoilt parts do not pull it."""
LARGEST_RMS_PX = 0.5
"""Points that scatter more about their outline are no sphere's."""
OUTLIER_SDS = 4.0
SMALLEST_COVERAGE = 0.6
"""Share of the outline that must agree with the cone; the rest may be hidden or spoilt by a reflection."""
CORRELATED_POINTS = 3.0
"""Outline points stand one pixel apart and share interpolated pixels: so many count as one in the covariance."""
ITERATIONS = 20

Image = NDArray[np.uint8] | NDArray[np.uint16] | NDArray[np.float64]


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
    grey = np.asarray(image, dtype=np.float64)
    if grey.ndim != 2 or min(grey.shape) < 4 * SMALLEST_RADIUS_PX or not np.isfinite(grey).all():
        raise InputError(
            f"a camera image has shape {grey.shape}; expected grey values (rows, columns), all finite"
        )
    outlines = []
    for center, radius in _blobs(grey):
        outline = _outline(grey, center, radius, camera)
        if outline is not None:  # again about what was found: a reflection beside a blob shifts its middle
            outline = _outline(grey, *_circle(outline.points_px), camera)
        if outline is not None and outline.rms_px <= LARGEST_RMS_PX:
            outlines.append(outline)
    return outlines


def _outline(grey: FloatArray, center: FloatArray, radius: float, camera: Camera) -> Outline | None:
    edges = _edge_points(grey, center, radius)
    return None if edges is None else _fit_cone(edges, camera)


def _circle(points_px: FloatArray) -> tuple[FloatArray, float]:
    """Return center (2,) and mean radius of the ellipse through ``points_px`` (N, 2)."""
    import cv2

    center, axes, _ = cv2.fitEllipse(points_px.astype(np.float32))
    return np.array(center), float(sum(axes)) / 4


def _blobs(grey: FloatArray) -> list[tuple[FloatArray, float]]:
    """Return (center, radius) in pixels of round bright blobs, largest first."""
    import cv2

    low, high = grey.min(), grey.max()
    if high <= low:
        return []
    scaled = ((grey - low) * (255 / (high - low))).astype(np.uint8)
    smooth = cv2.GaussianBlur(scaled, (0, 0), 1.5)
    _, mask = cv2.threshold(smooth, 0, 255, cv2.THRESH_BINARY | cv2.THRESH_OTSU)
    contours, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    found = []
    for contour in contours:
        hull = cv2.convexHull(contour)
        area, length = cv2.contourArea(hull), cv2.arcLength(hull, True)
        radius = float(np.sqrt(area / np.pi))
        if radius < SMALLEST_RADIUS_PX or 4 * np.pi * area < SMALLEST_ROUNDNESS * length**2:
            continue
        moments = cv2.moments(hull)
        center = np.array([moments["m10"], moments["m01"]]) / moments["m00"]
        found.append((center, radius))
    return sorted(found, key=lambda blob: -blob[1])


def _edge_points(grey: FloatArray, center: FloatArray, radius: float) -> FloatArray | None:
    """Return outline points (N, 2) in pixels: where radial profiles fall to half height; None if faint."""
    from scipy.ndimage import map_coordinates

    reach = max(PROFILE_REACH * radius, PROFILE_LEAST_PX)
    angles = np.linspace(0, 2 * np.pi, int(2 * np.pi * radius), endpoint=False)
    radii = np.arange(max(radius - reach, 1.0), radius + reach, PROFILE_STEP_PX)
    spokes = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    places = center + radii[None, :, None] * spokes[:, None]
    low = np.maximum(np.floor(places.min(axis=(0, 1))).astype(int) - 8, 0)
    high = np.minimum(np.ceil(places.max(axis=(0, 1))).astype(int) + 9, grey.shape[::-1])
    window = grey[low[1] : high[1], low[0] : high[0]]
    where = (places - low).transpose(2, 0, 1)[::-1]
    profile = map_coordinates(window, where, order=3, mode="nearest")
    margin = np.array(grey.shape[::-1]) - 1
    inside_image = ((places >= 0) & (places <= margin)).all(axis=2).all(axis=1)
    quarter = len(radii) // 4
    bright, dark = _along(profile[:, :quarter]), _along(profile[:, -quarter:])
    noise = 1.4826 * np.median(np.abs(profile[:, -quarter:] - dark[:, None])) + 1e-9
    if np.median(bright - dark) < SMALLEST_CONTRAST_SDS * noise:
        return None
    usable = inside_image & (bright - dark > SMALLEST_CONTRAST_SDS * noise)
    return _crossings(profile, (bright + dark) / 2, radii, center, spokes, usable)


def _along(profile: FloatArray) -> FloatArray:
    """Return the brightness (N,) of parts of profiles (N, M), smoothed over neighbouring ones."""
    from scipy.ndimage import median_filter

    brightness: FloatArray = median_filter(np.median(profile, axis=1), LEVEL_SPOKES, mode="wrap")
    return brightness


def _crossings(
    profile: FloatArray,
    level: FloatArray,
    radii: FloatArray,
    center: FloatArray,
    spokes: FloatArray,
    usable: NDArray[np.bool_],
) -> FloatArray:
    """Return where each usable profile falls through its ``level`` (N,), if it does so once."""
    above = profile > level[:, None]
    falls = above[:, :-1] & ~above[:, 1:]
    usable = usable & above[:, 0] & ~above[:, -1] & (falls.sum(axis=1) >= 1)
    rows = np.flatnonzero(usable)
    first = falls[rows].argmax(axis=1)
    last = falls.shape[1] - 1 - falls[rows, ::-1].argmax(axis=1)
    here = (first + last) // 2  # noise can make a few crossings within one edge
    here = np.where(falls[rows, here], here, first)
    before, after = profile[rows, here], profile[rows, here + 1]
    radius = radii[here] + PROFILE_STEP_PX * (before - level[rows]) / (before - after)
    points: FloatArray = center + radius[:, None] * spokes[rows]
    return points


def _fit_cone(points_px: FloatArray, camera: Camera) -> Outline | None:
    """Fit the circular cone of a sphere's outline to ``points_px``, leaving out points that disagree."""
    total = len(points_px)
    if total < 12:
        return None
    rays = camera.rays(points_px)
    axis, half_angle, kept = _consensus(rays, CONSENSUS_PX / camera.focal_px)
    for _ in range(ITERATIONS):
        axis, half_angle, information, residual = _refine_cone(rays, kept, axis, half_angle)
        deviation = np.abs(residual - np.median(residual[kept]))
        scale = 1.4826 * float(np.median(deviation[kept])) + 1e-12
        closer = deviation < OUTLIER_SDS * scale
        if closer.sum() < SMALLEST_COVERAGE * total:
            return None
        if (closer == kept).all():
            break
        kept = closer
    rms_px = float(np.sqrt((residual[kept] ** 2).mean()) * camera.focal_px)
    variance = float((residual[kept] ** 2).sum()) / (kept.sum() - 3) * CORRELATED_POINTS
    covariance = np.linalg.inv(information) * variance
    across = _across(axis)
    return Outline(
        axis,
        across @ covariance[:2, :2] @ across.T,
        half_angle,
        float(np.sqrt(covariance[2, 2])),
        points_px[kept],
        rms_px,
    )


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
    rays: FloatArray, kept: NDArray[np.bool_], axis: FloatArray, half_angle: float
) -> tuple[FloatArray, float, FloatArray, FloatArray]:
    """Take one Gauss-Newton step on the rays' angles to the axis; return also information and residuals."""
    across = _across(axis)
    sideways = rays @ across
    distance = np.linalg.norm(sideways, axis=1)
    angle = np.arctan2(distance, rays @ axis)
    design = np.column_stack([-sideways / distance[:, None], -np.ones(len(rays))])
    information = design[kept].T @ design[kept]
    step = np.linalg.solve(information, -design[kept].T @ (angle - half_angle)[kept])
    moved = axis + across @ step[:2]
    residual = angle - half_angle + design @ step
    return moved / np.linalg.norm(moved), half_angle + float(step[2]), information, residual


def _across(axis: FloatArray) -> FloatArray:
    """Return two unit vectors (3, 2) square to ``axis`` and to each other."""
    return np.linalg.svd(axis[None])[2][1:].T
