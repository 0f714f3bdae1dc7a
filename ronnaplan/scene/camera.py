"""The eye of the 3-D view, and how it sees bodies: OpenCV fills the triangles, no graphics library is needed."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ronnaplan.geometry import FloatArray, unit
from ronnaplan.scene.cut import Cut
from ronnaplan.scene.shapes import Body

VIEW_DEG = 30.0
"""The angle that the picture's shorter side spans."""

NEAREST_MM, FURTHEST_MM = 1.0, 20_000.0
"""Only what lies this far in front of the eye is drawn: from the furthest a room with its robot is small."""

CUT_MM = 2.0
"""Surfaces are cut off this far before the eye, a little more than what OpenCV draws."""

STEEPEST = 0.98
"""The eye comes no nearer to straight above or below than this cosine, where it would not know what is up."""

AMBIENT = 0.35
"""Share of its colour that a surface shows which the light only grazes."""

LIGHT = np.array([-0.3, 0.4, 0.87])
"""Where the light comes from, in the eye's axes: from behind it, above and to the left."""

Picture = NDArray[np.float32]
Vertices = NDArray[np.float32]
Triangles = NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class Camera:
    """An eye at ``position_mm`` (3,) that looks at ``focus_mm`` (3,), LPS; superior is up."""

    position_mm: FloatArray
    focus_mm: FloatArray

    @cached_property
    def axes(self) -> FloatArray:
        """Rows (3, 3) in LPS: right and up on the picture, and towards the eye."""
        back = unit(self.position_mm - self.focus_mm)
        right = unit(np.cross([0.0, 0.0, 1.0], back))
        return np.stack([right, np.cross(back, right), back])

    def turned(self, across_deg: float, up_deg: float) -> Camera:
        """Return the eye gone about its focus, to the right and up."""
        offset = self.position_mm - self.focus_mm
        distance = float(np.linalg.norm(offset))
        longitude = np.arctan2(offset[1], offset[0]) + np.radians(across_deg)
        steepest = np.arcsin(STEEPEST)
        latitude = np.clip(np.arcsin(offset[2] / distance) + np.radians(up_deg), -steepest, steepest)
        flat = np.cos(latitude) * np.array([np.cos(longitude), np.sin(longitude)])
        return replace(self, position_mm=self.focus_mm + distance * np.array([*flat, np.sin(latitude)]))

    def nearer(self, factor: float) -> Camera:
        """Return the eye come nearer to its focus by ``factor`` (above 1)."""
        return replace(self, position_mm=self.focus_mm + (self.position_mm - self.focus_mm) / factor)

    def ray(self, across: float, down: float) -> tuple[FloatArray, FloatArray]:
        """Return where the eye is (3,) and the unit vector (3,) to a place, in halves of the picture's shorter side."""
        right, up, back = self.axes
        reach = np.tan(np.radians(VIEW_DEG / 2))
        return self.position_mm, unit(reach * (across * right - down * up) - back)

    def plane_at(self, place_mm: FloatArray) -> Cut:
        """Return the plane parallel to the picture through a place (3,), as large as its shorter side."""
        right, up, back = self.axes
        depth = float((self.position_mm - place_mm) @ back)
        return Cut(right, -up, self.position_mm - depth * back, 2 * depth * np.tan(np.radians(VIEW_DEG / 2)))

    def on_screen(self, places_mm: FloatArray) -> FloatArray:
        """Return places (..., 3) as (..., 3): across and down in halves of the shorter side, and mm before the eye."""
        seen = (places_mm - self.position_mm) @ (self.axes * np.array([[1.0], [-1.0], [-1.0]])).T
        depth = seen[..., 2:]
        screen: FloatArray = np.concatenate(
            [seen[..., :2] / (depth * np.tan(np.radians(VIEW_DEG / 2))), depth], axis=-1
        )
        return screen

    def depths(self, shape: tuple[int, int]) -> Picture:
        """Return the depths of an empty picture of ``shape`` = (rows, columns)."""
        return np.full(shape, FURTHEST_MM, dtype=np.float32)

    @staticmethod
    def upright_deg(shape: tuple[int, int]) -> float:
        """Return the angle that the height of a picture of ``shape`` = (rows, columns) spans."""
        return float(np.degrees(2 * np.arctan(np.tan(np.radians(VIEW_DEG / 2)) * shape[0] / min(shape))))

    def draw(self, body: Body, colour: FloatArray, picture: Picture, depths: Picture) -> None:
        """Draw what of ``body`` lies nearer than ``depths`` (H, W) into ``picture`` (H, W, 3); both are changed.

        ``colour`` is one (3,) or one a vertex (V, 3), 0 to 1.
        """
        import cv2

        settings = cv2.TriangleRasterizeSettings()
        settings.setShadingType(cv2.RASTERIZE_SHADING_SHADED)
        settings.setCullingMode(cv2.RASTERIZE_CULLING_CW)
        world_to_eye = np.eye(4)
        world_to_eye[:3, :3] = self.axes
        world_to_eye[:3, 3] = -self.axes @ self.position_mm
        bright = AMBIENT + (1.0 - AMBIENT) * np.clip(body.normals @ (LIGHT @ self.axes), 0.0, 1.0)
        colours = (bright[:, np.newaxis] * colour).astype(np.float32)
        before_mm = (self.position_mm - body.vertices_mm) @ self.axes[2]
        vertices_mm, triangles, colours = _before_eye(body.vertices_mm, body.triangles, colours, before_mm)
        if not len(triangles):
            return
        cv2.triangleRasterize(
            vertices_mm[np.newaxis],
            triangles[np.newaxis],
            colours[np.newaxis],
            picture,
            depths,
            world_to_eye,
            np.radians(self.upright_deg(depths.shape)),
            NEAREST_MM,
            FURTHEST_MM,
            settings,
        )


def _before_eye(
    vertices_mm: Vertices, triangles: Triangles, colours: Vertices, before_mm: FloatArray
) -> tuple[Vertices, Triangles, Vertices]:
    """Return vertices (V, 3), triangles (T, 3) and colours (V, 3) of what lies `CUT_MM` and more before the eye.

    ``before_mm`` (V,) is how far before it the vertices lie. OpenCV fills a triangle that reaches behind the eye with
    what comes of dividing by its depth.
    """
    behind = before_mm[triangles] < CUT_MM
    if not behind.any():
        return vertices_mm, triangles, colours
    count = behind.sum(axis=1)
    corners, kept = np.column_stack([vertices_mm, colours, before_mm]), [triangles[count == 0]]
    for odd in (1, 2):
        cut, alone = triangles[count == odd], (behind if odd == 1 else ~behind)[count == odd].argmax(axis=1)
        apex, left, right = np.take_along_axis(cut, (alone[:, np.newaxis] + np.arange(3)) % 3, axis=1).T
        ends = []
        for other in (left, right):
            ends.append(np.arange(len(corners), len(corners) + len(apex), dtype=np.int32))
            way = corners[other] - corners[apex]
            share = (CUT_MM - corners[apex, -1]) / way[:, -1]
            corners = np.concatenate([corners, corners[apex] + share[:, np.newaxis] * way])
        pieces = [(ends[0], left, right), (ends[0], right, ends[1])] if odd == 1 else [(apex, *ends)]
        kept += [np.stack(piece, axis=1) for piece in pieces]
    whole = np.ascontiguousarray(corners, dtype=np.float32)
    return whole[:, :3].copy(), np.concatenate(kept), whole[:, 3:6].copy()
