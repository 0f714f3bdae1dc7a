"""The bodies of the 3-D view are closed, of their size, and their triangles turn the right way round."""

from __future__ import annotations

import numpy as np
import pytest

from ronnaplan.scene.shapes import Body, ball, joined, specks, tube


def volume_mm3(body: Body) -> float:
    """By the divergence theorem: positive only if the triangles turn anticlockwise, seen from outside."""
    a, b, c = (body.vertices_mm[body.triangles[:, n]].astype(np.float64) for n in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


def test_a_ball_has_its_volume_place_and_normals() -> None:
    center = np.array([40.0, -20.0, 900.0])
    body = ball(center, 5.0)
    assert volume_mm3(body) == pytest.approx(4 / 3 * np.pi * 125, rel=0.08)
    offsets = body.vertices_mm - center
    assert np.linalg.norm(offsets, axis=1) == pytest.approx(5.0, abs=1e-3)
    ring = np.abs(offsets[:, 2]) < 4.9
    assert np.einsum("ij,ij->i", offsets, body.normals)[ring].min() > 4.7


def test_a_tube_has_its_volume_and_may_widen() -> None:
    ends = np.array([[0.0, 0.0, 0.0], [10.0, 20.0, 20.0]])
    polygon = np.sin(np.pi / 8) / (np.pi / 8)  # 16 sides in the place of a circle
    assert volume_mm3(tube(ends, 2.0)) == pytest.approx(np.pi * 4 * 30 * polygon, rel=1e-3)
    cone = np.pi * 30 / 3 * (1 + 3 + 9) * polygon
    assert volume_mm3(tube(ends, [1.0, 3.0])) == pytest.approx(cone, rel=0.02)


def test_bodies_joined_keep_their_volume() -> None:
    places = np.array([[0.0, 0.0, 0.0], [10.0, 0.0, 0.0], [0.0, 30.0, 0.0]])
    assert volume_mm3(specks(places, 1.5)) == pytest.approx(3 * 4 / 3 * 1.5**3, rel=1e-5)
    both = joined([ball(places[1], 2.0), ball(places[2], 3.0)])
    assert volume_mm3(both) == pytest.approx(volume_mm3(ball(places[1], 2.0)) + volume_mm3(ball(places[2], 3.0)))
