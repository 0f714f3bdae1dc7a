"""Matrices of rigid transforms do what their names say."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ronnaplan.transforms import (
    about,
    exponential,
    frame_along,
    invert,
    nearest_rotations,
    point_jacobian,
    rigid,
    transform_points,
)


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-6, 0.3, np.pi, 5.0])
def test_exponential_is_the_rotation_by_the_vector(angle: float) -> None:
    vector = angle * np.array([0.36, -0.48, 0.8])
    np.testing.assert_allclose(exponential(vector), Rotation.from_rotvec(vector).as_matrix(), atol=1e-14)


def test_the_nearest_rotation_of_a_mirror_image_is_no_reflection() -> None:
    given = Rotation.random(rng=np.random.default_rng(1)).as_matrix()
    np.testing.assert_allclose(nearest_rotations(1.5 * given), given, atol=1e-12)
    mirrored = nearest_rotations(given * [1, 1, -1])
    assert np.linalg.det(mirrored) == pytest.approx(1.0)


def test_a_movement_is_told_of_points_and_about_another_place_alike() -> None:
    rng = np.random.default_rng(2)
    points, place = rng.normal(size=(5, 3)) * 80.0, np.array([400.0, -30.0, 900.0])
    xi = np.array([1e-7, -2e-7, 3e-7, 1e-5, 0.0, -2e-5])
    moved = transform_points(rigid(exponential(xi[:3]), xi[3:]), points)
    np.testing.assert_allclose(moved - points, point_jacobian(points) @ xi, atol=1e-10)
    np.testing.assert_allclose(point_jacobian(points - place) @ (about(place) @ xi), moved - points, atol=1e-10)


def test_a_frame_points_along_its_direction_and_back() -> None:
    frame = frame_along(np.array([1.0, 2.0, 3.0]), np.array([0.0, -3.0, 4.0]))
    np.testing.assert_allclose(frame[:3, 2], [0.0, -0.6, 0.8])
    np.testing.assert_allclose(invert(frame) @ frame, np.eye(4), atol=1e-15)
