"""Markers re-localized by the cameras: the registration to them and its error, one part of it common to all."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from ronnaplan.errors import InputError, RefusedError
from ronnaplan.geometry import Frame, Points
from ronnaplan.pose import Pose
from ronnaplan.robot.chain import TCP
from ronnaplan.robot.stereo.again import require_apart
from ronnaplan.robot.stereo.camera import RIG
from ronnaplan.robot.stereo.markers import register_robot_markers
from ronnaplan.robot.stereo.robot_markers import RobotMarkers
from ronnaplan.transforms import invert, transform_points
from tests.long import few_and_others, few_or_all

CT = Frame("CT", "1.2")
HEAD_MM = np.array([[60.0, -50, 40], [-55, -60, 30], [70, 20, 50], [-40, 70, 60], [10, 90, 45]])
TCP_FROM_RIG = np.array([[0.97, 0, 0.243, -78], [0, 1, 0, 4], [-0.243, 0, 0.97, -290], [0, 0, 0, 1]])
TCP_FROM_RIG[:3, :3] = Rotation.from_euler("y", 14.5, degrees=True).as_matrix()


def looked(
    rng: np.random.Generator, tilt: float, own_mm: float, common: np.ndarray
) -> tuple[Points, RobotMarkers]:
    """One session: each marker seen from a pose above it, the rig's place wrong by a draw of ``common``."""
    robot_from_ct = np.eye(4)
    robot_from_ct[:3, :3] = Rotation.from_euler("xyz", (20, -30, 70), degrees=True).as_matrix()
    robot_from_ct[:3, 3] = (600, 50, 400)
    spheres = transform_points(robot_from_ct, HEAD_MM)
    poses = np.tile(np.eye(4), (len(spheres), 1, 1))
    turns = Rotation.from_rotvec(np.random.default_rng(5).normal(size=(len(spheres), 3)) * tilt)
    poses[:, :3, :3] = turns.as_matrix()
    poses[:, :3, 3] = spheres
    believed = (
        RigidTransform.from_exp_coords(rng.multivariate_normal(np.zeros(6), common)).as_matrix() @ TCP_FROM_RIG
    )
    in_rig = np.array(
        [transform_points(invert(p @ TCP_FROM_RIG), s[None])[0] for p, s in zip(poses, spheres, strict=True)]
    )
    own = np.tile(own_mm**2 * np.eye(3), (len(spheres), 1, 1))
    in_rig = in_rig + rng.normal(size=in_rig.shape) * own_mm
    ct = Points(HEAD_MM, np.tile(1e-10 * np.eye(3), (len(spheres), 1, 1)), tuple("ABCDE"), CT)
    return ct, RobotMarkers(tuple("01234"), in_rig, own, poses, Pose(believed, common, TCP, RIG))


@few_or_all("cases", 50, 150)
@few_and_others("tilt", [0.3], [0.0])
def test_the_common_error_of_the_rig_does_not_average_out(tilt: float, cases: int) -> None:
    """With looks alike it shifts all markers together; the stated error is that of 150 simulated sessions."""
    common = np.diag(np.repeat([2e-4**2, 0.08**2], 3))
    target = np.array([[5.0, 0, 10]])
    rng = np.random.default_rng(3)
    places, stated, independent = [], [], []
    for _ in range(cases):
        ct, spheres = looked(rng, tilt, 0.03, common)
        found = register_robot_markers(ct, spheres, expected=5, sigma_ct_mm=0.0)
        places.append(found.robot_from_ct.apply(target)[0])
        stated.append(np.trace(found.robot_from_ct.point_covariances(target)[0]))
        independent.append(np.trace(found.registration.tre(target)[0]))
    scatter = np.sqrt(np.trace(np.cov(np.array(places).T)))
    assert np.sqrt(np.mean(stated)) == pytest.approx(scatter, rel=0.15)
    assert np.sqrt(np.mean(independent)) < 0.7 * scatter


def test_spheres_of_another_head_are_refused() -> None:
    ct, spheres = looked(np.random.default_rng(1), 0.1, 0.03, np.diag(np.repeat([1e-8, 1e-4], 3)))
    other = Points(ct.positions_mm * np.array([1.1, 0.9, 1.0]), ct.covariances_mm2, ct.labels, CT)
    with pytest.raises(RefusedError, match="re-localized spheres"):
        register_robot_markers(other, spheres, expected=5, sigma_ct_mm=0.1)


def test_too_few_spheres_are_told_as_spheres() -> None:
    ct, spheres = looked(np.random.default_rng(1), 0.1, 0.03, np.diag(np.repeat([1e-8, 1e-4], 3)))
    two = replace(spheres, labels=("0", "1"), in_rig_mm=spheres.in_rig_mm[:2], own_mm2=spheres.own_mm2[:2])
    two = replace(two, robot_from_tcp=spheres.robot_from_tcp[:2])
    with pytest.raises(InputError, match=r"2 spheres were re-localized; .* at least 3"):
        register_robot_markers(ct, two, sigma_ct_mm=0.1)


def test_spheres_that_overlap_are_refused_but_not_two_looks_at_one() -> None:
    _, spheres = looked(np.random.default_rng(1), 0.1, 0.03, np.diag(np.repeat([1e-8, 1e-4], 3)))
    again = np.array([0, 1, 2, 3, 0])
    twice = replace(spheres, in_rig_mm=spheres.in_rig_mm[again], robot_from_tcp=spheres.robot_from_tcp[again])
    require_apart(twice, 11.5)
    twice.in_rig_mm[4] += 2.0
    with pytest.raises(RefusedError, match=r"of frames 0 and 4 are 3.5 mm apart, yet 11.5 mm wide"):
        require_apart(twice, 11.5)


def test_spheres_and_markers_in_no_pair_are_told() -> None:
    """Spheres that did not fit were passed over without a word."""
    ct, spheres = looked(np.random.default_rng(1), 0.1, 0.03, np.diag(np.repeat([1e-8, 1e-4], 3)))
    assert not register_robot_markers(ct, spheres, sigma_ct_mm=0.1).notes
    spheres.in_rig_mm[2] += 30.0
    notes = register_robot_markers(ct, spheres, sigma_ct_mm=0.1).notes
    assert notes[-2:] == (f"CT markers without a partner: {ct.labels[2]}", "spheres without a partner: 2")


def test_two_looks_at_one_marker_leave_it_in_the_registration() -> None:
    """Both were left out, as if the marker had moved, and with it one of five."""
    ct, spheres = looked(np.random.default_rng(1), 0.1, 0.03, np.diag(np.repeat([1e-8, 1e-4], 3)))
    looks = [0, 1, 2, 2, 3, 4]
    own = spheres.own_mm2[looks]
    own[3] *= 4.0
    twice = replace(
        spheres,
        labels=tuple("012789"),
        in_rig_mm=spheres.in_rig_mm[looks] + 0.02 * (np.arange(6) == 3)[:, None],
        own_mm2=own,
        robot_from_tcp=spheres.robot_from_tcp[looks],
    )
    once, again = (register_robot_markers(ct, one, expected=5, sigma_ct_mm=0.1) for one in (spheres, twice))
    np.testing.assert_allclose(again.robot_from_ct.matrix, once.robot_from_ct.matrix, atol=1e-9)
    assert again.labels == (("A", "0"), ("B", "1"), ("C", "2"), ("D", "8"), ("E", "9"))
    assert again.notes == (
        "frames 2 and 7 show one sphere, 0.035 mm apart: frame 2, which tells it better, counts",
    )
    twice.in_rig_mm[3] += 0.5
    assert register_robot_markers(ct, twice, sigma_ct_mm=0.1).notes == ("spheres without a partner: 7",)


def test_looks_from_two_sides_that_an_error_of_the_rig_parts_show_one_sphere() -> None:
    """They were taken for contradicting each other, and the marker was left out."""
    common = np.diag(np.repeat([2e-4**2, 0.08**2], 3))
    ct, spheres = looked(np.random.default_rng(1), 0.3, 0.005, common)
    pose = spheres.robot_from_tcp[2].copy()
    pose[:3, :3] = Rotation.from_euler("z", 180, degrees=True).as_matrix() @ pose[:3, :3]
    shift_mm = np.array([0.09, -0.06, 0.03])  # of the rig, in the axes of the TCP
    seen_mm = spheres.positions_mm[2] + spheres.robot_from_tcp[2, :3, :3] @ shift_mm - pose[:3, :3] @ shift_mm
    looks = [0, 1, 2, 3, 4, 2]
    twice = replace(
        spheres,
        labels=tuple("012345"),
        in_rig_mm=spheres.in_rig_mm[looks],
        own_mm2=spheres.own_mm2[looks],
        robot_from_tcp=np.concatenate([spheres.robot_from_tcp, pose[None]]),
    )
    twice.in_rig_mm[5] = transform_points(invert(pose @ TCP_FROM_RIG), seen_mm[None])[0]
    found = register_robot_markers(ct, twice, expected=5, sigma_ct_mm=0.1)
    assert found.labels == tuple(zip("ABCDE", "01234", strict=True))
    assert found.notes[0].startswith("frames 2 and 5 show one sphere, 0.2")
