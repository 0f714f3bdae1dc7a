"""Arms that were calibrated, or whose angles are rounded: served as they are described, not as they were meant."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ronnaplan.geometry import FloatArray
from ronnaplan.robot.arm.arm import SerialArm
from ronnaplan.robot.arm.forward import LENGTH_MM, forward, jacobian
from ronnaplan.robot.arm.inverse import inverse
from ronnaplan.robot.arm.numeric import inverse_numeric
from ronnaplan.robot.arm.quality import singularity_deg
from ronnaplan.robot.arm.refined import REACHED, refined
from ronnaplan.robot.arm.wrist import wrist_of
from ronnaplan.transforms import exponential, rigid
from tests.long import few_and_others
from tests.robot.arm.arms import KR6, UR5E_M, calibrated, calibrated_ur5e, iiwa, panda, ur
from tests.robot.arm.test_kinematics import peer_poses, random_angles, read
from tests.robot.arm.test_wrist import turned

CLEAR_DEG = 8.0
"""As far from singular postures as a room asks for by default: nothing is missed there."""
TOLD = 2.0 * REACHED
"""So far off an entry of a pose may be, in mm per `LENGTH_MM` of the place: the turn's three parts, and rounding."""


MEANT = {"kr6": (KR6, None), "ur5e": (ur(UR5E_M), None), "panda": (panda(), "panda_joint7")}
"""Arms of each kind, and which of their joints is held."""


def meant(name: str, folder: Path) -> SerialArm:
    """Return one of the arms of `MEANT` as its maker means it."""
    text, held = MEANT[name]
    arm = read(text, folder)
    return arm if held is None else arm.holding(held, 0.5)


def missed(arm: SerialArm, found: FloatArray, asked: FloatArray) -> float:
    """Return by how much any posture that is told of (M, 8, 6) misses its pose, rad or mm per `LENGTH_MM`."""
    there = np.isfinite(found[..., 0])
    apart = forward(arm, found[there]) - np.repeat(asked[:, None], 8, axis=1)[there]
    apart[:, :3, 3] /= LENGTH_MM
    return float(np.abs(apart).max())


@pytest.mark.parametrize("name", MEANT)
@few_and_others("seed", range(1), range(1, 3))
def test_what_is_told_of_a_calibrated_arm_reaches_the_pose_and_hardly_anything_is_missed(
    name: str, seed: int, tmp_path: Path
) -> None:
    arm = calibrated(meant(name, tmp_path), seed)
    assert 1e-4 < wrist_of(arm).off < 1e-2
    angles = random_angles(arm, 2000, seed)
    asked = forward(arm, angles)
    found = inverse(arm, asked)
    assert missed(arm, found.angles_rad, asked) < TOLD
    away = np.nan_to_num(turned(found.angles_rad, angles[:, None]), nan=np.inf).min(axis=1)
    assert away[singularity_deg(arm, angles) > CLEAR_DEG].max() < 1e-9
    assert (away > 1e-6).mean() < (0.015 if name == "panda" else 0.01)
    middles = arm.limits_rad.mean(axis=1)
    assert np.nanmax(np.abs(found.angles_rad - middles)) < np.pi + 1e-9
    apart = turned(found.angles_rad[:, :, None], found.angles_rad[:, None])[:, ~np.eye(8, dtype=bool)]
    assert np.nanmin(apart) > 1e-6


@pytest.mark.parametrize(
    ("name", "clear_deg"), [("kr6", CLEAR_DEG), ("ur5e", CLEAR_DEG), ("panda", 2 * CLEAR_DEG)]
)
def test_a_posture_has_the_number_that_the_maker_s_arm_has_it_by(
    name: str, clear_deg: float, tmp_path: Path
) -> None:
    nominal = meant(name, tmp_path)
    arm = calibrated(nominal, 3)
    asked = forward(arm, random_angles(arm, 500, seed=3))
    by_the_makers, found = inverse(nominal, asked).angles_rad, inverse(arm, asked).angles_rad
    clear = np.nan_to_num(singularity_deg(nominal, np.nan_to_num(by_the_makers))) > clear_deg
    clear &= np.isfinite(by_the_makers[..., 0])
    assert clear.mean() > (0.3 if name == "panda" else 0.5)
    assert turned(found, by_the_makers)[clear].max() < 0.25  # others, so far from singular postures, are farther


@few_and_others("seed", [1], [2])
def test_near_singular_postures_none_is_told_twice_or_by_another_s_number(seed: int, tmp_path: Path) -> None:
    """Where two postures meet the Jacobian's determinant changes its sign, and one bit of their numbers is another."""
    arm = calibrated(read(KR6, tmp_path), seed, off_rad=3e-3, off_mm=1.0)
    rng = np.random.default_rng(seed)
    angles = random_angles(arm, 4000, seed)
    angles[:, 4] = rng.normal(0.0, 0.02, 4000)
    angles[2000:, 2] = np.arctan2(35.0, 420.0) + rng.normal(0.0, 0.05, 2000)
    asked = forward(arm, angles)
    found = inverse(arm, asked).angles_rad
    there = np.isfinite(found[..., 0])
    assert missed(arm, found, asked) < TOLD
    signs = np.sign(np.linalg.det(jacobian(arm, np.nan_to_num(found))))
    signs *= np.array([(-1) ** number.bit_count() for number in range(8)])
    assert len(np.unique(signs[there])) == 1
    apart = turned(found[:, :, None], found[:, None])[:, ~np.eye(8, dtype=bool)]
    assert np.nanmin(apart) > 1e-6


def test_a_flange_that_is_turned_by_half_a_turn_is_not_there(tmp_path: Path) -> None:
    """The sine of what is left to turn, by which the steps are taken, is zero there, too."""
    arm = calibrated(read(KR6, tmp_path), 0)
    wrist = wrist_of(arm)
    angles = np.tile(np.radians([20.0, -80, 100, 30, 50, -60]), (8, 1))
    pose = forward(arm, angles[0])
    number = 1 if np.linalg.det(jacobian(arm, angles[0])) * wrist.handed < 0 else 0
    assert refined(wrist.chain, wrist.handed, pose, angles, 1 << number) == 1 << number
    half_a_turn = pose @ rigid(exponential(np.array([0.0, 0.0, np.pi])), np.zeros(3))
    assert refined(wrist.chain, wrist.handed, half_a_turn, angles, 1 << number) == 0


def test_a_ur_from_the_factory_is_solved_as_pinocchio_moves_it(tmp_path: Path) -> None:
    text = calibrated_ur5e()
    arm = read(text, tmp_path)
    asked = peer_poses(text, "tool0", random_angles(arm, 60))
    found = inverse(arm, asked).angles_rad
    there = np.isfinite(found[..., 0])
    assert (there.sum(axis=1) == 8).mean() > 0.5
    back = peer_poses(text, "tool0", found[there])
    assert np.abs(back - np.repeat(asked[:, None], 8, axis=1)[there]).max() < 1e-9
    by_the_makers = inverse(read(ur(UR5E_M), tmp_path), asked).angles_rad
    there &= np.isfinite(by_the_makers[..., 0])
    off_mm = forward(arm, by_the_makers[there]) - np.repeat(asked[:, None], 8, axis=1)[there]
    assert np.abs(off_mm[:, :3, 3]).max() > 1.0


def test_all_that_the_numerical_inverse_finds_is_told(tmp_path: Path) -> None:
    arm = read(calibrated_ur5e(), tmp_path)
    count = 0
    for angles in random_angles(arm, 6, seed=4):
        asked = forward(arm, angles)
        numeric = inverse_numeric(arm, asked, starts=64)
        clear = numeric[singularity_deg(arm, numeric) > CLEAR_DEG]
        told = inverse(arm, asked[None]).angles_rad[0]
        told = told[np.isfinite(told[:, 0])]
        assert turned(clear[:, None], told).min(axis=1).max(initial=0.0) < 1e-6
        count += len(clear)
    assert count > 20


def test_it_does_not_matter_where_along_nearly_parallel_axes_their_frames_lie(tmp_path: Path) -> None:
    arm = read(calibrated_ur5e(), tmp_path)
    origins = arm.origins.copy()
    for n, along_mm in ((1, 9_000.0), (2, -6_000.0), (3, 4_000.0)):
        slid = rigid(np.eye(3), along_mm * arm.axes[n])
        origins[n], origins[n + 1] = origins[n] @ slid, np.linalg.inv(slid) @ origins[n + 1]
    slid_arm = replace(arm, origins=origins)
    asked = forward(arm, random_angles(arm, 500, seed=5))
    found, again = inverse(arm, asked).angles_rad, inverse(slid_arm, asked).angles_rad
    clear = np.nan_to_num(singularity_deg(arm, np.nan_to_num(found))) > CLEAR_DEG
    clear &= np.isfinite(found[..., 0])
    assert turned(again, found)[clear].max() < 1e-7


def test_beyond_the_reach_of_a_calibrated_arm_nothing_is_told(tmp_path: Path) -> None:
    arm = calibrated(read(KR6, tmp_path), 0)
    far = np.tile(np.eye(4), (200, 1, 1))
    far[:, 0, 3], far[:, 2, 3] = np.linspace(981.0, 1200.0, 200), 435.0
    assert np.isnan(inverse(arm, far).angles_rad).all()


def test_a_held_joint_may_leave_axes_that_are_only_nearly_parallel(tmp_path: Path) -> None:
    arm = read(iiwa(), tmp_path).holding("joint_a3", np.radians(0.3))
    angles = random_angles(arm, 500, seed=6)
    asked = forward(arm, angles)
    found = inverse(arm, asked).angles_rad
    assert missed(arm, found, asked) < TOLD
    away = np.nan_to_num(turned(found, angles[:, None]), nan=np.inf).min(axis=1)
    assert away[singularity_deg(arm, angles) > CLEAR_DEG].max() < 1e-9
