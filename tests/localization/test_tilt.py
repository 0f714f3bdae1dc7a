"""A contrast that slopes is met halfway: neither believed nor ignored."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ronnaplan.ct import CTVolume
from ronnaplan.localization import refine
from ronnaplan.localization.examine import Scan, fit_place
from ronnaplan.localization.refine import BallFit
from tests.scans import balls, scan, small_stack

CENTER = np.array([1.0, 2.0, 3.0])
SLOPE_PER_MM = 0.004


@pytest.fixture(scope="module")
def sloping() -> CTVolume:
    """A ball whose contrast grows by 0.4 % a millimetre towards +x."""
    flat = scan(balls([(1.0, 2.0, 3.0)]), small_stack(), noise_hu=0.0)
    indices = np.moveaxis(np.indices(flat.voxels_hu.shape), 0, -1).reshape(-1, 3)
    x = (flat.grid.positions_mm(indices) - CENTER)[:, 0].reshape(flat.voxels_hu.shape)
    ball = flat.voxels_hu + 1000.0
    return replace(flat, voxels_hu=(ball * (1 + SLOPE_PER_MM * x) - 1000.0).astype(np.float32))


def fitted(volume: CTVolume, belief: float, monkeypatch: pytest.MonkeyPatch) -> BallFit:
    monkeypatch.setattr(refine, "TILT_BELIEF", belief)
    return fit_place(Scan(volume), CENTER + 0.1, 11.5)


def test_the_slope_is_found_and_half_of_its_effect_is_taken(
    sloping: CTVolume, monkeypatch: pytest.MonkeyPatch
) -> None:
    flat, half, full = (fitted(sloping, belief, monkeypatch).center_mm for belief in (0.0, 0.5, 1.0))
    assert flat[0] - CENTER[0] > 0.004
    assert full == pytest.approx(CENTER, abs=0.0015)
    assert half == pytest.approx((flat + full) / 2, abs=1e-9)


def test_clipping_that_hides_the_balls_own_level_hides_its_slope(
    sloping: CTVolume, monkeypatch: pytest.MonkeyPatch
) -> None:
    clipped = replace(sloping, voxels_hu=np.minimum(4.0 * (sloping.voxels_hu + 1000.0) - 1000.0, 2500.0))
    flat, full = (fitted(clipped, belief, monkeypatch).center_mm for belief in (0.0, 1.0))
    assert full == pytest.approx(flat, abs=1e-12)
