"""Arms with each kind of closed form, whatever their offsets; and what is told of arms that have none."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from ronnaplan.errors import InputError
from ronnaplan.geometry import FloatArray, unit
from ronnaplan.robot.arm.arm import SerialArm
from ronnaplan.robot.arm.forward import forward, jacobian
from ronnaplan.robot.arm.inverse import inverse
from ronnaplan.robot.arm.numeric import inverse_numeric
from ronnaplan.robot.arm.quality import singularity_deg
from ronnaplan.robot.arm.wrist import center_mm, shoulder_mm, stretched_mm, wrist_of
from ronnaplan.transforms import exponential, invert, rigid
from tests.long import few_and_others, few_or_all
from tests.robot.arm.arms import HALF, PANDA_M, SEVEN, UR5E_M, UR10E_M, calibrated, iiwa, panda, ur
from tests.robot.arm.test_kinematics import peer_poses, random_angles, read, weakest_direction

KINDS = ("spherical", "parallel", "shoulder")
"""Which axes meet, and which are parallel: spherical and parallel wrists, and spherical shoulders."""
PER_ARM = 40
"""Poses that each random arm is asked for."""


def across(rng: np.random.Generator, axis: FloatArray) -> FloatArray:
    """Return a random direction (3,) perpendicular to ``axis``."""
    return unit(np.cross(axis, rng.normal(size=3)))


def drawn(seed: int, kind: str = "parallel", *, meeting: bool = False) -> SerialArm:
    """Return an arm whose every offset is random and whose frames are askew, of one of the `KINDS`.

    ``meeting``: axes 1 and 2 meet.
    """
    rng = np.random.default_rng(seed)
    one = unit(rng.normal(size=3))
    two = across(rng, one)
    three = across(rng, two) if kind == "shoulder" else two * rng.choice([-1.0, 1.0])
    four = two * rng.choice([-1.0, 1.0]) if kind == "parallel" else unit(rng.normal(size=3))
    five = across(rng, four)
    axes = np.stack([one, two, three, four, five, across(rng, five)])
    places = rng.uniform(-300.0, 300.0, (6, 3))
    if meeting or kind == "shoulder":
        places[1] = places[0]
    if kind == "shoulder":
        places[2] = places[0]
        places[4] -= (places[4] - places[0]) @ four * four
    places[5] = places[4]
    if kind == "spherical":
        places[3] = places[4]
    places += rng.uniform(-200.0, 200.0, (6, 1)) * axes
    frames = rigid(exponential(rng.uniform(-2.0, 2.0, (6, 3))), places)
    origins = np.array([frames[0], *(invert(a) @ b for a, b in pairwise(frames))])
    own = np.einsum("nji,nj->ni", frames[:, :3, :3], axes)
    flange = rigid(exponential(rng.uniform(-2.0, 2.0, 3)), rng.uniform(-100.0, 100.0, 3))
    limits = np.tile([-np.pi, np.pi], (6, 1)) + rng.uniform(-1.0, 1.0, (6, 1))
    return SerialArm(f"drawn {seed}", tuple("abcdef"), origins, own, limits, flange)


def held_panda(folder: Path, held_deg: float = 0.0) -> SerialArm:
    """Return Franka's arm with its last joint held."""
    return read(panda(), folder).holding("panda_joint7", np.radians(held_deg))


def turned(found: FloatArray, angles: FloatArray) -> FloatArray:
    """Return by how much (...) joint vectors differ at most in any joint, whole turns aside."""
    return np.asarray(np.abs((found - angles + np.pi) % (2 * np.pi) - np.pi).max(axis=-1))


@few_or_all("cases", 20, 60)
@pytest.mark.parametrize("kind", KINDS)
def test_every_branch_of_any_arm_of_each_kind_reaches_the_pose(kind: str, cases: int) -> None:
    counts = []
    for seed in range(cases):
        arm = drawn(seed, kind)
        assert wrist_of(arm).parallel is (kind == "parallel")
        angles = random_angles(arm, PER_ARM, seed)
        asked = forward(arm, angles)
        found = inverse(arm, asked).angles_rad
        there = np.isfinite(found[..., 0])
        miss = np.abs(forward(arm, found[there]) - np.repeat(asked[:, None], 8, axis=1)[there]).max(axis=(1, 2))
        # nearer to a singular posture the last digits of a pose tell the angles less well
        assert miss[singularity_deg(arm, found[there]) > 0.1].max() < 1e-9, f"seed {seed}"
        assert miss.max() < 1e-6, f"seed {seed}"
        clear = singularity_deg(arm, angles) > 0.1
        own = np.nanmin(turned(found, angles[:, None])[clear], axis=1)
        # and near two at once less well still, by the last digits of whichever processor it is; branches lie 1e-4 apart
        assert own.max() < (1e-7 if kind == "shoulder" else 1e-8), f"seed {seed}"
        apart = turned(found[:, :, None], found[:, None])[clear][:, ~np.eye(8, dtype=bool)]
        assert np.nanmin(apart) > 1e-4, f"seed {seed}"
        counts += there.sum(axis=1).tolist()
    assert set(counts) <= {2, 4, 6, 8}
    assert np.mean(np.array(counts) == 8) > 0.1


@pytest.mark.parametrize("lengths_m", [UR5E_M, UR10E_M])
def test_a_ur_is_solved_as_pinocchio_moves_it(lengths_m: tuple[float, ...], tmp_path: Path) -> None:
    text = ur(lengths_m)
    arm = read(text, tmp_path)
    asked = peer_poses(text, "tool0", random_angles(arm, 60))
    found = inverse(arm, asked)
    there = np.isfinite(found.angles_rad[..., 0])
    assert (there.sum(axis=1) == 8).mean() > 0.5
    back = peer_poses(text, "tool0", found.angles_rad[there])
    assert np.abs(back - np.repeat(asked[:, None], 8, axis=1)[there]).max() < 1e-9
    foot, upper, fore, side, wrist, end = (1000.0 * length for length in lengths_m)
    stretched = forward(arm, np.zeros(6))[:3, 3]
    np.testing.assert_allclose(stretched, [-upper - fore, -side - end, foot - wrist], atol=1e-9)


@few_or_all("cases", 4, 6)
@pytest.mark.parametrize("kind", ["parallel", "shoulder"])
def test_all_that_the_numerical_inverse_finds_is_among_the_eight(kind: str, cases: int) -> None:
    found = []
    for seed in range(cases):
        arm = drawn(seed, kind)
        asked = forward(arm, random_angles(arm, 1, seed + 10)[0])
        closed = inverse(arm, asked[None])
        numeric = inverse_numeric(arm, asked, starts=64)
        here = closed.angles_rad[0][closed.within[0]]
        assert turned(numeric[:, None], here).min(axis=1).max() < 1e-6, f"seed {seed}"
        found.append((len(numeric), len(here)))
    assert sum(some for some, _ in found) > 10, found


@pytest.mark.parametrize(("kind", "seed"), [("parallel", 3), ("shoulder", 4)])
def test_a_branch_keeps_its_posture_along_a_way(kind: str, seed: int) -> None:
    """Joints move by as little as the flange does, but where two branches meet in a singular posture."""
    arm = drawn(seed, kind)
    start = forward(arm, random_angles(arm, 1, seed=3)[0])
    way = np.tile(start, (400, 1, 1))
    way[:, :3, 3] += np.linspace(0.0, 100.0, 400)[:, None] * unit([1.0, 2.0, -1.0])
    found = inverse(arm, way).angles_rad
    clear = np.nan_to_num(singularity_deg(arm, np.nan_to_num(found))) > 3.0
    steps = turned(found[1:], found[:-1])[clear[1:] & clear[:-1]]
    steps = steps[np.isfinite(steps)]
    assert len(steps) > 300
    assert steps.max() < 0.05


def test_with_axis_6_along_axis_4_one_way_to_share_the_turn_is_told(tmp_path: Path) -> None:
    arm = read(ur(UR5E_M), tmp_path)
    asked = forward(arm, np.radians([20.0, -70.0, 90.0, -20.0, 0.0, 30.0]))
    found = inverse(arm, asked[None]).angles_rad[0]
    there = np.isfinite(found[:, 0])
    assert there.any()
    assert np.abs(forward(arm, found[there]) - asked).max() < 1e-9


@pytest.mark.parametrize("kind", KINDS)
def test_by_as_much_as_is_told_one_joint_turns_into_a_singular_posture(kind: str) -> None:
    joints = (1, 3, 4) if kind == "shoulder" else (1, 2, 4)
    checked = 0
    for seed in range(20):
        arm = drawn(seed, kind, meeting=True)
        angles = random_angles(arm, 10, seed)
        told = np.radians(singularity_deg(arm, angles))
        moved = np.repeat(angles[:, None], 6, axis=1)
        for n, (joint, sign) in enumerate((joint, sign) for joint in joints for sign in (-1, 1)):
            moved[:, n, joint] += sign * told
        weakest = weakest_direction(arm, moved)
        assert (weakest.min(axis=1) < 1e-9).all(), f"seed {seed}"
        assert (weakest_direction(arm, angles)[told > 0.05] > 1e-4).all(), f"seed {seed}"
        checked += int((weakest < 1e-9).any(axis=1).sum())
    assert checked == 200


@few_and_others("seed", range(1), range(1, 6))
def test_by_less_than_is_told_no_joint_turns_a_spherical_shoulder_into_a_singular_posture(seed: int) -> None:
    arm = drawn(seed, "shoulder")
    angles = random_angles(arm, 200, seed)
    told = np.radians(singularity_deg(arm, angles))
    here = np.sign(np.linalg.det(jacobian(arm, angles)))
    for joint in range(6):
        for share in np.linspace(-0.999, 0.999, 40):
            moved = angles.copy()
            moved[:, joint] += share * told
            np.testing.assert_array_equal(np.sign(np.linalg.det(jacobian(arm, moved))), here)


@pytest.mark.parametrize("kind", KINDS)
def test_the_determinant_of_the_jacobian_changes_its_sign_with_every_bit_of_a_posture_s_number(kind: str) -> None:
    bits = np.array([(-1) ** number.bit_count() for number in range(8)])
    for seed in range(20):
        arm = drawn(seed, kind)
        found = inverse(arm, forward(arm, random_angles(arm, PER_ARM, seed))).angles_rad
        there = np.isfinite(found[..., 0])
        signs = np.sign(np.linalg.det(jacobian(arm, np.nan_to_num(found)))) * bits
        assert set(signs[there]) == {wrist_of(arm).handed}, f"seed {seed}"


@pytest.mark.parametrize("name", ["ur", "panda"])
def test_only_where_it_is_told_the_jacobian_loses_a_direction(name: str, tmp_path: Path) -> None:
    arm = read(ur(UR10E_M), tmp_path) if name == "ur" else held_panda(tmp_path)
    angles = random_angles(arm, 4000, seed=5)
    near, weak = singularity_deg(arm, angles), weakest_direction(arm, angles)
    assert (near < 0.5).sum() > 10
    assert weak[near < 0.5].max() < 0.02
    several_deg = 5 if name == "panda" else 3  # several kinds of singular posture may be near at once
    assert (near[weak < 1e-3] < several_deg).all()


@pytest.mark.parametrize("held_deg", [0.0, 45.0, -160.0])
def test_a_panda_with_joint_7_held_is_solved_as_pinocchio_moves_it(held_deg: float, tmp_path: Path) -> None:
    arm = held_panda(tmp_path, held_deg)
    every = np.column_stack([random_angles(arm, 60), np.full(60, np.radians(held_deg))])
    asked = peer_poses(panda(), "tool0", every)
    found = inverse(arm, asked)
    there = np.isfinite(found.angles_rad[..., 0])
    assert set(there.sum(axis=1)) == {4, 8}
    every = np.column_stack([found.angles_rad[there], np.full(there.sum(), np.radians(held_deg))])
    back = peer_poses(panda(), "tool0", every)
    assert np.abs(back - np.repeat(asked[:, None], 8, axis=1)[there]).max() < 1e-9
    foot, upper, _, fore, hand, end = (1000.0 * length for length in PANDA_M)
    stretched = forward(arm, np.zeros(6))[:3, 3]
    np.testing.assert_allclose(stretched, [hand, 0.0, foot + upper + fore - end], atol=1e-9)


def test_an_lbr_is_solved_with_its_last_joint_held_anywhere(tmp_path: Path) -> None:
    arm = read(iiwa(), tmp_path).holding("joint_a7", 0.7)
    angles = random_angles(arm, 200, seed=7)
    asked = forward(arm, angles)
    found = inverse(arm, asked).angles_rad
    assert np.isfinite(found).all()
    assert np.abs(forward(arm, found) - asked[:, None]).max() < 1e-8
    assert turned(found, angles[:, None]).min(axis=1).max() < 1e-8


def test_with_axis_3_along_axis_1_one_way_to_share_the_turn_is_told(tmp_path: Path) -> None:
    arm = held_panda(tmp_path)
    asked = forward(arm, np.radians([20.0, 0.0, 10.0, -100.0, 30.0, 80.0]))
    found = inverse(arm, asked[None]).angles_rad[0]
    there = np.isfinite(found[:, 0])
    assert (np.abs(turned(found[there][:, [2]], np.zeros(1))) < 1e-9).any()
    assert np.abs(forward(arm, found[there]) - asked).max() < 1e-9


def test_the_wrist_of_a_panda_comes_as_far_from_its_shoulder_as_is_told(tmp_path: Path) -> None:
    arm = held_panda(tmp_path, 30.0)
    wrist = wrist_of(arm)
    np.testing.assert_allclose(shoulder_mm(wrist), [0.0, 0.0, 1000.0 * PANDA_M[0]], atol=1e-9)
    angles = random_angles(arm, 4000, seed=2)
    angles[:, 3] = np.linspace(-np.pi, np.pi, 4000)
    flanges = forward(arm, angles)
    centers_mm = flanges[:, :3, :3] @ center_mm(wrist) + flanges[:, :3, 3]
    away_mm = np.linalg.norm(centers_mm - shoulder_mm(wrist), axis=1)
    assert away_mm.max() == pytest.approx(stretched_mm(wrist), abs=1e-3)


@pytest.mark.parametrize(
    ("joint", "old", "new", "sentence"),
    [
        ("panda_joint4", "0.0825 0 0", "0.2 0 0.07", None),
        (
            "panda_joint5",
            f'rpy="-{HALF} 0 0',
            'rpy="-1 0 0',
            "axes of panda_joint5 and panda_joint4 are 32.7 degrees",
        ),
        (
            "panda_joint6",
            "0 0 0",
            "0.01 0 0",
            "panda_joint5 and panda_joint6 pass each other by 5 mm, expected both to",
        ),
        (
            "panda_joint3",
            "0 -0.316 0",
            "0.01 -0.316 0",
            "panda_joint2 and panda_joint3 pass each other by .* expected all three",
        ),
        (
            "panda_joint5",
            "-0.0825 0.384 0",
            "-0.0825 0.384 0.05",
            "along the axis of panda_joint4 wrist and shoulder are apart by 50 mm",
        ),
    ],
)
def test_of_other_arms_with_a_shoulder_is_told_what_they_lack(
    joint: str, old: str, new: str, sentence: str | None, tmp_path: Path
) -> None:
    before, after = panda().split(f'<joint name="{joint}"')
    assert old in after
    whole = read(f'{before}<joint name="{joint}"{after.replace(old, new, 1)}', tmp_path)
    arm = whole.holding("panda_joint7", 0.0)
    if sentence is None:  # any offset of the elbow, also along axes 3 and 4
        assert wrist_of(arm).backwards
        return
    with pytest.raises(InputError, match=sentence):
        wrist_of(arm)


@pytest.mark.parametrize(
    ("joint", "old", "new", "sentence"),
    [
        ("wrist_2", "0 -0.0997 0", "0.01 -0.0997 0", None),
        ("wrist_3", "0 0.0996 0", "0.001 0.0996 0", None),
        ("lift", HALF, "1.57", None),
        ("elbow", 'rpy="0 0 0', 'rpy="9e-3 0 0', None),
        ("wrist_1", 'rpy="0 0 0', 'rpy="9e-3 0 0', None),
        ("wrist_3", "0 0.0996 0", "0.01 0.0996 0", "by 5 mm, and that of wrist_1 is 0 degrees from parallel"),
        ("wrist_1", 'rpy="0 0 0', 'rpy="0.1 0 0', "wrist_1 is 5.73 degrees from parallel to that of lift"),
        ("elbow", 'rpy="0 0 0', 'rpy="0.1 0 0', "lift and elbow are 5.73 degrees from parallel, expected"),
        ("lift", HALF, "1.4", "pan and lift are 9.79 degrees from perpendicular"),
        (
            "elbow",
            'rpy="0 0 0',
            'rpy="0.011 0 0',
            "lift and elbow are 0.63 degrees from parallel, expected parallel",
        ),
    ],
)
def test_of_other_arms_is_told_what_they_lack(
    joint: str, old: str, new: str, sentence: str | None, tmp_path: Path
) -> None:
    before, after = ur(UR5E_M).split(f'<joint name="{joint}"')
    assert old in after
    arm = read(f'{before}<joint name="{joint}"{after.replace(old, new, 1)}', tmp_path)
    if sentence is None:  # any offset between axes 4 and 5 will do, and what a calibration may find
        assert wrist_of(arm).parallel
        return
    with pytest.raises(InputError, match=sentence):
        wrist_of(arm)


def test_of_seven_joints_is_told_which_to_hold(tmp_path: Path) -> None:
    arm = read(iiwa(), tmp_path)
    with pytest.raises(
        InputError,
        match=r"has 7 joints.*; hold one where it shall stay \(--hold joint_a3=0 or --hold joint_a7=0\)$",
    ):
        wrist_of(arm)
    with pytest.raises(InputError, match=r"; hold one where it shall stay \(--hold panda_joint7=0\)$"):
        wrist_of(read(panda(), tmp_path))
    none = r"no joint held at 0, 90, -90, 180 degrees leaves one; `inverse_numeric` solves it, `robot place` needs"
    with pytest.raises(InputError, match=none):  # as of a YuMi, which no angle of any joint helps
        wrist_of(read(SEVEN, tmp_path))
    with pytest.raises(InputError, match=r"29\.8.*parallel, expected parallel; hold joint_a3 at another angle"):
        wrist_of(arm.holding("joint_a3", 0.52))


def test_of_seven_joints_whose_zero_is_turned_is_told_at_which_angle_to_hold_one(tmp_path: Path) -> None:
    arm = read(iiwa(), tmp_path)
    origins, limits = arm.origins.copy(), arm.limits_rad.copy()
    origins[2] = origins[2] @ rigid(exponential(np.array([0.0, 0.0, np.pi / 2])), np.zeros(3))
    limits[6] = 0.2, 1.4  # which may not be held at any of the angles that are tried
    turned = replace(arm, origins=origins, limits_rad=limits)
    with pytest.raises(InputError, match=r"; hold one where it shall stay \(--hold joint_a3=90( or|\))"):
        wrist_of(turned)
    wrist_of(turned.holding("joint_a3", np.pi / 2))


def test_of_seven_joints_that_were_calibrated_is_told_which_to_hold(tmp_path: Path) -> None:
    with pytest.raises(
        InputError, match=r"; hold one where it shall stay \(--hold joint_a3=0 or --hold joint_a7=0\)$"
    ):
        wrist_of(calibrated(read(iiwa(), tmp_path), 0))


def test_of_a_joint_that_leaves_no_closed_form_is_told_which_other_would(tmp_path: Path) -> None:
    with pytest.raises(
        InputError,
        match=r"hold joint_a4 at another angle, or another joint \(--hold joint_a3=0 or --hold joint_a7=0\)$",
    ):
        wrist_of(read(iiwa(), tmp_path).holding("joint_a4", 0.5))


def test_of_too_many_joints_held_is_told_to_hold_fewer(tmp_path: Path) -> None:
    told = r"has 5 joints, a closed form needs six; hold 1 fewer \(of joint_a3 and joint_a7\), so that six turn"
    with pytest.raises(InputError, match=told):
        wrist_of(read(iiwa(), tmp_path).holding("joint_a3", 0.0).holding("joint_a7", 0.0))
    with pytest.raises(InputError, match=r"has 5 joints.*hold 1 fewer \(of elbow\), so that six turn$"):
        wrist_of(read(ur(UR5E_M), tmp_path).holding("elbow", 0.0))
