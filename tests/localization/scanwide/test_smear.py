"""A head that jumped while a turn went around it smears all markers alike; gantries and reformats smear otherwise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ronnaplan.geometry import FloatArray
from ronnaplan.localization import FiducialFlag, localize
from ronnaplan.localization.scanwide.moving import are_smeared
from tests.scans import balls, scan, small_stack

ROUND = np.diag([0.1, 0.1, 0.08])


def markers(count: int, seed: int = 1) -> tuple[FloatArray, FloatArray]:
    """Places (N, 3) about a head, and what a kernel makes of each (N, 3, 3), nearly alike."""
    random = np.random.default_rng(seed)
    places_mm = random.uniform([-80, -90, 0], [80, 90, 120], (count, 3))
    scatter = 0.004 * random.standard_normal((count, 3, 3))
    return places_mm, ROUND + (scatter + scatter.transpose(0, 2, 1)) / 2.0


def jump(x_mm: float, y_mm: float, z_mm: float) -> FloatArray:
    """What half a turn before a jump and half a turn behind it add to every blur (3, 3)."""
    way_mm = np.array([x_mm, y_mm, z_mm])
    return np.outer(way_mm, way_mm) / 4.0


def turn(places_mm: FloatArray, axis_mm: tuple[float, float], rim_mm2: float = 0.25) -> FloatArray:
    """What a gantry that turns about an axis while it looks adds (N, 3, 3)."""
    x, y = ((places_mm[:, :2] - axis_mm) / 100.0).T
    across = np.stack([-y, x, np.zeros_like(x)], axis=1)
    told: FloatArray = rim_mm2 * across[:, :, np.newaxis] * across[:, np.newaxis, :]
    return told


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("axis_mm", [(0.0, 0.0), (25.0, -30.0)])
def test_a_jump_is_told_beside_the_blur_of_a_turning_gantry(seed: int, axis_mm: tuple[float, float]) -> None:
    places_mm, blurs_mm2 = markers(12, seed)
    turning = blurs_mm2 + turn(places_mm, axis_mm)
    assert not are_smeared(places_mm, blurs_mm2)
    assert not are_smeared(places_mm, turning)
    assert are_smeared(places_mm, turning + jump(0.4, -0.3, 0.1))


def test_nothing_is_told_by_few_markers_by_one_or_by_thicker_slices_that_lay_aslant() -> None:
    places_mm, blurs_mm2 = markers(12)
    moved = blurs_mm2 + jump(0.4, -0.3, 0.1)
    assert not are_smeared(places_mm[:5], moved[:5])
    assert not are_smeared(places_mm, np.concatenate([moved[:2], blurs_mm2[2:]]))
    assert not are_smeared(places_mm, blurs_mm2 + jump(0.2, -0.2, 0.6))
    unknown = np.where((np.arange(12) < 7)[:, np.newaxis, np.newaxis], np.nan, moved)
    assert not are_smeared(places_mm, unknown)
    assert are_smeared(places_mm, np.concatenate([moved[:10], np.full((2, 3, 3), np.nan)]))


@pytest.mark.parametrize(("jump_mm", "has_moved"), [(0.0, False), (0.5, True)])
def test_markers_that_are_seen_in_two_places_at_once_are_flagged(jump_mm: float, has_moved: bool) -> None:
    centers = [(x, y, 0.3 * x - 0.4 * y) for x in (-19.0, 0.3, 19.0) for y in (-11.0, 10.4)]
    before, behind = (
        scan(
            balls([(x + 0.8 * shift, y + 0.6 * shift, z) for x, y, z in centers]),
            small_stack(spacing_mm=0.5),
            seed=seed,
        )
        for seed, shift in enumerate((0.0, jump_mm))
    )
    both = np.round((before.voxels_hu.astype(float) + behind.voxels_hu) / 2.0).astype(np.int16)
    found = localize(replace(before, voxels_hu=both), diameter_mm=11.5, expected=6)
    assert [FiducialFlag.MOTION_SUSPECTED in one.flags for one in found] == [has_moved] * 6
