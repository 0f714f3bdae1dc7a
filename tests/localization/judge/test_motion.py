"""Balls that moved while they were scanned are flagged, still ones are not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import fft, ndimage

from ronnaplan.ct import CTVolume
from ronnaplan.geometry import FloatArray
from ronnaplan.localization import FiducialFlag, Fiducials, localize
from ronnaplan.localization.judge.motion import PATTERN_ERRORS_MM, PATTERNS, Movement, suspected
from tests.scans import balls, scan, small_stack

PLACES = np.array([(-18.0, -15.3, -6.2), (17.4, -14.0, 3.1), (1.2, 16.5, 7.3)])
MOVED = FiducialFlag.MOTION_SUSPECTED


def seen(shift_mm: tuple[float, float, float] = (0, 0, 0), seed: int = 1) -> CTVolume:
    centers = [(float(x), float(y), float(z)) for x, y, z in PLACES + np.array(shift_mm)]
    return scan(balls(centers), small_stack(), noise_hu=8.0, seed=seed)


def flags(volume: CTVolume) -> list[bool]:
    """Whether each ball, from the lowest up, is suspected."""
    found: Fiducials = localize(volume, diameter_mm=11.5, expected=3)
    return [MOVED in one.flags for one in reversed(found.fiducials)]


def mixed(first: CTVolume, second: CTVolume, share: FloatArray) -> CTVolume:
    """Voxels of both scans, of the second by ``share`` (K,)."""
    part = share[:, np.newaxis, np.newaxis]
    voxels = first.voxels_hu * (1 - part) + second.voxels_hu * part
    return replace(first, voxels_hu=np.round(voxels).astype(np.int16))


def test_still_balls_are_not_suspected() -> None:
    assert [flags(seen(seed=seed)) for seed in range(3)] == [[False] * 3] * 3


@pytest.mark.parametrize("shift", [(0.5, 0.0, 0.0), (0.0, -0.4, 0.3), (0.6, 0.2, -0.1)])
def test_a_jump_between_slices_is_told_by_the_ball_that_it_met(shift: tuple[float, float, float]) -> None:
    still, after = seen(), seen(shift, seed=2)
    heights = still.grid.slice_positions_mm
    assert flags(mixed(still, after, (heights > PLACES[0, 2] + 1.0).astype(np.float64))) == [True, False, False]
    assert flags(mixed(still, after, (heights > 14.0).astype(np.float64))) == [False, False, False]


def test_a_still_scan_that_was_blurred_aslant_is_not_suspected() -> None:
    still = seen()
    voxels = still.voxels_hu.astype(float)
    slanted = [
        ndimage.shift(voxels, (0.8 * step, 0, 1.6 * step), order=1, mode="nearest") for step in (-1.0, 0.0, 1.0)
    ]
    voxels_hu = np.asarray(np.round(np.mean(slanted, axis=0)), dtype=np.int16)
    assert flags(replace(still, voxels_hu=voxels_hu)) == [False] * 3


def test_odd_and_even_slices_in_different_places_are_told() -> None:
    still, other = seen(), seen((0.06, 0.0, 0.0), seed=2)
    assert (
        flags(mixed(still, other, np.asarray(np.arange(len(still.voxels_hu)) % 2, dtype=np.float64))) == [True] * 3
    )


def test_a_drift_that_is_small_in_each_ball_is_told_by_all() -> None:
    still = seen()
    steps = 0.016 * still.grid.slice_positions_mm
    voxels = [
        ndimage.shift(picture.astype(float), (0, step / still.grid.column_spacing_mm), order=5, mode="nearest")
        for picture, step in zip(still.voxels_hu, steps, strict=True)
    ]
    assert flags(replace(still, voxels_hu=np.round(voxels).astype(np.int16))) == [True] * 3


def test_a_jump_within_one_half_turn_is_told_by_the_directions_of_the_edges() -> None:
    still, after = seen(), seen((0.6, 0.3, 0.0), seed=2)
    rows, columns = (fft.fftfreq(size, 0.5) for size in still.voxels_hu.shape[1:])
    # the direction that the rays of each frequency face, as a share of the half turn
    turn = np.mod(np.arctan2(rows[:, np.newaxis], columns), np.pi) / np.pi
    late = turn > 0.45
    spectrum = np.where(late, fft.fft2(after.voxels_hu.astype(float)), fft.fft2(still.voxels_hu.astype(float)))
    assert any(flags(replace(still, voxels_hu=np.round(fft.ifft2(spectrum).real).astype(np.int16))))


def test_a_head_that_settles_as_a_cone_beam_begins_to_turn_is_told_by_all() -> None:
    """By 0.66 mm: what is bent shows less at the edges than beside them. Opposite views tell the same."""
    still = scan(balls([(x, y, z) for x, y, z in PLACES], 8.0), small_stack(spacing_mm=0.5), seed=2)
    steps_mm = (0.5, 0.5, 0.5)
    across, down, along = np.meshgrid(
        *(fft.fftfreq(size, step) for size, step in zip(still.voxels_hu.shape, steps_mm, strict=True)),
        indexing="ij",
    )
    turned = np.mod(np.arctan2(down, along), np.pi) / (2.0 * np.pi)
    waves = 2j * np.pi * (0.6 * along + 0.25 * down + 0.1 * across)
    seen_twice = [np.exp(waves * np.exp(-(turned + later) / 0.15)) for later in (0.0, 0.5)]
    moved = fft.ifftn(fft.fftn(still.voxels_hu.astype(float)) * np.mean(seen_twice, axis=0)).real
    found = [
        localize(one, diameter_mm=8.0, expected=3)
        for one in (still, replace(still, voxels_hu=np.round(moved).astype(np.int16)))
    ]
    assert [[MOVED in one.flags for one in some] for some in found] == [[False] * 3, [True] * 3]


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
