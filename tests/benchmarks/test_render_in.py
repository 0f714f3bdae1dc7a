"""Balls put into a scan lie where they are said to lie, and are as blurred as the scan's own edges."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import special

from benchmarks.render_in import Series, with_balls
from benchmarks.seen_blur import edge_blur_mm, tissue_noise_hu
from ronnaplan.ct import CTVolume, SliceGrid
from tests.long import few_and_others

TILT = np.array([0.0, 0.4, 1.0])
GRID = SliceGrid(np.arange(60)[:, np.newaxis] * TILT * 0.5, np.array([0, 0.5, 0]), np.array([0.45, 0, 0]), 0.5)
"""Slices that slide along their columns, as a tilted gantry's do."""


def disc() -> CTVolume:
    """A cylinder of water, 60 mm wide, blurred by 0.55 mm, with noise of 6 HU."""
    rows, columns = np.indices((160, 160))
    places = np.stack([columns * 0.45, rows * 0.5], axis=-1) - [36.0, 40.0]
    share = special.ndtr((30.0 - np.linalg.norm(places, axis=-1)) / 0.55)
    noise = np.random.default_rng(3).normal(0.0, 6.0, (60, 160, 160))
    return CTVolume(np.round(1000.0 * share - 1000.0 + noise).astype(np.int16), GRID)


@few_and_others("profile", ["box"], ["bell"])
def test_a_ball_put_in_has_its_middle_and_volume_where_they_should_be(profile: str) -> None:
    air = CTVolume(np.full((60, 100, 100), -1000, np.int16), GRID)
    series = Series("air", air, 0.5, 0.0, np.full(60, 0.5))
    place = np.array([22.13, 29.41, 15.07])
    scan = with_balls(series, [place], 11.5, profile, np.random.default_rng(0))
    light = scan.voxels_hu.astype(np.float64) + 1000.0
    indices = np.argwhere(light > 0)
    weights = light[light > 0]
    middle = weights @ GRID.positions_mm(indices.astype(np.float64)) / weights.sum()
    assert middle == pytest.approx(place, abs=0.003)
    volume_mm3 = weights.sum() / 1120.0 * 0.5 * 0.45 * 0.5
    assert volume_mm3 == pytest.approx(np.pi / 6 * 11.5**3, rel=0.003)


def test_blur_and_noise_are_measured_off_the_scan_itself() -> None:
    scan = disc()
    assert edge_blur_mm(scan) == pytest.approx(0.55, abs=0.05)
    assert tissue_noise_hu(scan) == pytest.approx(6.0, rel=0.15)
