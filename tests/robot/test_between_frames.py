"""Where what is recorded was between the frames of its recording."""

import numpy as np

from ronnaplan.robot.between_frames import earlier, moving, within
from ronnaplan.robot.twists import motion, twist
from ronnaplan.transforms import exponential, invert, rigid
from tests.robot.test_hand_eye_late import along


def test_a_steady_motion_is_told_between_its_frames() -> None:
    """About one axis and along it: half a frame earlier is half a step back, also where frames are left out."""
    frames = [0, 1, 3, 4, 7, 8, 9]
    step = motion(np.array([0.0, 0.0, 0.02, 0.0, 0.0, 3.0]))
    way = np.array([np.linalg.matrix_power(step, frame) for frame in frames])
    inside = within(frames, 0.5)
    assert inside.tolist() == [1, 2, 3, 4, 5, 6]
    back = invert(way) @ earlier(way, 0.5, frames)
    np.testing.assert_allclose(twist(back)[inside], [[0.0, 0.0, -0.01, 0.0, 0.0, -1.5]] * 6, atol=1e-9)


def test_a_motion_is_what_its_twist_says() -> None:
    moved = rigid(exponential(np.array([0.1, -0.7, 0.4])), np.array([10.0, -20.0, 3.0]))
    np.testing.assert_allclose(motion(twist(moved)), moved, atol=1e-12)


def test_frames_numbered_by_times_tell_the_same_however_long_ago_time_began() -> None:
    """From 2^53 on successive numbers became one, and all was NaN or ended in a traceback."""
    driven = along(1, 22, 0.1)[1]
    (added, unit), (of_late, unit_of_late) = (
        moving(driven, np.ones(6), range(first, first + 22)) for first in (0, 2**60)
    )
    assert (unit, added.tolist()) == (unit_of_late, of_late.tolist())
