from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from phantoms.rays import unit_interval, visible_segments
from phantoms.solids import FloatArray, Solid, box, cone, cylinder, ellipsoid, half_space, sphere

SOLIDS = {
    "sphere": sphere((1, 2, 3), 11.5),
    "ellipsoid": ellipsoid((1, -2, 0), (3, 5, 9), Rotation.from_euler("xyz", [0.3, 0.5, 1.0]).as_matrix()),
    "cylinder": cylinder((0, 1, -4), (1, 2, 3), 9, 5),
    "box": box((2, 0, 1), (4, 7, 9), Rotation.from_euler("xyz", [1.0, 0.2, 0.4]).as_matrix()),
    "cone": cone((0, 0, -5), (0.2, -0.1, 1), 12, 9),
    "widening cone": cone((1, 0, -5), (0.2, 1, 1), 8, 3, 7),
    "half-space": half_space((0, 1, 0), (1, 1, 0.4)),
}


def chord(solid: Solid, origin: FloatArray, direction: FloatArray) -> tuple[float, float]:
    affine = solid.unit_from_world
    o, d = affine[:, :3] @ origin + affine[:, 3], affine[:, :3] @ direction
    return unit_interval(int(solid.shape), o[0], o[1], o[2], d[0], d[1], d[2], solid.top_ratio)


coordinates = st.floats(-6, 6)
points = st.tuples(coordinates, coordinates, coordinates).map(np.array)


@pytest.mark.parametrize("name", SOLIDS)
@settings(max_examples=60)
@given(origin=points, target=points)
def test_a_ray_is_inside_exactly_where_its_points_are(name: str, origin: FloatArray, target: FloatArray) -> None:
    direction = target - origin + 1e-3
    direction /= np.linalg.norm(direction)
    start, stop = chord(SOLIDS[name], origin, direction)
    steps = np.linspace(-30, 30, 2001)
    inside = SOLIDS[name].contains(origin + steps[:, np.newaxis] * direction)
    expected = (steps > start) & (steps < stop)
    edge = (np.abs(steps - start) < 1e-6) | (np.abs(steps - stop) < 1e-6)
    assert (inside == expected)[~edge].all()


@pytest.mark.parametrize("name", [name for name in SOLIDS if name != "half-space"])
def test_the_bounding_ball_holds_the_solid(name: str) -> None:
    solid = SOLIDS[name]
    cloud = np.random.default_rng(4).uniform(-20, 20, (200_000, 3))
    inside = cloud[solid.contains(cloud)]
    assert len(inside) > 100
    assert np.linalg.norm(inside - solid.center_mm, axis=1).max() <= solid.radius_mm + 1e-9


def test_chords_follow_when_solid_and_ray_are_moved() -> None:
    turn, shift = Rotation.from_euler("xyz", [0.4, -1.0, 2.0]).as_matrix(), np.array([5.0, -7.0, 11.0])
    origin, direction = np.array([0.5, 0.4, 0.3]), np.array([0.6, 0.0, 0.8])
    for solid in SOLIDS.values():
        before = chord(solid, origin, direction)
        after = chord(solid.moved(turn, shift), turn @ origin + shift, turn @ direction)
        assert after == pytest.approx(before, abs=1e-6)


def test_the_later_part_owns_an_overlap() -> None:
    starts, stops = np.array([0.0, 2.0, 3.0]), np.array([10.0, 6.0, 12.0])
    edges, owners = np.empty(6), np.empty(6, dtype=np.int64)
    count = visible_segments(starts, stops, 3, edges, owners)
    lengths = [sum(edges[s + 1] - edges[s] for s in range(count) if owners[s] == n) for n in range(3)]
    assert lengths == pytest.approx([2.0, 1.0, 9.0])
