"""Poses out of recordings: which belong together, and where something that rested was, by poses or single spheres."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ronnaplan.errors import InputError, RefusedError
from ronnaplan.geometry import Frame, Points
from ronnaplan.robot.chain import OTS, M, R
from ronnaplan.robot.recorded import (
    locate_tool,
    require_numbered,
    require_robots,
    require_trackers,
    resting_matrix,
    robot_pose,
    seen_tool,
    simultaneous,
    tool_poses,
    uncounted,
)
from ronnaplan.tracking import PointReading, Recording, ToolReading

SPHERES = np.array([[0.0, 60, 0], [45, 0, 0], [0, -75, 0], [-90, 0, 0]])


def placed(seed: int) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.random(rng=np.random.default_rng(seed)).as_matrix()
    matrix[:3, 3] = (10, 20, -1500)
    return matrix


def recording(*frames: tuple[int, str, np.ndarray | None]) -> Recording:
    return Recording("r", tools=tuple(ToolReading(n, tool, pose) for n, tool, pose in frames))


def test_poses_are_paired_by_their_frame_and_no_other_way() -> None:
    first = tool_poses(recording((0, "a", placed(0)), (1, "a", None), (2, "a", placed(2)), (5, "a", placed(5))))
    second = tool_poses(recording((5, "a", placed(6)), (2, "a", placed(3))))
    frames, seen, driven = simultaneous(first, second)
    assert frames == (2, 5)
    np.testing.assert_array_equal(seen, [placed(2), placed(5)])
    np.testing.assert_array_equal(driven, [placed(3), placed(6)])
    with pytest.raises(InputError, match="share no frame number"):
        simultaneous({0: placed(0)}, {1: placed(1)})


def test_poses_of_a_table_that_was_sorted_otherwise_come_in_the_order_of_their_frames() -> None:
    """The memory of a tracker's noise is told from the order; shuffled poses were stated four times too surely."""
    mixed = recording((7, "a", placed(7)), (-1, "a", placed(1)), (3, "a", placed(3)))
    assert list(tool_poses(mixed)) == [-1, 3, 7]


def test_poses_that_are_only_counted_belong_to_no_others() -> None:
    require_numbered(Recording("r"))
    with pytest.raises(InputError, match=r"r does not number its poses; expected .* in a column 'frame'"):
        require_numbered(Recording("r", numbered=False))


def test_a_recording_that_tells_whose_it_is_is_not_taken_for_the_others() -> None:
    """Exchanged poses fit as well as others, and put the head anywhere."""
    exchanged = "the recordings of both the other way round"
    for name in ("ProbeToTracker", "TcpToPolarisTracker", "ToolToOTS"):
        require_trackers(recording((0, name, placed(0))))
        with pytest.raises(InputError, match=f"r holds poses of {name}, as a tracker tells them; .*{exchanged}"):
            require_robots(recording((0, name, placed(0))))
    for name in ("TcpToRobot", "FlangeToRobotBase", "TcpToBase", "TcpToR"):
        require_robots(recording((0, name, placed(0))))
        with pytest.raises(InputError, match=f"r holds poses of {name}, as the robot tells them; .*{exchanged}"):
            require_trackers(recording((0, name, placed(0))))
    for name in ("tool", "ProbeToReference", "Toto", "", "robot"):  # which say nothing
        require_trackers(recording((0, name, placed(0))))
        require_robots(recording((0, name, placed(0))))
    of_robot = Recording("r", tools=(ToolReading(0, "tool", placed(0)),), frame=R)
    require_robots(of_robot)
    with pytest.raises(InputError, match=f"r holds poses in the frame R, as the robot tells them; .*{exchanged}"):
        require_trackers(of_robot)
    require_trackers(Recording("r", tools=of_robot.tools, frame=Frame("Polaris")))
    seen = Recording("r", (PointReading(0, np.zeros(3)),) * 2, of_robot.tools)
    require_trackers(seen)
    with pytest.raises(InputError, match="r holds 2 readings of single spheres, as a tracker tells them"):
        require_robots(seen)


def test_places_without_a_rotation_are_told_what_they_lack() -> None:
    """As a KUKA's and a UR's own X, Y, Z beside angles, whose columns are not read."""
    places = Recording("r", (PointReading(0, np.zeros(3)), PointReading(1, np.ones(3))))
    with pytest.raises(
        InputError, match=r"2 points and no poses; .* a quaternion .*a KUKA's A, B, C or a UR's rx"
    ):
        tool_poses(places)


def test_a_tool_that_is_not_told_is_not_guessed() -> None:
    two = recording((0, "a", placed(0)), (0, "b", placed(1)))
    with pytest.raises(InputError, match="the tools a, b; name one"):
        tool_poses(two)
    assert list(tool_poses(two, "b")) == [0]
    with pytest.raises(InputError, match="no tool 'c'"):
        tool_poses(two, "c")
    with pytest.raises(InputError, match="two poses of a in frame 0; expected one, so give each moment a number"):
        tool_poses(recording((0, "a", placed(0)), (0, "a", placed(1))))
    missing = Recording("r", tools=(ToolReading(0, "", None, status="missing"),))
    with pytest.raises(
        InputError, match="no usable pose of the tool, most readings say 'missing'; record it again"
    ):
        tool_poses(missing)


def test_poses_in_metres_are_no_poses_in_mm() -> None:
    metres = [placed(n) for n in range(2)]
    for matrix in metres:
        matrix[:3, 3] /= 1000.0
    with pytest.raises(InputError, match=r"within 1\.5 mm of the origin in every pose, as if it were in metres"):
        tool_poses(recording((0, "a", metres[0]), (1, "a", metres[1])))


def test_what_moved_has_no_place() -> None:
    rest = placed(1)
    shifted = rest.copy()
    shifted[0, 3] += 2.0
    np.testing.assert_allclose(resting_matrix({0: rest, 1: rest}, "it"), rest, atol=1e-12)
    with pytest.raises(RefusedError, match=r"it moved while it was recorded: .*; let it rest$"):
        resting_matrix({0: rest, 1: shifted}, "it")


def test_a_tools_pose_has_the_error_of_its_spheres_readings() -> None:
    geometry = Points(SPHERES, np.tile(1e-10 * np.eye(3), (4, 1, 1)), tuple("ABCD"), M)
    rng = np.random.default_rng(0)
    true = placed(3)
    seen = SPHERES @ true[:3, :3].T + true[:3, 3]
    lever = np.array([[-15.0, 30, 180]])
    found = []
    for _ in range(300):
        noisy = seen + rng.normal(0, 0.17, seen.shape)
        turn, _ = Rotation.align_vectors(noisy - noisy.mean(0), SPHERES - SPHERES.mean(0))
        found.append(noisy.mean(0) + turn.apply(lever[0] - SPHERES.mean(0)))
    scatter = np.sqrt(np.trace(np.cov(np.array(found).T)))
    of_poses = seen_tool(recording((0, "a", true)), geometry)
    points = tuple(PointReading(0, place, "") for place in seen[::-1])
    of_spheres = seen_tool(Recording("r", points), geometry)
    for pose in (of_poses, of_spheres):
        np.testing.assert_allclose(pose.matrix, true, atol=1e-6)
        assert np.sqrt(np.trace(pose.point_covariances(lever)[0])) == pytest.approx(scatter, rel=0.1)


def test_a_tool_whose_spheres_lie_where_no_tool_s_do_is_refused() -> None:
    """Ten times as large it was stated to be seen three times as exactly."""
    at_rest = recording((0, "a", placed(0)))
    seen_tool(at_rest, Points.exact(5 * SPHERES, tuple("ABCD"), M))
    with pytest.raises(InputError, match=r"a sphere of the tool lies 900 mm from M; expected at most 800"):
        seen_tool(at_rest, Points.exact(10 * SPHERES, tuple("ABCD"), M))


def test_a_tool_of_which_nothing_errs_is_refused() -> None:
    """Its pose's error ended in a traceback of NumPy."""
    at_rest, exact = recording((0, "a", placed(3))), Points.exact(SPHERES, tuple("ABCD"), M)
    with pytest.raises(
        InputError, match="neither the tool's spheres nor their readings err as stated; state an error"
    ):
        seen_tool(at_rest, exact, sigma_mm=0.0)
    assert (np.linalg.eigvalsh(seen_tool(at_rest, exact, sigma_mm=1e-6).covariance) > 0).all()


def geometry_of(spheres: np.ndarray) -> Points:
    labels = tuple(f"S{k + 1}" for k in range(len(spheres)))
    return Points(spheres, np.tile(0.02**2 * np.eye(3), (len(spheres), 1, 1)), labels, M)


def among_others(spheres: np.ndarray, seed: int) -> tuple[Points, np.ndarray]:
    rng = np.random.default_rng(seed)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = Rotation.random(rng=rng).as_matrix(), (100, -50, -1500)
    seen = spheres @ pose[:3, :3].T + pose[:3, 3] + rng.normal(size=spheres.shape) * 0.1
    others = rng.uniform(-200, 200, (3, 3)) - (0, 0, 1500)
    everything = np.vstack([others, seen])[rng.permutation(len(spheres) + 3)]
    count = len(everything)
    labels = tuple(str(k) for k in range(count))
    return Points(everything, np.tile(0.1**2 * np.eye(3), (count, 1, 1)), labels, OTS), pose


def test_the_x_shaped_frame_is_found_among_other_markers() -> None:
    errors = []
    for seed in range(20):
        seen, truth = among_others(SPHERES, seed)
        registration = locate_tool(geometry_of(SPHERES), seen, expected=4).registration
        assert registration is not None
        assert (registration.pose.to_frame, registration.pose.from_frame) == (OTS, M)
        off = registration.pose.apply([[0, 0, 150]])[0] - truth[:3, :3] @ (0, 0, 150) - truth[:3, 3]
        spread = registration.tre([[0, 0, 150]])[0]
        errors.append(off @ np.linalg.solve(spread, off))
    assert 1.5 < np.mean(errors) < 5  # 3 expected


def test_a_symmetric_frame_has_no_pose() -> None:
    square = np.array([[50.0, 0, 0], [0, 50, 0], [-50, 0, 0], [0, -50, 0]])
    with pytest.raises(RefusedError, match="tool M is not recognized"):
        locate_tool(geometry_of(square), among_others(square, 1)[0], expected=4)


def test_poses_that_do_not_count_are_told() -> None:
    assert uncounted(recording((0, "a", placed(0)))) == ()
    some = recording((0, "a", placed(0)), (1, "a", None), (2, "b", None))
    lost = Recording("r", tools=tuple(replace(one, status="hidden" if one.frame else "ok") for one in some.tools))
    assert uncounted(lost, "a") == ("r: 1 of 2 poses do not count, most say 'hidden'",)
    assert uncounted(lost) == ("r: 2 of 3 poses do not count, most say 'hidden'",)


def test_the_robots_error_is_about_its_tcp() -> None:
    pose = robot_pose(placed(4), 0.03, 0.01)
    np.testing.assert_allclose(np.sqrt(np.diag(pose.point_covariances(np.zeros((1, 3)))[0])), 0.03)
