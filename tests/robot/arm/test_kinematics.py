"""Forward and inverse kinematics, against Pinocchio where it can be had."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ronnaplan.errors import InputError, RefusedError
from ronnaplan.geometry import FloatArray
from ronnaplan.robot.arm.arm import SerialArm
from ronnaplan.robot.arm.forward import LENGTH_MM, forward, jacobian, link_frames
from ronnaplan.robot.arm.inverse import inverse, turns
from ronnaplan.robot.arm.kuka import kr6_r900
from ronnaplan.robot.arm.numeric import inverse_numeric
from ronnaplan.robot.arm.quality import joint_margins_deg, singularity_deg
from ronnaplan.robot.arm.urdf import read_urdf
from tests.robot.arm.arms import KR6, SEVEN, TILTED


def read(text: str, folder: Path, tip: str | None = None) -> SerialArm:
    (folder / "arm.urdf").write_text(text)
    return read_urdf(folder / "arm.urdf", tip=tip).arm


def weakest_direction(arm: SerialArm, angles_rad: FloatArray) -> FloatArray:
    """Return the least singular value (...) of the Jacobian, lengths per `LENGTH_MM`: zero in a singular posture."""
    moved = jacobian(arm, angles_rad)
    moved[..., 3:, :] /= LENGTH_MM
    return np.asarray(np.linalg.svd(moved, compute_uv=False)[..., -1], dtype=np.float64)


def random_angles(arm: SerialArm, count: int, seed: int = 0) -> FloatArray:
    least, greatest = arm.limits_rad.T
    return np.random.default_rng(seed).uniform(least, greatest, (count, len(arm)))


def peer_poses(text: str, frame: str, angles: FloatArray, *, moved: bool = False) -> FloatArray:
    """Return Pinocchio's poses (M, 4, 4) of ``frame`` in mm, or its Jacobians (M, 6, N), rotation first."""
    pin: Any = pytest.importorskip("pinocchio")
    model = pin.buildModelFromXML(text.replace("<limit ", '<limit effort="1" velocity="1" '))
    data, number = model.createData(), model.getFrameId(frame)
    found = []
    for one in angles:
        told = []  # a continuous joint is told as cosine and sine
        for angle, joint in zip(one, model.joints[1:], strict=True):
            told += [np.cos(angle), np.sin(angle)] if joint.nq == 2 else [angle]
        if moved:
            both = pin.computeFrameJacobian(model, data, np.array(told), number, pin.LOCAL_WORLD_ALIGNED)
            found.append(np.concatenate([both[3:], 1000.0 * both[:3]]))
        else:
            pin.framesForwardKinematics(model, data, np.array(told))
            matrix = data.oMf[number].homogeneous.copy()
            matrix[:3, 3] *= 1000.0
            found.append(matrix)
    return np.array(found)


@pytest.mark.parametrize(("text", "tip"), [(KR6, "tool0"), (TILTED, "tip"), (SEVEN, "l7")])
def test_an_arm_of_a_file_moves_as_pinocchio_moves_it(text: str, tip: str, tmp_path: Path) -> None:
    arm = read(text, tmp_path, tip)
    angles = random_angles(arm, 50)
    assert np.abs(forward(arm, angles) - peer_poses(text, tip, angles)).max() < 1e-9
    assert np.abs(jacobian(arm, angles) - peer_poses(text, tip, angles, moved=True)).max() < 1e-9


def test_the_built_in_arm_is_that_of_its_description(tmp_path: Path) -> None:
    built_in, described = kr6_r900(), read(KR6, tmp_path)
    angles = random_angles(built_in, 20)
    assert np.abs(forward(built_in, angles) - forward(described, angles)).max() < 1e-9
    np.testing.assert_allclose(built_in.limits_rad, described.limits_rad, atol=1e-9)
    stretched = forward(built_in, np.radians([0, 0, 0, 0, 0, 0]))[:3, 3]
    np.testing.assert_allclose(stretched, [25 + 455 + 420 + 80, 0, 400 + 35], atol=1e-9)


@pytest.mark.parametrize(("text", "tip"), [(KR6, "tool0"), (TILTED, "tip")])
def test_every_posture_reaches_the_pose_and_the_one_it_was_made_of_is_among_them(
    text: str, tip: str, tmp_path: Path
) -> None:
    arm = read(text, tmp_path, tip)
    angles = random_angles(arm, 2000, seed=1)
    asked = forward(arm, angles)
    found = inverse(arm, asked)
    there = np.isfinite(found.angles_rad[..., 0])
    assert set(there.sum(axis=1)) <= {4, 8}
    assert (there.sum(axis=1) == 8).mean() > 0.3
    again = forward(arm, found.angles_rad[there])
    assert np.abs(again - np.repeat(asked[:, None], 8, axis=1)[there]).max() < 1e-9
    away = np.abs((found.angles_rad - angles[:, None] + np.pi) % (2 * np.pi) - np.pi).max(axis=-1)
    assert np.nanmin(away, axis=1).max() < 1e-7
    eight = found.angles_rad[there.all(axis=1)]
    apart = np.abs(eight[:, :, None] - eight[:, None])[:, ~np.eye(8, dtype=bool)]
    assert apart.max(axis=-1).min() > 1e-6


def test_a_tool_is_brought_to_a_pose(tmp_path: Path) -> None:
    arm = read(KR6, tmp_path)
    np.testing.assert_allclose(arm.tool("camera")[:3, 3], [0, 100, 50], atol=1e-9)
    angles = random_angles(arm, 5, seed=2)
    found = inverse(arm, forward(arm, angles, "camera"), "camera")
    assert np.nanmin(np.abs(found.angles_rad - angles[:, None]).max(axis=-1), axis=1).max() < 2 * np.pi + 1e-6
    with pytest.raises(InputError, match="carries no tool 'drill'; it carries l6, tool0, camera"):
        arm.tool("drill")
    assert "drill" in arm.with_tool("drill", np.eye(4)).frames


def test_out_of_reach_has_no_posture() -> None:
    far = np.eye(4)[None].copy()
    far[0, :3, 3] = (1200, 0, 400)
    assert np.isnan(inverse(kr6_r900(), far).angles_rad).all()
    assert not inverse(kr6_r900(), far).within.any()


def test_poses_that_no_tool_can_have_are_refused_by_number() -> None:
    arm = kr6_r900()
    pose = forward(arm, np.array([0.1, -1.5, 1.5, 0.2, 0.8, 0.3]))
    scaled, mirrored = pose @ np.diag([1.01, 1.01, 1.01, 1]), pose @ np.diag([-1.0, 1, 1, 1])
    for wrong, why in (
        (mirrored, "left-handed"),
        (scaled, "not rigid"),
        (pose.T, "bottom row"),
        (pose * np.nan, ""),
    ):
        with pytest.raises(InputError, match=f"pose 1 .*{why}"):
            inverse(arm, np.array([pose, wrong]))


@pytest.mark.parametrize("wrong", ["A1", ["a"] * 6, [object()] * 6, 1 + 2j, [1.0], np.full(6, np.nan)])
def test_what_is_no_posture_or_pose_is_named(wrong: Any) -> None:
    """It ended in tracebacks of NumPy."""
    arm = kr6_r900()
    for of_angles in (forward, jacobian, singularity_deg, joint_margins_deg, turns):
        with pytest.raises(InputError, match="joint angles"):
            of_angles(arm, wrong)
    with pytest.raises(InputError, match=r"the poses to reach .*expected \(N, 4, 4\)"):
        inverse(arm, wrong)
    with pytest.raises(InputError, match=r"shape \(2, 6\) .* of one posture"):
        turns(arm, np.zeros((2, 6)))


def test_a_straight_wrist_is_reached_with_joint_4_at_rest() -> None:
    arm = kr6_r900()
    angles = np.radians([10.0, -80, 90, 0, 0, 30])
    found = inverse(arm, forward(arm, angles)[None])
    back = forward(arm, found.angles_rad[0][np.isfinite(found.angles_rad[0, :, 0])])
    assert np.abs(back - forward(arm, angles)).max() < 1e-6


def test_turns_are_all_that_the_limits_allow() -> None:
    arm = kr6_r900()
    all_turns = np.degrees(turns(arm, np.radians([0, -90, 90, 178, 30, 20])))
    assert sorted(map(tuple, np.round(all_turns[:, [3, 5]]))) == [(-182, -340), (-182, 20), (178, -340), (178, 20)]
    assert turns(arm, np.radians([0, 100, 0, 0, 0, 0])).shape == (0, 6)


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ('<origin xyz="0.08 0 0"/>', '<origin xyz="0.08 0.01 0"/>', "pass each other"),
        (
            '<axis xyz="0 1 0"/><limit lower="-2.0943951023931953" upper="2.722',
            '<axis xyz="0 1 0.1"/><limit lower="-1" upper="2.722',
            "A2 and A3 are 5.71 degrees from parallel, expected parallel",
        ),
    ],
)
def test_an_arm_without_a_spherical_wrist_is_left_to_the_numerical_inverse(
    old: str, new: str, sentence: str, tmp_path: Path
) -> None:
    assert old in KR6
    arm = read(KR6.replace(old, new), tmp_path)
    angles = random_angles(arm, 1, seed=4)
    with pytest.raises(InputError, match=sentence):
        inverse(arm, forward(arm, angles))
    found = inverse_numeric(arm, forward(arm, angles)[0])
    assert np.abs(forward(arm, found) - forward(arm, angles)).max() < 1e-6
    assert np.abs((found - angles + np.pi) % (2 * np.pi) - np.pi).max(axis=1).min() < 1e-5


def test_the_numerical_inverse_finds_what_the_closed_form_finds() -> None:
    arm = kr6_r900()
    asked = forward(arm, np.radians([[20, -80, 100, 30, 50, -60]]))
    closed, numeric = inverse(arm, asked), inverse_numeric(arm, asked[0])
    for one in closed.angles_rad[0][closed.within[0]]:
        assert np.abs((numeric - one + np.pi) % (2 * np.pi) - np.pi).max(axis=1).min() < 1e-6
    far = np.eye(4)
    far[0, 3] = 3000
    with pytest.raises(RefusedError, match="out of reach"):
        inverse_numeric(arm, far, starts=8)


def test_seven_joints_are_brought_to_a_pose_in_many_ways(tmp_path: Path) -> None:
    arm = read(SEVEN, tmp_path)
    asked = forward(arm, random_angles(arm, 1, seed=3))[0]
    found = inverse_numeric(arm, asked)
    assert len(found) > 5
    assert np.abs(forward(arm, found) - asked).max() < 1e-6
    assert (joint_margins_deg(arm, found) >= 0).all()


def test_margins_and_singular_postures() -> None:
    arm = kr6_r900()
    np.testing.assert_allclose(
        joint_margins_deg(arm, np.radians([160, -90, 160, 0, 0, 0])), [10, 100, -4, 185, 120, 350], atol=1e-9
    )
    stretched = np.degrees(np.arctan2(35, 420))
    postures = np.radians([[0, -90, 90, 20, 7, 0], [0, -30, 10 + stretched, 20, 60, 0]])
    np.testing.assert_allclose(singularity_deg(arm, postures), [7, 10], atol=1e-6)
    scan = np.radians(np.linspace(-20, 20, 401))
    through = np.tile(np.radians([0.0, -60, 80, 30, 0, 0]), (401, 1))
    through[:, 4] = scan
    assert singularity_deg(arm, through).argmin() == weakest_direction(arm, through).argmin() == 200
    assert weakest_direction(arm, through)[200] < 1e-9 < weakest_direction(arm, through)[0]


def test_a_singular_posture_is_where_the_jacobian_loses_a_direction() -> None:
    """Along random ways through the joints, both are least at the same place, and only there near zero."""
    arm = kr6_r900()
    angles = random_angles(arm, 4000, seed=5)
    near = singularity_deg(arm, angles) < 0.5
    weak = weakest_direction(arm, angles)
    assert near.sum() > 10
    assert weak[near].max() < 0.02
    assert (singularity_deg(arm, angles)[weak < 1e-3] < 3).all()


def test_links_are_placed_alike_by_the_compiled_kernel() -> None:
    from ronnaplan.robot.arm.links import place_links

    arm = kr6_r900()
    angles = random_angles(arm, 1, seed=6)[0]
    frames = np.empty((7, 4, 4))
    frames[0] = np.eye(4)
    place_links(arm.origins, arm.axes, angles, frames)
    np.testing.assert_allclose(frames, link_frames(arm, angles), atol=1e-9)
