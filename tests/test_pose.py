"""Poses: the frames they join and the covariance they carry."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import RigidTransform, Rotation

from ronnaplan.errors import FrameMismatchError, InputError, RonnaplanError
from ronnaplan.geometry import Frame
from ronnaplan.pose import Pose, as_pose, as_poses

A, B, C = Frame("A"), Frame("B"), Frame("C")


def random_pose(rng: np.random.Generator, to: Frame, origin: Frame, scale: float = 1e-3) -> Pose:
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.random(rng=rng).as_matrix()
    matrix[:3, 3] = rng.normal(size=3) * 200
    factor = rng.normal(size=(6, 6)) * np.repeat([scale, scale * 100], 3)[:, None]
    return Pose(matrix, factor @ factor.T, to, origin)


def samples(rng: np.random.Generator, pose: Pose, count: int) -> np.ndarray:
    xi = rng.multivariate_normal(np.zeros(6), pose.covariance, count)
    return RigidTransform.from_exp_coords(xi).as_matrix() @ pose.matrix


def test_composition_and_inversion_carry_covariance_as_sampling_does() -> None:
    rng = np.random.default_rng(3)
    a_from_b, b_from_c = random_pose(rng, A, B), random_pose(rng, B, C)
    point = np.array([[30.0, -50, 80]])
    sampled = samples(rng, a_from_b, 20000) @ samples(rng, b_from_c, 20000)
    image = (sampled @ np.append(point[0], 1.0))[:, :3]
    scatter = np.cov(image.T)
    predicted = (a_from_b @ b_from_c).point_covariances(point)[0]
    assert np.abs(predicted - scatter).max() < 0.05 * np.trace(scatter)
    back = (np.linalg.inv(samples(rng, a_from_b, 20000)) @ np.append(point[0], 1.0))[:, :3]
    scatter = np.cov(back.T)
    assert np.abs(a_from_b.inverse().point_covariances(point)[0] - scatter).max() < 0.05 * np.trace(scatter)


@settings(max_examples=30)
@given(seed=st.integers(0, 2**32 - 1))
def test_there_and_back_is_the_same_pose(seed: int) -> None:
    pose = random_pose(np.random.default_rng(seed), A, B)
    again = pose.inverse().inverse()
    np.testing.assert_allclose(again.matrix, pose.matrix, atol=1e-9)
    np.testing.assert_allclose(again.covariance, pose.covariance, atol=1e-9)
    assert (again.to_frame, again.from_frame) == (A, B)


def test_points_keep_their_own_error() -> None:
    pose = Pose.exact(np.eye(4), A, B)
    own = np.diag([0.1, 0.2, 0.3])[None]
    np.testing.assert_allclose(pose.point_covariances([[1, 2, 3]], own), own)


def test_one_error_may_be_stated_for_all_points() -> None:
    pose, own = random_pose(np.random.default_rng(5), A, B), np.diag([0.1, 0.2, 0.3])
    places = np.random.default_rng(6).normal(size=(4, 3)) * 50
    np.testing.assert_array_equal(
        pose.point_covariances(places, own), pose.point_covariances(places, np.tile(own, (4, 1, 1)))
    )


@pytest.mark.parametrize(
    ("errors", "says"),
    [
        (np.ones(3), r"shape \(3,\)"),  # was multiplied as one row for all
        (np.tile(np.eye(3), (1, 1, 1)), r"shape \(1, 3, 3\); expected \(3, 3\) or \(4, 3, 3\)"),
        (np.tile(np.eye(3), (3, 1, 1)), r"shape \(3, 3, 3\)"),
        (-np.eye(3), "not symmetric and positive"),
        (np.full((3, 3), np.nan), "not finite"),
        ("small", "not numbers"),
    ],
)
def test_errors_of_points_that_are_none_are_refused(errors: Any, says: str) -> None:
    with pytest.raises(InputError, match=says):
        random_pose(np.random.default_rng(5), A, B).point_covariances(np.zeros((4, 3)), errors)


@pytest.mark.parametrize(
    ("matrix", "covariance", "says"),
    [
        (np.eye(3), np.eye(6), r"shape \(3, 3\)"),
        (2 * np.eye(4), np.eye(6), "bottom row"),
        (np.diag([2.0, 2, 2, 1]), np.eye(6), "not rigid"),
        (np.full((4, 4), np.nan), np.eye(6), "not finite"),
        (np.eye(4), np.eye(3), r"shape \(3, 3\); expected \(6, 6\)"),
        (np.eye(4), -np.eye(6), "not symmetric and positive"),
        (np.eye(4), np.triu(np.ones((6, 6))), "not symmetric and positive"),
        (np.eye(4), np.full((6, 6), np.inf), "not finite"),
        (np.eye(4), np.eye(6) + 0j, "complex"),
    ],
)
def test_a_pose_that_is_none_or_whose_covariance_is_none_is_refused_where_it_is_made(
    matrix: np.ndarray, covariance: np.ndarray, says: str
) -> None:
    with pytest.raises(InputError, match=says):
        Pose(matrix, covariance, A, B)


def test_a_pose_keeps_what_it_was_given() -> None:
    matrix, covariance = np.eye(4), np.eye(6)
    pose = Pose(matrix, covariance, A, B)
    matrix[0, 3], covariance[0, 0] = 5.0, 7.0
    assert (pose.translation_mm[0], pose.covariance[0, 0]) == (0.0, 1.0)


def test_frames_must_meet() -> None:
    rng = np.random.default_rng(0)
    with pytest.raises(FrameMismatchError):
        random_pose(rng, A, B) @ random_pose(rng, C, A)
    with pytest.raises(FrameMismatchError):
        random_pose(rng, A, B).apply([[0, 0, 0]], A)


@pytest.mark.parametrize(
    ("matrix", "says"),
    [
        (np.diag([-1.0, 1, 1, 1]), "left-handed"),
        (np.full((4, 4), np.nan), "not finite"),
        (np.diag([1.1, 1, 1, 1]), "not rigid"),
        (np.eye(3), "shape"),
        ([["a"] * 4] * 4, "numbers"),
        (np.eye(4) + np.eye(4, k=-3) * 50, "bottom row"),
    ],
)
def test_what_is_no_pose_is_named(matrix: object, says: str) -> None:
    with pytest.raises(InputError, match=says):
        as_pose(matrix, "pose 7")  # type: ignore[arg-type]


def test_a_pose_printed_with_five_digits_is_made_a_rotation() -> None:
    printed = np.eye(4)
    printed[:3, :3] = np.round(Rotation.from_rotvec([0.3, 0.4, -0.7]).as_matrix(), 5)
    rotation = as_pose(printed)[:3, :3]
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-14)


def test_many_poses_are_taken_as_each_alone_and_the_first_that_is_none_is_named() -> None:
    printed = np.round([random_pose(np.random.default_rng(seed), A, B).matrix for seed in range(8)], 5)
    np.testing.assert_allclose(as_poses(printed, "pose"), [as_pose(one) for one in printed], atol=1e-12)
    for spoil in (
        np.diag([-1.0, 1, 1, 1]),
        np.diag([1.001, 1, 1, 1]),
        np.diag([1.0, 1, 1, np.nan]),
        2 * np.eye(4),
    ):
        wrong = printed.copy()
        wrong[5:7] = printed[5:7] @ spoil
        with pytest.raises(InputError, match="pose 5 "):
            as_poses(wrong, "pose")
    with pytest.raises(InputError, match=r"pose 0 has shape \(3, 4\)"):
        as_poses(printed[:, :3], "pose")
    assert as_poses(np.zeros((0, 4, 4)), "pose").shape == (0, 4, 4)


def test_a_frame_that_is_only_a_name_is_refused_where_the_pose_is_made() -> None:
    name: Any = "R"
    with pytest.raises(RonnaplanError, match=r"give Frame\(\.\.\.\)"):
        Pose.exact(np.eye(4), name, B)


def test_a_pose_tells_what_it_is_and_refuses_a_product_with_what_is_none() -> None:
    matrix = np.eye(4)
    matrix[:3] = np.array([[0, -1, 0, 10], [1, 0, 0, -20], [0, 0, 1, 30.5]])
    pose = Pose(matrix, np.diag([1e-2] * 3 + [0.03] * 3) * [0, 0, 0, 1, 1, 1], A, B)
    told = "turned by 90.0 degrees, moved by (10.0, -20.0, 30.5) mm, error at that place 0.3 mm RMS"
    assert repr(pose) == f"Pose(A from B: {told})"
    other: Any = matrix
    with pytest.raises(RonnaplanError, match=r"map points by apply; make a matrix a Pose\.exact"):
        pose @ other
