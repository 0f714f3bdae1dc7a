"""Markers, looked at one after the other, that do not agree with the scan: a movement, or the cameras."""

import numpy as np
import pytest

from ronnaplan.errors import RefusedError
from ronnaplan.geometry import Points
from ronnaplan.robot.stereo.markers import RobotRegistration, register_robot_markers
from ronnaplan.robot.stereo.robot_markers import RobotMarkers
from ronnaplan.transforms import invert, transform_points
from tests.robot.stereo.test_markers import looked

COMMON = np.diag(np.repeat([1e-8, 1e-4], 3))
SHIFT_MM = np.array([1.2, -0.9, 0.0])


def register(share: list[float], sigma_ct_mm: float = 0.05) -> None:
    """Register a session of which each look had a ``share`` of a shift."""
    ct, spheres = looked(np.random.default_rng(1), 0.1, 0.03, COMMON)
    spheres.robot_from_tcp[:, :3, 3] += np.outer(share, SHIFT_MM)
    register_robot_markers(ct, spheres, sigma_ct_mm=sigma_ct_mm)


@pytest.mark.parametrize(
    ("share", "when"),
    [
        ([0, 0, 1, 1, 1], "between frames 1 and 2"),
        ([0, 0, 0, 1, 1], "between frames 2 and 3"),
        ([0, 0.25, 0.5, 0.75, 1], "steadily from frame 0 to frame 4"),
    ],
)
def test_a_head_that_moved_between_looks_is_refused_and_told_when(share: list[float], when: str) -> None:
    """A mean of both was given, half the movement off, and stated as a tenth of that."""
    with pytest.raises(
        RefusedError, match=rf"but would if head or robot base had moved {when} by 1\.[45]\d mm: fasten"
    ):
        register(share)


@pytest.mark.parametrize(
    ("share", "sigma_ct_mm"),
    [([0, 0, 0, 0, 0], 0.05), ([0, 0, 1, 0, 0], 0.05), ([0.4, 0, 0, 0, 0], 0.05), ([0, 0, 1, 1, 1], 0.56)],
)
def test_neither_one_loose_marker_nor_what_errors_explain_is_a_movement(
    share: list[float], sigma_ct_mm: float
) -> None:
    register(share, sigma_ct_mm)


def test_cameras_calibrated_elsewhere_are_told_and_no_movement() -> None:
    """Of tilts by 0.3 rad: a wrong place of the cameras was told as a movement, or went with a warning."""
    ct, spheres = looked(np.random.default_rng(1), 0.3, 0.03, COMMON)
    spheres.tcp_from_rig.matrix[:3, 3] += (1.2, -0.9, 0.0)
    with pytest.raises(
        RefusedError, match=r"but would if the cameras were 1\.[45]\d mm beside .* at the TCP: fasten"
    ):
        register_robot_markers(ct, spheres, sigma_ct_mm=0.05)


def four(seed: int, ct_mm: float, share: tuple[float, ...] = (0, 0, 1, 1)) -> RobotRegistration:
    """Register two pairs of markers on parallel lines that moved by their ``share``; errors as ``seed`` has them."""
    ct, spheres = looked(np.random.default_rng(1), 0.1, 0.03, COMMON)
    markers = np.array([[-60.0, -40, 0], [60, -40, 0], [-20, 60, 30], [40, 60, 30]])
    places = markers + np.array([600, 50, 400]) + np.outer(share, SHIFT_MM)
    places += np.random.default_rng(seed).normal(0, 0.03, (4, 3))
    poses = spheres.robot_from_tcp[:4]
    rig_from_robot = invert(poses @ spheres.tcp_from_rig.matrix)
    in_rig = transform_points(rig_from_robot, places[:, None])[:, 0]
    seen = RobotMarkers(spheres.labels[:4], in_rig, spheres.own_mm2[:4], poses, spheres.tcp_from_rig)
    found = markers + np.random.default_rng(100 + seed).normal(0, ct_mm, (4, 3))
    return register_robot_markers(
        Points(found, ct.covariances_mm2[:4], ct.labels[:4], ct.frame), seen, sigma_ct_mm=0.05
    )


def test_what_a_layout_does_not_tell_of_a_movement_is_not_made_up() -> None:
    """It was told as one by 257 mm: a turn about the lines does the same as a shift."""
    with pytest.raises(RefusedError, match=r"moved between frames 1 and 2 by 1\.\d\d mm: "):
        four(seed=4, ct_mm=0.03)


@pytest.mark.parametrize(("share", "count"), [((0, 0, 1, 1), 3), ((0, 0.7, 0, 0.7), 4)])
def test_two_markers_that_moved_against_two_are_refused(share: tuple[float, ...], count: int) -> None:
    """One of four may be left out, or none explain it: the mean of both was given, with a warning."""
    with pytest.raises(RefusedError, match=rf"{count} markers contradict each other by more .* do not tell which"):
        four(seed=2, ct_mm=0.0, share=share)
