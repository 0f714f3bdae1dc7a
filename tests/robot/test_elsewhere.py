"""Whether robot and tracker stand to each other as when the tool was calibrated."""

from dataclasses import replace

import numpy as np
import pytest

from ronnaplan.errors import RefusedError
from ronnaplan.pose import Pose
from ronnaplan.robot.chain import OTS, TCP, Capture, M, R
from ronnaplan.robot.elsewhere import elsewhere
from ronnaplan.transforms import exponential, rigid


def pose(seed: int, far_mm: float) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rigid(exponential(rng.normal(size=3)), far_mm * rng.normal(size=3))


SEEN, TOOL, DRIVEN = pose(1, 900.0), pose(2, 100.0), pose(3, 500.0)


def capture(seen: np.ndarray = SEEN, driven: np.ndarray = DRIVEN) -> Capture:
    return Capture(Pose.exact(seen, OTS, M), Pose.exact(TOOL, M, TCP), Pose.exact(driven, R, TCP))


def test_what_did_not_move_is_not_told_and_what_did_is() -> None:
    base = capture().robot_from_ots
    assert elsewhere(capture(), base) == ()
    moved = DRIVEN.copy()
    moved[:3, 3] += (2.0, 0.0, 0.0)
    assert elsewhere(capture(driven=moved), base) == ()
    moved[:3, 3] += (0.0, 10.0, 0.0)
    (told,) = elsewhere(capture(driven=moved), base)
    assert told.startswith(
        "robot and tracker stand 10 mm and 0.0 degrees otherwise to each other than in the hand"
    )


def test_a_mistake_that_explains_it_is_refused_as_that_mistake() -> None:
    base = capture().robot_from_ots
    transposed, in_cm = SEEN.copy(), DRIVEN.copy()
    transposed[:3, :3] = SEEN[:3, :3].T
    in_cm[:3, 3] /= 10.0
    for taken, why in (
        (capture(seen=transposed), "in the tracker's poses the rotations are transposed"),
        (capture(driven=in_cm), "the robot's places are in cm; give all in mm"),
        (capture(seen=DRIVEN, driven=SEEN), "the tracker's and the robot's poses change places"),
    ):
        with pytest.raises(RefusedError, match=f"as in it if {why}"):
            elsewhere(taken, base)
    astray = replace(base, matrix=pose(4, 700.0))
    (told,) = elsewhere(capture(), astray)
    assert told.endswith("if neither was moved since, recordings are mixed up or not in mm")
