"""Bodies of triangles for the 3-D view: for the eye, nothing is measured on them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ronnaplan.geometry import FloatArray, axes_across, unit

SIDES = 16
"""A tube has so many sides, a ball so many meridians."""


@dataclass(frozen=True, eq=False)
class Body:
    """Vertices (V, 3) in LPS mm, outward unit normals (V, 3) there, and triangles (F, 3)."""

    vertices_mm: NDArray[np.float32]
    normals: NDArray[np.float32]
    triangles: NDArray[np.int32]

    @classmethod
    def of(cls, vertices_mm: FloatArray, triangles: NDArray[np.int64]) -> Body:
        """Return a surface of vertices (V, 3) whose triangles (T, 3) turn anticlockwise, seen from outside."""
        a, b, c = (vertices_mm[triangles[:, n]] for n in range(3))
        normals = np.zeros_like(vertices_mm)
        for n in range(3):
            np.add.at(normals, triangles[:, n], np.cross(b - a, c - a))
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
        return cls(vertices_mm.astype(np.float32), normals.astype(np.float32), triangles.astype(np.int32))


def joined(bodies: list[Body]) -> Body:
    """Return several bodies as one."""
    first = np.cumsum([0, *(len(one.vertices_mm) for one in bodies)])
    return Body(
        np.concatenate([one.vertices_mm for one in bodies]),
        np.concatenate([one.normals for one in bodies]),
        np.concatenate(
            [one.triangles + start for one, start in zip(bodies, first[:-1].astype(np.int32), strict=True)]
        ),
    )


def tube(points_mm: FloatArray, radii_mm: ArrayLike) -> Body:
    """Return a closed tube along a straight row of points (P, 3), each with its own radius."""
    inward = unit(points_mm[-1] - points_mm[0])
    radii = np.broadcast_to(np.asarray(radii_mm, dtype=np.float64), len(points_mm))
    points = np.concatenate([points_mm[:1], points_mm, points_mm[-1:]])
    return _turned(points, np.concatenate([[0.0], radii, [0.0]]), inward)


def ball(center_mm: ArrayLike, radius_mm: float, sides: int = SIDES) -> Body:
    """Return a ball about ``center_mm`` (3,) of so many meridians."""
    polar = np.linspace(0.0, np.pi, sides // 2 + 1)
    axis = np.array([0.0, 0.0, 1.0])
    points = np.asarray(center_mm) - radius_mm * np.cos(polar)[:, np.newaxis] * axis
    return _turned(points, radius_mm * np.sin(polar), axis, sides)


def ellipsoid(center_mm: ArrayLike, axes_mm: FloatArray, sides: int = SIDES) -> Body:
    """Return an ellipsoid whose half axes are the columns of ``axes_mm`` (3, 3)."""
    round_one = ball(np.zeros(3), 1.0, sides)
    axes = axes_mm if np.linalg.det(axes_mm) > 0 else -axes_mm  # else all would be turned inside out
    places = round_one.vertices_mm.astype(np.float64) @ axes.T + np.asarray(center_mm)
    return Body.of(places, round_one.triangles.astype(np.int64))


def moved(body: Body, matrix: FloatArray) -> Body:
    """Return a body in the coordinates to which a rigid ``matrix`` (4, 4) leads."""
    turn = matrix[:3, :3].T
    places, normals = body.vertices_mm @ turn + matrix[:3, 3], body.normals @ turn
    return Body(places.astype(np.float32), normals.astype(np.float32), body.triangles)


def box(center_mm: ArrayLike, size_mm: ArrayLike, turn_deg: float = 0.0) -> Body:
    """Return a box with sides (3,), turned about z; each face has corners of its own, so that edges are sharp."""
    c, s = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    faces = []
    for axis in range(3):
        for side in (-1.0, 1.0):
            out = side * np.eye(3)[axis]
            a = np.eye(3)[(axis + 1) % 3]
            b = np.cross(out, a)
            faces.append([out - a - b, out + a - b, out + a + b, out - a + b])
    corners = (np.array(faces).reshape(-1, 3) * np.asarray(size_mm) / 2) @ turn.T + np.asarray(center_mm)
    first = 4 * np.arange(6)[:, np.newaxis, np.newaxis]
    return Body.of(corners, (first + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3))


def specks(centers_mm: FloatArray, radius_mm: float) -> Body:
    """Return a small octahedron at each of the places (N, 3); six vertices each."""
    corners = np.concatenate([np.eye(3), -np.eye(3)])
    faces = np.array([[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2], [1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5]])
    count = len(centers_mm)
    return Body(
        (centers_mm[:, np.newaxis] + radius_mm * corners).reshape(-1, 3).astype(np.float32),
        np.tile(corners, (count, 1)).astype(np.float32),
        (6 * np.arange(count)[:, np.newaxis, np.newaxis] + faces).reshape(-1, 3).astype(np.int32),
    )


def _turned(points_mm: FloatArray, radii_mm: FloatArray, axis: FloatArray, sides: int = SIDES) -> Body:
    """Return rings about an axis, one a point, joined to a closed surface."""
    a, b = axes_across(axis)
    angle = 2 * np.pi * np.arange(sides) / sides
    ring = np.cos(angle)[:, np.newaxis] * a + np.sin(angle)[:, np.newaxis] * b
    vertices = (points_mm[:, np.newaxis] + radii_mm[:, np.newaxis, np.newaxis] * ring).reshape(-1, 3)
    here = np.arange(sides)
    one = np.stack([here, (here + 1) % sides, here + sides], axis=-1)
    other = np.stack([(here + 1) % sides, (here + 1) % sides + sides, here + sides], axis=-1)
    band = np.concatenate([one, other])
    return Body.of(vertices, np.concatenate([band + sides * n for n in range(len(points_mm) - 1)]))
