"""From which pose of a hand-eye recording on something stands otherwise."""

import numpy as np
import pytest

from ronnaplan.errors import RefusedError
from ronnaplan.robot.hand_eye import calibrate_hand_eye
from ronnaplan.robot.hand_eye_fit import design_of
from ronnaplan.robot.hand_eye_start import closed_form, discrepancies
from ronnaplan.robot.hand_eye_step import Step, step_in
from ronnaplan.transforms import exponential, invert, rigid
from tests.long import few_or_all
from tests.robot.test_orientation import hand_eye_poses

SLIPPED = rigid(exponential(np.radians([0.0, 1.0, 0.5])), np.array([2.0, 0, 2]))


def step_of(seen: np.ndarray, driven: np.ndarray) -> Step | None:
    """The step that a calibration tells, without its covariance, which takes a hundred times as long."""
    left, right = closed_form(seen, driven)
    return step_in(discrepancies(seen, driven, left, right), design_of(seen, right, np.ones(6)))


@pytest.mark.parametrize("first", [6, 20, 35])
@pytest.mark.parametrize("of_tool", [False, True])
def test_what_moved_partway_is_told_from_its_first_pose_on(first: int, of_tool: bool) -> None:
    """The poses agreed to 0.6 degrees and 2 mm RMS, which the document told, and nothing else."""
    seen, driven, *_ = hand_eye_poses(7, 40, 1e-3, 0.2)
    if of_tool:
        seen[first:] = seen[first:] @ SLIPPED
    else:
        seen[first:, :3, 3] += (3.0, 0, 2)
    assert step_of(seen, driven) == Step(first, of_tool)


def test_a_calibration_tells_the_step_by_the_frame_of_its_first_pose() -> None:
    seen, driven, *_ = hand_eye_poses(7, 40, 1e-3, 0.2)
    seen[20:] = seen[20:] @ SLIPPED
    seen[2] = seen[1]  # told again, and left out, but the frames count
    found = calibrate_hand_eye(seen, driven, frames=range(100, 140))
    assert found.step == Step(20, of_tool=True)
    assert found.step.told(range(100, 140)).startswith("from frame 120 on M stands otherwise on the tool")
    still = Step(20, of_tool=False).told(range(100, 140))
    assert still.startswith("from frame 120 on robot and tracker stand otherwise to each other")


def test_what_moved_so_far_that_all_is_refused_is_told_as_well() -> None:
    seen, driven, *_ = hand_eye_poses(7, 40, 1e-3, 0.2)
    seen[20:, :3, 3] += 30.0
    with pytest.raises(
        RefusedError, match=r"12.* mm RMS, .*: from frame 120 on robot and tracker stand otherwise"
    ):
        calibrate_hand_eye(seen, driven, frames=range(100, 140))


@few_or_all("cases", 3, 10)
@pytest.mark.parametrize("walks", [False, True])
def test_noise_and_drift_are_no_movement(walks: bool, cases: int) -> None:
    """They leave much whatever step is taken from them."""
    assert step_of(*hand_eye_poses(7, 40, 1e-3, 0.2)[:2]) is None
    for seed in range(cases):
        seen, driven, *_ = hand_eye_poses(seed, 40, 1e-3, 0.2)
        rng = np.random.default_rng(seed)
        drift = np.linspace(-1, 1, 40)[:, None] * np.array([3.0, 0, 1])
        seen[:, :3, 3] += np.cumsum(0.2 * rng.normal(size=(40, 3)), axis=0) if walks else drift
        assert step_of(seen, driven) is None


def poses_of(rotations: np.ndarray, places_mm: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Exact poses of tracker and robot, whose TCP is turned by ``rotations`` (N, 3, 3)."""
    _, _, m_from_tcp, robot_from_ots = hand_eye_poses(1, 4, 0.0, 0.0)
    driven = rigid(rotations, places_mm)
    return invert(robot_from_ots) @ driven @ invert(m_from_tcp), driven


@few_or_all("cases", 4, 10)
def test_drift_while_one_axis_is_turned_after_the_other_is_no_movement(cases: int) -> None:
    """A step left less than 0.4 of it in every second recording, as either half tells only a part of the poses."""
    turns = np.zeros((40, 3))
    turns[:20, 0] = turns[20:, 1] = np.linspace(-0.6, 0.6, 20)
    for seed in range(cases):
        rng = np.random.default_rng(seed)
        seen, driven = poses_of(exponential(turns), 200 * rng.normal(size=(40, 3)))
        drift = np.linspace(-1, 1, 40)[:, None] * rng.normal(size=6) + rng.normal(size=(40, 6)) / 16
        seen = seen @ rigid(exponential(np.radians(drift[:, :3])), 4 * drift[:, 3:])
        assert step_of(seen, driven) is None


@few_or_all("cases", 2, 5)
@pytest.mark.parametrize("of_tool", [False, True])
def test_which_of_both_moved_is_not_guessed_where_the_arm_then_rests(of_tool: bool, cases: int) -> None:
    """Every fourth such movement was told to be of the other."""
    rng = np.random.default_rng(5)
    turns = 0.5 * rng.normal(size=(40, 3))
    turns[20:] = turns[20] + 0.005 * rng.normal(size=(20, 3))
    places_mm = 200 * rng.normal(size=(40, 3))
    places_mm[20:] = places_mm[20]
    for _ in range(cases):
        seen, driven = poses_of(exponential(turns), places_mm)
        if of_tool:
            seen[20:] = seen[20:] @ SLIPPED
        else:
            seen[20:, :3, 3] += (3.0, 0, 2)
        seen = seen @ rigid(exponential(1e-3 * rng.normal(size=(40, 3))), 0.2 * rng.normal(size=(40, 3)))
        assert step_of(seen, driven) == Step(20, of_tool=None)
    assert "from frame 20 on tool, base or tracker stands otherwise" in Step(20, of_tool=None).told(range(40))


def test_flange_turned_in_two_postures_of_the_arm_is_no_movement() -> None:
    """The poses of either leave open by what R from OTS would have changed between the two."""
    rng, turns = np.random.default_rng(3), np.zeros((40, 3))
    turns[:, 0] = np.tile(np.linspace(-0.6, 0.6, 20), 2)
    postures = exponential(np.array([[0, 0, 0], [0, 0.7, 0]]))
    seen, driven = poses_of(np.repeat(postures, 20, axis=0) @ exponential(turns), 200 * rng.normal(size=(40, 3)))
    for noise_mm in (0.0, 0.2):
        seen[:, :3, 3] += noise_mm * rng.normal(size=(40, 3))
        assert step_of(seen, driven) is None
    seen[26:, :3, 3] += (0, 3.0, 3)
    assert step_of(seen, driven) == Step(26, of_tool=False)
