"""Which poses of a hand-eye calibration are far off what the others say."""

from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ronnaplan.errors import InputError, RefusedError
from ronnaplan.robot.hand_eye import calibrate_hand_eye
from ronnaplan.robot.hand_eye_start import far_off
from ronnaplan.transforms import invert
from tests.long import few_and_others, few_or_all
from tests.robot.test_orientation import hand_eye_poses, matrix

MISREAD: list[tuple[str, Callable[[Rotation], Rotation]]] = [
    ("the rotations are transposed", lambda turns: turns.inv()),
    ("the scalar is .* first number", lambda turns: Rotation.from_quat(turns.as_quat(scalar_first=True))),
    ("the scalar is .* last number", lambda turns: Rotation.from_quat(turns.as_quat(), scalar_first=True)),
    ("the angles about Z and X", lambda turns: Rotation.from_euler("ZYX", turns.as_euler("ZYX")[:, ::-1])),
    ("angles about X, Y and Z are", lambda turns: Rotation.from_euler("XYZ", turns.as_euler("ZYX"))),
    ("angles about X, Y and Z are", lambda turns: Rotation.from_euler("ZYX", turns.as_euler("XYZ"))),
    ("axes that turn along are", lambda turns: Rotation.from_euler("zyx", turns.as_euler("ZYX"))),
    ("axes that turn along are", lambda turns: Rotation.from_euler("XYZ", turns.as_euler("xyz"))),
    ("axes that turn along are", lambda turns: Rotation.from_euler("xyz", turns.as_euler("XYZ"))),
]
"""What a program may do to the right turns, as to those of KUKA, Staubli and Fanuc, and a few words of what is told."""


def spoilt(seen: np.ndarray, which: list[int], far_mm: float, turn_deg: float) -> np.ndarray:
    """Return poses of which some are moved and turned, each to another side."""
    rng, wrong = np.random.default_rng(len(which)), seen.copy()
    sides = rng.normal(size=(2, len(which), 3))
    sides /= np.linalg.norm(sides, axis=2, keepdims=True)
    wrong[which, :3, :3] = Rotation.from_rotvec(np.radians(turn_deg) * sides[0]).as_matrix() @ wrong[which, :3, :3]
    wrong[which, :3, 3] += far_mm * sides[1]
    return wrong


@few_and_others(("far_mm", "turn_deg"), [(0.0, 2.0), (20.0, 5.0)], [(5.0, 0.0), (20.0, 0.0)])
@few_and_others(("count", "which"), [(20, [0, 5, 6, 19]), (40, [3, 9, 20, 33])], [(20, [2])])
def test_poses_that_are_far_off_are_named_and_no_others(
    count: int, which: list[int], far_mm: float, turn_deg: float
) -> None:
    """They draw least squares towards them, by which right ones were named as well, or wrong ones were not."""
    seen, driven, *_ = hand_eye_poses(7, count, 1e-3, 0.2)
    assert calibrate_hand_eye(spoilt(seen, which, far_mm, turn_deg), driven).far == tuple(which)


@few_or_all("cases", 10, 30)
def test_no_pose_of_a_tracker_that_errs_most_in_depth_is_far_off(cases: int) -> None:
    """Of these 30 recordings five named a pose: six deviations of all axes together were three of the depth."""
    for seed in range(cases):
        seen, driven, *_ = hand_eye_poses(seed, 40, 1e-3, 0.2)
        seen[:, 2, 3] += np.random.default_rng(seed).normal(size=40)
        assert not far_off(seen, driven).any()


@pytest.mark.parametrize(("far_mm", "turn_deg"), [(50.0, 0.0), (0.0, 20.0)])
def test_poses_for_which_all_is_refused_are_named(far_mm: float, turn_deg: float) -> None:
    """By their frames, in which one that the tracker told again counts."""
    seen, driven, *_ = hand_eye_poses(7, 40, 1e-3, 0.2)
    wrong = spoilt(seen, [3, 9, 10, 33], far_mm, turn_deg)
    wrong[8] = wrong[7]
    told = r"4 of 39 poses are far off .* \(frames 103, 109-110, 133\); .* leave them out of the recording$"
    with pytest.raises(RefusedError, match=told):
        calibrate_hand_eye(wrong, driven, frames=range(100, 140))


def test_which_half_of_a_recording_is_wrong_is_not_guessed() -> None:
    """As where the tracker was moved meanwhile."""
    seen, driven, *_ = hand_eye_poses(7, 40, 1e-3, 0.2)
    either = r"frames 24-39\); look .* and record anew: of so many"
    for moved, told in ((20, "10: from frame 20 on robot and tracker stand otherwise"), (16, either)):
        wrong = seen.copy()
        wrong[-moved:] = matrix(np.random.default_rng(2), 100) @ seen[-moved:]
        with pytest.raises(RefusedError, match=told):
            calibrate_hand_eye(wrong, driven)


def test_frames_that_do_not_number_the_poses_are_refused() -> None:
    seen, driven, *_ = hand_eye_poses(7, 8, 1e-3, 0.2)
    with pytest.raises(InputError, match="2 frames were given for 8 poses"):
        calibrate_hand_eye(seen, driven, frames=[1, 2])


@pytest.mark.parametrize("which", ["tracker", "robot"])
def test_one_recording_the_other_way_round_is_told(which: str) -> None:
    seen, driven, *_ = hand_eye_poses(7, 40, 1e-3, 0.2)
    given = (invert(seen), driven) if which == "tracker" else (seen, invert(driven))
    with pytest.raises(
        RefusedError,
        match=r"contradict each other .*, but agree if in the tracker's poses or the robot's poses each is inverted;",
    ):
        calibrate_hand_eye(*given)
    with pytest.raises(RefusedError, match=r"10; record both at the same moments"):
        calibrate_hand_eye(seen, driven[::-1])


@pytest.mark.parametrize("wrong", ["columns", "mirrored"])
def test_places_that_are_written_otherwise_than_the_angles_are_told_as_such(wrong: str) -> None:
    """They were said to be of other moments."""
    seen, driven, *_ = hand_eye_poses(7, 40, 1e-3, 0.2)
    if wrong == "columns":
        driven[:, :3, 3] = driven[:, [1, 0, 2], 3]
    else:
        mirror = np.diag([1.0, 1, -1, 1])
        seen = mirror @ seen @ mirror
    with pytest.raises(RefusedError, match=r": the angles agree, and the places do not; check columns, signs"):
        calibrate_hand_eye(seen, driven)


@few_and_others("whose", ["the robot's poses", "the poses of both"], ["the tracker's poses"])
@pytest.mark.parametrize(("mistake", "read"), MISREAD)
def test_rotations_that_were_misread_are_told_as_such(
    whose: str, mistake: str, read: Callable[[Rotation], Rotation]
) -> None:
    """They were said to be of other moments."""
    seen, driven, *_ = hand_eye_poses(7, 40, 1e-3, 0.2)
    for poses, other in ((seen, "the robot's poses"), (driven, "the tracker's poses")):
        if whose != other:
            poses[:, :3, :3] = read(Rotation.from_matrix(poses[:, :3, :3])).as_matrix()
    with pytest.raises(RefusedError, match=f"but agree if in {whose} {mistake}"):
        calibrate_hand_eye(seen, driven)


def test_of_poses_about_one_place_all_mistakes_that_explain_them_are_told() -> None:
    """Those of the robot were said to be inverted, though only their rotations were misread."""
    _, driven, m_from_tcp, robot_from_ots = hand_eye_poses(7, 40, 0.0, 0.0)
    driven[:, :3, 3] = driven[0, :3, 3]
    seen = invert(robot_from_ots) @ driven @ invert(m_from_tcp)
    turns = Rotation.from_matrix(driven[:, :3, :3])
    driven[:, :3, :3] = Rotation.from_quat(turns.as_quat(scalar_first=True)).as_matrix()
    told = "each is inverted, or in the robot's poses the rotations are .*, or in the robot's poses the scalar .* first"
    with pytest.raises(RefusedError, match=told):
        calibrate_hand_eye(seen, driven)


def test_a_tracker_that_saw_next_to_no_turn_is_refused_as_such() -> None:
    """As of radians that were taken for degrees; it ended in a singular matrix."""
    seen, driven, *_ = hand_eye_poses(7, 40, 1e-3, 0.2)
    turns = Rotation.from_matrix(seen[:, :3, :3])
    seen[:, :3, :3] = Rotation.from_rotvec(np.radians(turns.as_rotvec())).as_matrix()
    with pytest.raises(InputError, match=r"the tracker poses do not determine M from TCP: .* radians"):
        calibrate_hand_eye(seen, driven)
