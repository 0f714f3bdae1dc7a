"""Whatever poses are recorded, few, still or without any noise, they calibrate a tool and an eye, or are refused."""

from __future__ import annotations

from contextlib import suppress

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ronnaplan.errors import InputError, RonnaplanError
from ronnaplan.robot.hand_eye import calibrate_hand_eye
from ronnaplan.robot.pivot import calibrate_pivot
from tests.long import few_and_others
from tests.robot.test_orientation import hand_eye_poses


@pytest.mark.parametrize("seed", range(30))
def test_any_poses_are_answered_or_refused(seed: int) -> None:
    generator = np.random.default_rng([seed, 10])
    count = int(generator.integers(2, 40))
    vectors = generator.standard_normal((count, 3)) * generator.choice([0.0, 0.01, 0.3, 2.0])
    if seed % 3 == 0:
        vectors[:, :2] = 0.0
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, :3, :3] = Rotation.from_rotvec(vectors).as_matrix()
    tip_mm = generator.standard_normal(3) * generator.choice([0.0, 150.0, 1e5])
    poses[:, :3, 3] = (
        (0, 0, -900)
        - poses[:, :3, :3] @ tip_mm
        + generator.choice([0.0, 0.1]) * generator.standard_normal((count, 3))
    )
    with suppress(RonnaplanError):
        assert np.isfinite(calibrate_pivot(poses).tip_covariance_mm2).all()
    with suppress(RonnaplanError):
        calibrate_hand_eye(poses, poses)


@pytest.mark.parametrize("seed", [*range(20), 3047])  # of the last round-off leaves the fit no freedom
def test_poses_that_do_not_belong_together_are_refused(seed: int) -> None:
    generator = np.random.default_rng([seed, 77])
    count = int(generator.integers(4, 8))

    def poses() -> NDArray[np.float64]:
        drawn = np.tile(np.eye(4), (count, 1, 1))
        vectors = generator.normal(size=(count, 3)) * generator.choice([0.02, 0.5, 2])
        drawn[:, :3, :3] = Rotation.from_rotvec(vectors).as_matrix()
        drawn[:, :3, 3] = generator.normal(size=(count, 3)) * generator.choice([50, 500])
        return drawn

    with pytest.raises(RonnaplanError, match=r"contradict|do not determine"):
        calibrate_hand_eye(poses(), poses())


@few_and_others("count", [4, 40], [6])
@few_and_others("sds", [(1e-3, 0.0), (0.0, 0.2)], [(1e-3, 1e-5)])
def test_poses_whose_places_or_rotations_are_all_but_exact_calibrate_an_eye(
    count: int, sds: tuple[float, float]
) -> None:
    """As in recordings that are simulated: a traceback, or the poses were said to contradict each other."""
    seen, driven, m_from_tcp, _ = hand_eye_poses(count, count, *sds)
    found = calibrate_hand_eye(seen, driven).m_from_tcp
    assert np.isfinite(found.covariance).all()
    assert np.linalg.norm((found.matrix - m_from_tcp)[:3, 3]) < 3.0


def test_poses_that_are_exact_to_the_last_digit_calibrate_a_tool_and_an_eye() -> None:
    """As one tries it by hand: of quarter turns nothing is left, which ended in a traceback."""
    poses = np.tile(np.eye(4), (24, 1, 1))
    poses[:, :3, :3] = np.rint(Rotation.create_group("O").as_matrix())
    poses[:, :3, 3] = (0, 0, -1000) - poses[:, :3, :3] @ (10, 20, 30)
    np.testing.assert_allclose(calibrate_pivot(poses).tip_mm, (10, 20, 30), atol=1e-9)
    driven = poses[3] @ poses
    found = calibrate_hand_eye(poses, driven)
    np.testing.assert_allclose(found.m_from_tcp.matrix, np.eye(4), atol=1e-6)
    np.testing.assert_allclose(found.robot_from_ots.matrix, poses[3], atol=1e-6)
    assert not found.doubts


def test_recordings_in_metres_calibrate_no_eye() -> None:
    """Both in metres agree with each other: M from TCP came out a thousandth as long."""
    rng = np.random.default_rng(1)
    m_from_tcp, robot_from_ots = np.eye(4), np.eye(4)
    m_from_tcp[:3, 3], robot_from_ots[:3, 3] = (0.1, 0.0, 0.15), (1.0, 0.2, 0.5)
    seen = np.tile(np.eye(4), (20, 1, 1))
    seen[:, :3, :3] = Rotation.from_rotvec(rng.uniform(-0.5, 0.5, (20, 3))).as_matrix()
    seen[:, :3, 3] = rng.uniform((-0.1, -0.1, 1.4), (0.1, 0.1, 1.6), (20, 3))
    with pytest.raises(InputError, match=r"ots_from_m lies within .* as if it were in metres; expected mm"):
        calibrate_hand_eye(seen, robot_from_ots @ seen @ m_from_tcp)
