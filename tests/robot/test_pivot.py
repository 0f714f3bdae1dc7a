"""Pivot calibration: the tip, its uncertainty, and the poses in which the tip slipped."""

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from ronnaplan.errors import InputError
from ronnaplan.robot.pivot import calibrate_pivot

TIP = np.array([-15.0, 240.0, -7.0])
PIVOT = np.array([-800.0, -85, -2100])


def recording(
    seed: int, count: int = 600, noise_mm: float = 0.3, memory: float = 0.0, tilt_deg: float = 40
) -> np.ndarray:
    """Poses of a tool that swings about its resting tip, with noise that is correlated in time."""
    rng = np.random.default_rng(seed)
    t = np.linspace(0, 12 * np.pi, count)
    swing = np.radians(tilt_deg) * np.column_stack([np.sin(t), 0.6 * np.sin(0.4 * t), np.cos(0.7 * t)])
    rotations = Rotation.from_rotvec(swing).as_matrix()
    white = rng.normal(size=(count, 3)) * noise_mm * np.sqrt(1 - memory**2)
    noise = lfilter([1], [1, -memory], white, axis=0)
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, :3, :3] = rotations
    poses[:, :3, 3] = PIVOT - rotations @ TIP + noise
    return poses


def test_exact_poses_give_the_tip_and_the_pivot() -> None:
    found = calibrate_pivot(recording(0, noise_mm=0.0))
    np.testing.assert_allclose(found.tip_mm, TIP, atol=1e-6)
    np.testing.assert_allclose(found.pivot_mm, PIVOT, atol=1e-6)
    assert not found.slipped.any()


def test_moving_the_tracker_leaves_the_tip_and_moves_the_pivot() -> None:
    poses = recording(1)
    turn = np.eye(4)
    turn[:3, :3] = Rotation.from_rotvec([0.4, -1.0, 0.3]).as_matrix()
    turn[:3, 3] = (100, -50, 900)
    before, after = calibrate_pivot(poses), calibrate_pivot(turn @ poses)
    np.testing.assert_allclose(after.tip_mm, before.tip_mm, atol=1e-4)
    np.testing.assert_allclose(after.pivot_mm, turn[:3, :3] @ before.pivot_mm + turn[:3, 3], atol=1e-4)


def test_slips_are_named_and_do_not_pull_the_tip() -> None:
    poses = recording(2)
    slips = np.r_[100:140, 400:500]
    poses[slips, :3, 3] += (6.0, -4.0, 5.0)
    found = calibrate_pivot(poses)
    np.testing.assert_array_equal(np.flatnonzero(found.slipped), slips)
    assert found.slips == ((100, 139), (400, 499))
    assert np.linalg.norm(found.tip_mm - TIP) < 0.2
    assert found.rms_mm == pytest.approx(0.3 * np.sqrt(3), rel=0.1)
    assert found.residuals_mm[slips].min() > 6


@pytest.mark.parametrize("memory", [0.0, 0.9])
def test_the_stated_covariance_is_the_scatter_over_repeated_recordings(memory: float) -> None:
    """With the memory of a filtered tracker as well: then neighbouring poses hardly add information."""
    found = [calibrate_pivot(recording(seed, memory=memory)) for seed in range(60)]
    error = np.array([one.tip_mm for one in found]) - TIP
    observed = np.sqrt((error**2).sum(axis=1).mean())
    stated = np.sqrt(np.mean([np.trace(one.tip_covariance_mm2) for one in found]))
    assert 0.85 * observed < stated < 1.35 * observed


def test_the_stated_covariance_covers_a_block_bootstrap() -> None:
    poses = recording(3, memory=0.9)
    rng = np.random.default_rng(0)
    block = 60
    tips = []
    for _ in range(60):
        starts = rng.integers(0, len(poses) - block + 1, len(poses) // block)
        tips.append(calibrate_pivot(poses[(starts[:, None] + np.arange(block)).ravel()]).tip_mm)
    stated = np.sqrt(np.trace(calibrate_pivot(poses).tip_covariance_mm2))
    assert stated > 0.9 * np.sqrt(np.var(tips, axis=0).sum())


def test_poses_that_hardly_turn_are_refused() -> None:
    with pytest.raises(InputError, match="turn the tool"):
        calibrate_pivot(recording(4, tilt_deg=2))
    about_one_axis = np.tile(np.eye(4), (50, 1, 1))
    about_one_axis[:, :3, :3] = Rotation.from_rotvec(np.outer(np.linspace(-1, 1, 50), [0, 0, 1])).as_matrix()
    with pytest.raises(InputError, match="about two axes"):
        calibrate_pivot(about_one_axis)


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (lambda poses: poses * np.array([-1, 1, 1, 1]), "pivot pose 0 is left-handed"),
        (
            lambda poses: np.where(np.arange(len(poses))[:, None, None] == 7, np.nan, poses),
            "pivot pose 7 .* not finite",
        ),
        (lambda poses: poses[:5], "ten poses"),
        (lambda poses: poses[0], "shape"),
        (lambda poses: "poses", "not numbers"),
    ],
)
def test_unusable_poses_are_named(spoil: object, says: str) -> None:
    with pytest.raises(InputError, match=says):
        calibrate_pivot(spoil(recording(5)))  # type: ignore[operator]
