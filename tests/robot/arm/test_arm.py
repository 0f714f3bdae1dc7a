"""Arms of which a joint is held: they move as before, and their bodies, tools and flange move with them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ronnaplan.errors import InputError
from ronnaplan.geometry import FloatArray
from ronnaplan.robot.arm.arm import Body, SerialArm
from ronnaplan.robot.arm.forward import forward, link_frames
from ronnaplan.robot.arm.inverse import inverse
from ronnaplan.robot.arm.kuka import kr6_r900
from ronnaplan.transforms import transform_points
from tests.robot.arm.arms import SEVEN, iiwa
from tests.robot.arm.test_kinematics import peer_poses, random_angles, read

HELD_RAD = 0.7


def seven(folder: Path) -> SerialArm:
    """Return an arm of seven joints, with a body of its own on each link and a camera on its flange."""
    arm = read(SEVEN, folder, "l7")
    rng = np.random.default_rng(0)
    places = rng.uniform(-100, 100, (8, 2, 3))
    bodies = [Body(f"b{n}", n, start_mm, end_mm, 10.0) for n, (start_mm, end_mm) in enumerate(places)]
    camera = forward(kr6_r900(), rng.uniform(-1, 1, 6))
    return replace(arm, bodies=tuple(bodies)).with_tool("camera", camera)


def ends(arm: SerialArm, angles_rad: FloatArray) -> dict[str, FloatArray]:
    """Return where the ends (2, 3) of each body are in the base."""
    frames = link_frames(arm, angles_rad)
    return {
        one.name: transform_points(frames[one.link], np.stack([one.start_mm, one.end_mm])) for one in arm.bodies
    }


@pytest.mark.parametrize("number", range(7))
def test_an_arm_moves_as_it_did_with_the_held_joint_at_its_angle(number: int, tmp_path: Path) -> None:
    arm = seven(tmp_path)
    held = arm.holding(f"j{number + 1}", HELD_RAD)
    assert held.joints == tuple(f"j{n}" for n in range(1, 8) if n != number + 1)
    angles = random_angles(held, 1, seed=number)[0]
    every = np.insert(angles, number, HELD_RAD)
    np.testing.assert_array_equal(held.limits_rad, np.delete(arm.limits_rad, number, axis=0))
    for tool in (None, "camera"):
        np.testing.assert_allclose(forward(held, angles, tool), forward(arm, every, tool), atol=1e-9)
    before, now = ends(arm, every), ends(held, angles)
    assert list(now) == list(before)
    for name, places in before.items():
        np.testing.assert_allclose(now[name], places, atol=1e-9)


def test_bodies_that_are_told_later_count_the_links_that_were_there(tmp_path: Path) -> None:
    arm = seven(tmp_path)
    early = arm.holding("j3", HELD_RAD).holding("j6", -HELD_RAD)
    late = replace(arm, bodies=()).holding("j3", HELD_RAD).holding("j6", -HELD_RAD).with_bodies(arm.bodies)
    angles = random_angles(early, 1)[0]
    for name, places in ends(early, angles).items():
        np.testing.assert_allclose(ends(late, angles)[name], places, atol=1e-12)
    assert [one.joint for one in late.held] == ["j3", "j6"]
    beyond = replace(arm.bodies[0], name="claw", link=8)
    told = "the body claw is on link 8 of the arm seven; expected 0, the base, to 7"
    with pytest.raises(InputError, match=told):
        late.with_bodies([beyond])
    with pytest.raises(InputError, match=told):
        replace(arm, bodies=(beyond,))


def test_a_joint_is_held_within_its_limits_only(tmp_path: Path) -> None:
    arm = read(iiwa(), tmp_path)
    for angle_deg in (170.0, -170.0):
        assert len(arm.holding("joint_a3", float(np.radians(angle_deg)))) == 6
    for angle_rad in (float(np.radians(170.1)), float("nan")):
        with pytest.raises(
            InputError, match=r"joint_a3 of iiwa cannot be held at .* degrees; expected -170 to 170"
        ):
            arm.holding("joint_a3", angle_rad)
    with pytest.raises(InputError, match="turns no joint 'a3'; it turns joint_a1, joint_a2"):
        arm.holding("a3", 0.0)
    with pytest.raises(InputError, match=r"turns no joint 'joint_a3'; .*joint_a7, and holds joint_a3"):
        arm.holding("joint_a3", 0.0).holding("joint_a3", 0.0)


def test_an_iiwa_with_its_third_joint_held_is_solved_as_pinocchio_moves_it(tmp_path: Path) -> None:
    arm = read(iiwa(), tmp_path).holding("joint_a3", 0.0)
    angles = random_angles(arm, 60)
    asked = peer_poses(iiwa(), "tool0", np.insert(angles, 2, 0.0, axis=1))
    found = inverse(arm, asked).angles_rad
    assert np.isfinite(found).all()
    back = peer_poses(iiwa(), "tool0", np.insert(found.reshape(-1, 6), 2, 0.0, axis=1))
    assert np.abs(back - np.repeat(asked, 8, axis=0)).max() < 1e-9
