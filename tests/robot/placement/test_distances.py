"""Distances between bodies, against coal."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from ronnaplan.geometry import FloatArray
from ronnaplan.robot.placement.distances import box_box, segment_box, segment_point, segment_segment
from ronnaplan.robot.placement.room import Box
from ronnaplan.robot.placement.world import box_rows

coal: Any = pytest.importorskip("coal")


def placed(turn: FloatArray, at: FloatArray) -> Any:
    return coal.Transform3s(turn, at)


def capsule(row: FloatArray) -> tuple[Any, Any]:
    axis = row[3:6] - row[:3]
    length = float(np.linalg.norm(axis))
    z = axis / length
    x = np.cross(np.eye(3)[int(np.abs(z).argmin())], z)
    x /= np.linalg.norm(x)
    return coal.Capsule(row[6], length), placed(np.column_stack([x, np.cross(z, x), z]), row[:3] + axis / 2)


def box(one: Box) -> tuple[Any, Any]:
    c, s = np.cos(np.radians(one.turn_deg)), np.sin(np.radians(one.turn_deg))
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return coal.Box(*one.size_mm), placed(turn, np.array(one.center_mm))


def apart(one: tuple[Any, Any], other: tuple[Any, Any]) -> float:
    return float(coal.distance(*one, *other, coal.DistanceRequest(), coal.DistanceResult()))


def random_box(rng: np.random.Generator) -> Box:
    center, size = rng.uniform(-300, 300, 3), rng.uniform(20, 400, 3)
    return Box("box", tuple(center), tuple(size), float(rng.uniform(-180, 180)))


def test_distances_are_coals() -> None:
    rng = np.random.default_rng(1)
    for _ in range(400):
        one, other = (np.append(rng.uniform(-300, 300, 6), rng.uniform(5, 60)) for _ in range(2))
        near = segment_segment(one, other) - one[6] - other[6]
        told = apart(capsule(one), capsule(other))
        assert near == pytest.approx(told, abs=1e-3) if told > 1e-3 else near < 2e-3
        thing, wall = random_box(rng), random_box(rng)
        (row, wall_row) = box_rows([thing, wall])
        near, told = segment_box(one, row, np.inf) - one[6], apart(capsule(one), box(thing))
        assert near == pytest.approx(told, abs=1e-3) if told > 1e-3 else near < 2e-3
        near, told = box_box(row, wall_row), apart(box(thing), box(wall))
        assert near == pytest.approx(told, abs=1e-3) if told > 1e-3 else near < 2e-3


def test_segments_that_are_points_or_parallel() -> None:
    point, line = np.array([1.0, 2, 3, 1, 2, 3]), np.array([0.0, 0, 0, 10, 0, 0])
    assert segment_segment(point, line) == pytest.approx(np.hypot(2, 3))
    assert segment_segment(line, point) == pytest.approx(np.hypot(2, 3))
    assert segment_segment(point, point) == 0.0
    assert segment_segment(line, line + np.array([4.0, 3, 0, 4, 3, 0])) == pytest.approx(3)
    assert segment_segment(line, line + np.array([14.0, 3, 0, 14, 3, 0])) == pytest.approx(5)
    assert segment_point(line, np.array([-3.0, 4, 0])) == pytest.approx(5)
    assert segment_box(point, np.array([0.0, 0, 0, 5, 5, 5, 1, 0]), np.inf) == 0.0
