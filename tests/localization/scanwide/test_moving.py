"""A head that moved: what a scan's markers show alike of it, a smear of all of them among that."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ronnaplan.geometry import FloatArray
from ronnaplan.localization import FiducialFlag, localize
from ronnaplan.localization.judge.motion import PATTERN_ERRORS_MM, PATTERNS, Movement
from ronnaplan.localization.scanwide.moving import are_smeared, suspected
from tests.scans import balls, scan, small_stack

ROUND = np.diag([0.1, 0.1, 0.08])


def showing(pattern: str, errors: float) -> Movement:
    """Return a marker that shows one pattern by so many standard errors, and no other."""
    amplitudes_mm = np.where(np.array(PATTERNS) == pattern, errors * PATTERN_ERRORS_MM, 0.0)
    return Movement(amplitudes_mm, np.zeros(len(PATTERNS)))


def test_a_jump_that_two_markers_show_alike_is_told_by_all() -> None:
    """Each by itself shows too little; markers above and below stood in two places, though they show nothing."""
    still, moved = [showing("drift u", 0.4)] * 4, showing("jump u at +0.0", 2.5)
    assert suspected([*still, moved, moved]) == [True] * 6
    assert suspected([*still, moved, showing("jump u at +0.0", -2.5)]) == [False] * 6
    assert suspected([*still, moved]) == [False] * 5
    assert suspected([*still, *[showing("jump w at +0.0", 2.5)] * 2]) == [False] * 6
    assert suspected([*[showing("drift u", 0.8)] * 4, moved, moved]) == [False] * 6


def test_of_many_markers_as_large_a_share_has_to_show_a_jump_alike() -> None:
    """The more there are, the sooner two show the same by chance; a jump is met by a share of them."""
    still = showing("drift u", 0.4)
    for pattern, errors, enough in (("jump u at +0.0", 2.5, 5), ("across sin", 3.3, 8)):
        moved = showing(pattern, errors)
        assert suspected([*[still] * (50 - enough), *[moved] * enough]) == [True] * 50
        assert suspected([*[still] * (51 - enough), *[moved] * (enough - 1)]) == [False] * 50


def test_what_all_markers_of_a_cone_beam_show_from_slice_to_slice_is_told_by_none() -> None:
    """Rays that slant make it, in one direction here and in another there; edges within the slices tell as ever."""
    usual = [showing("drift u", sign * 2.5) for sign in (1.0, -1.0, 1.0, -1.0, 1.0)]
    assert suspected([*usual, showing("drift u", -6.0)]) == [*[False] * 5, True]
    assert suspected([*usual, showing("drift u", -6.0)], in_cubes=True) == [False] * 6
    assert suspected([*usual, showing("drift u", -9.0)], in_cubes=True) == [*[False] * 5, True]
    assert suspected([*usual, showing("third cos", 6.0)], in_cubes=True) == [*[False] * 5, True]
    still = [showing("drift u", sign * 0.5) for sign in (1.0, -1.0, 1.0, -1.0, 1.0)]
    assert suspected([*still, showing("drift u", -6.0)], in_cubes=True) == [*[False] * 5, True]


def test_little_that_all_markers_show_is_told_unless_a_cone_beam_makes_it() -> None:
    """A head that drifts in the turns of an axial scan bends every ball by 7 um in one sense; no still scan by 1."""
    bent = [showing("third sin", 1.75)] * 20
    assert suspected(bent) == [True] * 20
    assert suspected(bent, in_cubes=True) == [False] * 20
    assert suspected([*bent[:9], *[showing("third sin", 0.2)] * 11]) == [False] * 20


def test_what_three_markers_of_one_turn_show_alike_is_told_by_all() -> None:
    """A head that jumped while one turn made 20 mm of slices: their markers, off by 0.2 mm, each show too little."""
    still, bent = [showing("drift u", 0.4)] * 5, showing("across sin", 3.3)
    assert suspected([*still, bent, bent, bent]) == [True] * 8
    assert suspected([*still, bent, bent]) == [False] * 7
    assert suspected([*still, bent, bent, showing("across sin", -3.3)]) == [False] * 8
    assert suspected([*still, bent, bent, bent], in_cubes=True) == [False] * 8


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
