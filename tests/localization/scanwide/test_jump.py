"""A head that jumped between two slices: markers that the jump passes through tell of those above and below it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ronnaplan.geometry import FloatArray
from ronnaplan.localization import FiducialFlag, localize
from ronnaplan.localization.judge.motion import PATTERN_ERRORS_MM, PATTERNS, Movement
from ronnaplan.localization.scanwide.jump import jump_at_one_height
from tests.long import few_and_others
from tests.scans import balls, scan, small_stack

HEIGHTS_MM = np.array([-20.0, -0.3, 0.3, 20.0, 30.0])
RADII_MM = np.full(5, 5.0)


def showing(pattern: str, *errors: float) -> list[Movement]:
    """Return markers that show a pattern by so many standard errors each."""
    shown = np.array(PATTERNS) == pattern
    return [Movement(np.where(shown, one * PATTERN_ERRORS_MM, 0.0), np.zeros(len(PATTERNS))) for one in errors]


def told(pattern: str, *errors: float, heights_mm: FloatArray = HEIGHTS_MM) -> float:
    return jump_at_one_height(heights_mm, RADII_MM, showing(pattern, *errors))


@pytest.mark.parametrize("axis", ["u", "v", "w"])
def test_two_markers_tell_together_what_each_of_them_shows_too_little_of(axis: str) -> None:
    jump = f"jump {axis} at +0.0"
    assert told(jump, 0, 3.8, 3.8, 0, 0) > 4.0
    assert told(jump, 0, -3.8, -3.8, 0, 0) > 4.0
    assert told(jump, 0, 3.8, -3.8, 0, 0) == 0.0
    assert told(jump, 0, 6.0, 0, 0, 0) == 0.0


def test_what_all_markers_show_is_the_profile_of_their_slices() -> None:
    assert told("jump w at +0.0", 3.5, 3.5, 3.5, 3.5, 3.5) == 0.0


def test_markers_at_other_heights_show_no_common_jump() -> None:
    assert told("jump w at +0.0", 3.5, 0, 0, 3.5, 0) == 0.0
    apart = np.array([-20.0, -4.0, 4.0, 20.0, 30.0])
    assert told("jump w at +0.0", 0, 3.5, 3.5, 0, 0, heights_mm=apart) == 0.0


def test_markers_none_of_which_is_beyond_leave_nothing_to_compare_with() -> None:
    near = np.array([-0.6, -0.3, 0.0, 0.3, 0.6])
    assert told("jump w at +0.0", 3.5, 3.5, 3.5, 3.5, 3.5, heights_mm=near) == 0.0


@few_and_others("jump_mm", [0.0], [0.3])
def test_a_marker_beyond_a_jump_along_the_normal_is_doubted_though_it_is_whole(jump_mm: float) -> None:
    """Those above show nothing, and stand off by all of the jump to what is below."""
    crossed = [(-18.0, -15.3, -6.2), (17.4, -14.0, -5.1)]
    places = [*crossed, (1.2, 16.5, 8.3), (-18.0, 2.0, 8.1), (18.3, 3.1, 8.5)]
    before, after = (
        scan(balls([(x, y, z + shift) for x, y, z in places]), small_stack(), noise_hu=8.0, seed=seed)
        for seed, shift in enumerate((0.0, jump_mm))
    )
    above = (before.grid.slice_positions_mm > -5.6)[:, np.newaxis, np.newaxis]
    seen = replace(before, voxels_hu=np.where(above, after.voxels_hu, before.voxels_hu))
    found = localize(seen, diameter_mm=11.5, expected=5)
    assert [FiducialFlag.MOTION_SUSPECTED in one.flags for one in found] == [jump_mm > 0.0] * 5
