"""Hand-eye recordings whose tracker, or robot, tells poses of a moment that is over."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ronnaplan.errors import InputError, RefusedError
from ronnaplan.robot.hand_eye import calibrate_hand_eye
from ronnaplan.transforms import invert
from tests.long import few_and_others
from tests.robot.test_by_pose import HOME, RANGE, flange, normalized
from tests.robot.test_orientation import matrix


def along(
    seed: int, count: int, late: float, speed: float = 1.0, frames: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return poses of tracker and robot along a smooth way, M from TCP and R from OTS; the tracker is ``late``."""
    rng = np.random.default_rng(seed)
    tool, m_from_tcp, robot_from_ots = (matrix(rng, reach) for reach in (100, 100, 1000))
    rates, starts = rng.uniform(1, 3, 6) * speed, rng.uniform(0, 2 * np.pi, 6)
    times = np.arange(count) if frames is None else frames
    driven, true = (
        np.array([flange(HOME + RANGE * np.sin(rates * at / 10 + starts)) @ tool for at in moments])
        for moments in (times, times - late)
    )
    seen = invert(robot_from_ots) @ true @ invert(m_from_tcp)
    turns = Rotation.from_rotvec(np.radians(0.06) * rng.normal(size=(count, 3))).as_matrix()
    seen[:, :3, :3] = turns @ seen[:, :3, :3]
    seen[:, :3, 3] += 0.25 * rng.normal(size=(count, 3))
    return seen, driven, m_from_tcp, robot_from_ots


@few_and_others("late", [0.0, 0.1], [-0.1])
def test_a_tracker_or_robot_that_is_late_is_told_by_how_much_and_counted(late: float) -> None:
    """It was taken for noise, or, of half a frame, for a robot's recording exchanged for the tracker's."""
    seen, driven, m_from_tcp, _ = along(1, 22, late)
    found = calibrate_hand_eye(seen, driven)
    whose = "the tracker's" if late > 0 else "the robot's"
    told = [doubt for doubt in found.doubts if f"the poses fit far better if {whose} poses are 0." in doubt]
    assert (list(found.doubts), len(told)) == (told, late != 0)
    assert abs(found.by_pose.delay - late) < 4 * found.by_pose.delay_sd < 0.05
    assert normalized(found.m_from_tcp, m_from_tcp) < 3


def test_frames_that_are_missing_change_nothing_of_how_late_a_tracker_is() -> None:
    frames = np.flatnonzero(np.random.default_rng(0).uniform(size=30) < 0.7)
    seen, driven, *_ = along(2, len(frames), 0.2, 0.5, frames)
    found = calibrate_hand_eye(seen, driven, frames=frames.tolist())
    assert abs(found.by_pose.delay - 0.2) < 4 * found.by_pose.delay_sd < 0.05


def test_a_tracker_that_is_late_and_tells_distances_too_long_is_stated_as_sure_as_it_is() -> None:
    """R had a normalized error of 41: beside a delay nothing else was thought of that depends on the pose."""
    seen, driven, m_from_tcp, robot_from_ots = along(1, 22, 0.1)
    seen[:, :3, 3] *= 1.003
    found = calibrate_hand_eye(seen, driven)
    assert found.by_pose.of_delay > 0.99
    assert max(normalized(found.m_from_tcp, m_from_tcp), normalized(found.robot_from_ots, robot_from_ots)) < 4


def test_half_a_frame_of_delay_is_counted_in_the_base_as_it_is_and_makes_no_pose_far_off() -> None:
    """R had a normalized error of 9.6, and the first three poses were named as far off."""
    seen, driven, m_from_tcp, robot_from_ots = along(1, 30, 0.5, 0.6)
    found = calibrate_hand_eye(seen, driven)
    assert abs(found.by_pose.delay - 0.5) < 4 * found.by_pose.delay_sd < 0.01
    assert max(normalized(found.m_from_tcp, m_from_tcp), normalized(found.robot_from_ots, robot_from_ots)) < 2
    assert not found.far


@pytest.mark.parametrize(("seed", "speed"), [(9, 0.25), (5, 0.4), (11, 0.4)])
def test_two_frames_of_delay_are_told_anew_about_what_fits_then(seed: int, speed: float) -> None:
    """M and R had up to 13 and 14, as 1.7 frames were told first, and poses from before the recording were far off."""
    seen, driven, m_from_tcp, _ = along(seed, 60, 2.0, speed)
    found = calibrate_hand_eye(seen, driven)
    assert abs(found.by_pose.delay - 2.0) < 4 * found.by_pose.delay_sd < 0.03
    assert normalized(found.m_from_tcp, m_from_tcp) < 3
    assert not found.far


def test_poses_that_contradict_each_other_as_the_tracker_is_late_are_refused_as_that() -> None:
    """They were said to be of other moments, or turned into matrices wrongly."""
    seen, driven, *_ = along(1, 40, 0.6, 1.5)
    with pytest.raises(RefusedError, match=r"would agree if the tracker's poses are 0\.[56].* frames late"):
        calibrate_hand_eye(seen, driven)
    with pytest.raises(InputError, match="frame 0 was given more than once"):
        calibrate_hand_eye(seen, driven, frames=[0, *range(39)])
