"""Balls that moved while they were scanned are flagged, still ones are not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import fft, ndimage

from ronnaplan.ct import CTVolume
from ronnaplan.geometry import FloatArray
from ronnaplan.localization import FiducialFlag, Fiducials, localize
from tests.long import few_and_others, few_or_all
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


@few_or_all("cases", 2, 3)
def test_still_balls_are_not_suspected(cases: int) -> None:
    assert [flags(seen(seed=seed)) for seed in range(cases)] == [[False] * 3] * cases


@few_and_others("shift", [(0.5, 0.0, 0.0)], [(0.0, -0.4, 0.3), (0.6, 0.2, -0.1)])
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
