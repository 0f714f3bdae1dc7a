"""Looks again at one sphere: those that contradict each other are told, and poses of the robot that were misread."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ronnaplan.errors import RefusedError
from ronnaplan.geometry import FloatArray, Frame, Points
from ronnaplan.pose import Pose
from ronnaplan.robot.chain import TCP
from ronnaplan.robot.stereo.again import FAR_MM as FARTHER_MM
from ronnaplan.robot.stereo.again import apart, contradiction, one_if_misread, read_otherwise, require_apart, same
from ronnaplan.robot.stereo.camera import RIG
from ronnaplan.robot.stereo.markers import register_robot_markers
from ronnaplan.robot.stereo.robot_markers import RobotMarkers
from ronnaplan.transforms import invert, transform_points
from tests.long import few_or_all
from tests.robot.misreadings import MISREAD, misread

HEAD_MM = np.array([[60.0, -50, 40], [-55, -60, 30], [70, 20, 50], [-40, 70, 60], [10, 90, 45], [5, -5, 90]])
OWN_MM = 0.04
DIAMETER_MM = 11.5
FAR_MM, NEAR_MM = 200.0, 4.0
"""How far a sphere is from the TCP: where the cameras are beside a drill, and where their working point is the TCP."""
CT = Points(HEAD_MM, np.tile(1e-4 * np.eye(3), (6, 1, 1)), tuple("ABCDEF"), Frame("CT", "1.2"))


def looked(
    seed: int, order: list[int], *, away_mm: float = FAR_MM, moved_mm: float = 0.0, moved_from: int = 99
) -> RobotMarkers:
    """Looks at spheres of the head in this ``order``, each from another side; it moves before some look, if any."""
    rng = np.random.default_rng(seed)
    tcp_from_rig = np.eye(4)
    tcp_from_rig[:3, :3] = Rotation.from_euler("yx", (14.5, 3), degrees=True).as_matrix()
    tcp_from_rig[:3, 3] = (-78.0 + away_mm, 4, -290)
    turn = Rotation.from_euler("z", rng.uniform(-180, 180), degrees=True).as_matrix()
    robot_from_ct = np.vstack(
        [np.column_stack([turn, rng.uniform([500, -300, 100], [1100, 300, 700])]), [0, 0, 0, 1]]
    )
    spheres_mm = transform_points(robot_from_ct, HEAD_MM)[order]
    spheres_mm[moved_from:, 0] += moved_mm
    tilts = Rotation.from_euler("xyz", rng.uniform(-15, 15, (len(order), 3)), degrees=True)
    poses = np.tile(np.eye(4), (len(order), 1, 1))
    poses[:, :3, :3] = (tilts * Rotation.from_euler("xz", (150, 20), degrees=True)).as_matrix()
    offs_mm = rng.uniform(-4, 4, spheres_mm.shape) + np.array([away_mm, 0.0, 0.0])
    poses[:, :3, 3] = spheres_mm - (poses[:, :3, :3] @ offs_mm[..., None])[..., 0]
    in_rig = np.array(
        [
            transform_points(invert(pose @ tcp_from_rig), at[None])[0]
            for pose, at in zip(poses, spheres_mm, strict=True)
        ]
    )
    in_rig += rng.normal(0.0, OWN_MM, in_rig.shape)
    own = np.tile(OWN_MM**2 * np.eye(3), (len(order), 1, 1))
    exact = Pose(tcp_from_rig, np.diag(np.repeat([1e-9, 1e-5], 3)), TCP, RIG)
    return RobotMarkers(tuple(map(str, range(len(order)))), in_rig, own, poses, exact)


def taken(looks: RobotMarkers, poses: FloatArray) -> RobotMarkers:
    return replace(looks, robot_from_tcp=poses)


@pytest.mark.parametrize("how", MISREAD)
def test_a_sphere_looked_at_twice_tells_that_the_robots_poses_were_misread(how: str) -> None:
    """They were written as spheres of their own."""
    looks = looked(1, [0, 1, 2, 3, 4, 5, 2])
    require_apart(looks, DIAMETER_MM)
    wrong = taken(looks, misread(looks.robot_from_tcp, how))
    told = rf"of frames 2 and 6 are \d+ mm apart, but one and the same if in the robot's poses .*{MISREAD[how]}"
    with pytest.raises(RefusedError, match=told):
        require_apart(wrong, DIAMETER_MM)
    require_apart(
        wrong.only([0, 1, 2, 3, 4, 5]), DIAMETER_MM
    )  # of spheres that are looked at once nothing is known


def test_where_misread_poses_put_one_sphere_at_places_beside_each_other_both_may_be_it() -> None:
    looks = looked(1, [0, 1, 2, 3, 4, 5, 2], away_mm=NEAR_MM)
    wrong = taken(looks, misread(looks.robot_from_tcp, "scalar first"))
    told = rf"apart, yet 11.5 mm wide; .* whether in them .*{MISREAD['scalar first']}, which would make them one"
    with pytest.raises(RefusedError, match=told):
        require_apart(wrong, DIAMETER_MM)
    moved = looked(1, [0, 1, 2, 3, 4, 5, 2], moved_mm=3.0, moved_from=6)
    with pytest.raises(RefusedError, match=r"that the robot's poses are those of these looks$"):
        require_apart(moved, DIAMETER_MM)


@pytest.mark.parametrize("how", MISREAD)
def test_where_the_scans_markers_would_pair_by_other_poses_that_is_told(how: str) -> None:
    looks = looked(1, [0, 1, 2, 3, 4, 5])
    assert register_robot_markers(CT, looks, sigma_ct_mm=0.1).labels
    wrong = taken(looks, misread(looks.robot_from_tcp, how))
    with pytest.raises(
        RefusedError, match=f"they agree if in the robot's poses .*{MISREAD[how]}.* relocate, anew"
    ):
        register_robot_markers(CT, wrong, sigma_ct_mm=0.1)


@few_or_all("seeds", 60, 1000)
def test_of_poses_that_were_read_rightly_nothing_is_told(seeds: int) -> None:
    """Neither where the head moved meanwhile, nor of another scan's markers."""
    for seed in range(seeds):
        order = [0, 1, 2, 3, 4, 5, *np.random.default_rng(seed).permutation(6)[:3].tolist()]
        for away_mm in (FAR_MM, NEAR_MM):
            looks = looked(seed, order, away_mm=away_mm)
            require_apart(looks, DIAMETER_MM)
            assert contradiction(looks) is None
            moved = looked(seed, order, away_mm=away_mm, moved_mm=30.0, moved_from=6)
            far_mm, squared = apart(moved)
            assert one_if_misread(read_otherwise(moved, same(far_mm, squared)), far_mm > FARTHER_MM) is None
    other = replace(CT, positions_mm=HEAD_MM * [1.1, 0.9, 1.0])
    with pytest.raises(RefusedError) as refused:
        register_robot_markers(other, looked(1, [0, 1, 2, 3, 4, 5]), sigma_ct_mm=0.1)
    assert "robot's poses" not in str(refused.value)


def test_looks_at_one_sphere_that_contradict_each_other_are_told_with_how_far_they_are_apart() -> None:
    """The markers were told to be laid out regularly, as both looks at each fit them."""
    order = [0, 1, 2, 3, 4, 5, 2, 0, 1]
    assert contradiction(looked(3, order)) is None
    moved = looked(3, order, moved_mm=0.7, moved_from=6)
    told = contradiction(moved)
    assert told is not None
    assert "(and 2 more pairs of looks) show one sphere at places 0." in told
    assert "head, base or cameras moved meanwhile" in told
    thrice = looked(3, [*order, 3, 4, 5], moved_mm=0.7, moved_from=6)
    with pytest.raises(RefusedError, match=r"re-localized spheres: .* show one sphere at places 0\."):
        register_robot_markers(CT, thrice, sigma_ct_mm=0.1)


@pytest.mark.parametrize("how", ["scalar first", "scalar last", "A and C"])
def test_misread_poses_that_pair_with_the_scan_are_refused_where_the_residuals_tell(how: str) -> None:
    """With the TCP at the cameras' working point they shift all spheres nearly alike."""
    looks = looked(4, [0, 1, 2, 3, 4, 5], away_mm=NEAR_MM)
    wrong = taken(looks, misread(looks.robot_from_tcp, how))
    assert np.linalg.norm((wrong.positions_mm - looks.positions_mm).mean(axis=0)) > 1.0
    with pytest.raises(RefusedError, match=f"if in the robot's poses .*{MISREAD[how]}"):
        register_robot_markers(CT, wrong, sigma_ct_mm=0.2)
