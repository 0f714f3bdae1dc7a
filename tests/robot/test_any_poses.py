"""Whatever poses are recorded, few, still or without any noise, they calibrate a tool and an eye, or are refused."""

from __future__ import annotations

from contextlib import suppress

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ronnaplan.errors import RonnaplanError
from ronnaplan.robot.hand_eye import calibrate_hand_eye
from ronnaplan.robot.pivot import calibrate_pivot


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
    poses[:, :3, 3] = -poses[:, :3, :3] @ tip_mm + generator.choice([0.0, 0.1]) * generator.standard_normal(
        (count, 3)
    )
    with suppress(RonnaplanError):
        assert np.isfinite(calibrate_pivot(poses).tip_covariance_mm2).all()
    with suppress(RonnaplanError):
        calibrate_hand_eye(poses, poses)
