"""Balls that scatter bends so far that no fit comes to rest, in scans by rays that share nothing with phantoms."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from ronnaplan.ct import CTVolume
from ronnaplan.geometry import FloatArray
from ronnaplan.localization.build import SOLID
from ronnaplan.localization.examine import fit_place
from ronnaplan.localization.fit.ball_fit import BallFit
from ronnaplan.localization.fit.parameters import BACKGROUND
from ronnaplan.localization.scanner.hardened import MOST_OFF, MadeGood
from ronnaplan.localization.scanner.scan import Scan
from tests.localization.scanner.test_hardened import (
    CENTER_MM,
    COARSE_RAY_MM,
    HEIGHTS_MM,
    ONE_ENERGY,
    RADIUS_MM,
    fitted,
    pulled_mm,
    scanned,
    untouched,
)

PLASTIC_PER_MM = 1.3 * ONE_ENERGY
SOME, MUCH = 0.1, 0.8
"""Scatter, of which half as much as of primary rays, and five times as much, arrives behind the middle of the head."""

NOISE_HU = 100.0

OTHER_HEIGHTS_MM = np.linspace(-5.6, 5.6, 17)
"""Slices that are no pixel, and no two pixels, apart."""


@cache
def beside_a_head(scatter: float, *, is_a_panels: bool = True) -> CTVolume:
    """A ball of plastic on its post beside a head, as a panel or other rows see it."""
    heights_mm: FloatArray = HEIGHTS_MM if is_a_panels else OTHER_HEIGHTS_MM
    volume = scanned(PLASTIC_PER_MM, ONE_ENERGY, 0.0, scatter=scatter, ray_mm=COARSE_RAY_MM, heights_mm=heights_mm)
    assert volume.grid.may_be_a_panels == is_a_panels
    return volume


def at_the_ball(volume: CTVolume, made_good: MadeGood, stated_mm: float = 2.0 * RADIUS_MM) -> BallFit:
    return fit_place(Scan(volume), CENTER_MM + np.array([0.1, -0.1, 0.05]), stated_mm, SOLID, made_good)


def test_what_scatter_fades_of_plastic_is_made_good() -> None:
    before, after = untouched(beside_a_head(SOME)), fitted(beside_a_head(SOME))
    assert abs(pulled_mm(before)) > 0.04
    assert abs(pulled_mm(after)) < 0.1 * abs(pulled_mm(before))
    assert after.misfit < 0.4 * before.misfit


def test_bare_balls_are_not_covered_where_the_scale_has_hidden_how_dark_it_is_beside_them() -> None:
    fit = fitted(beside_a_head(SOME))
    seen = fit.neighbourhood
    assert (
        (seen.values_hu <= seen.floors_hu) & (seen.values_hu > fit.theta[BACKGROUND] + 0.06 * fit.contrast_hu)
    ).any()
    assert not fit.verdict.is_covered


def test_it_is_believed_in_noise() -> None:
    volume = beside_a_head(SOME)
    noise_hu = np.random.default_rng(5).normal(0.0, NOISE_HU, volume.voxels_hu.shape)
    noisy = replace(volume, voxels_hu=volume.voxels_hu + np.round(noise_hu).astype(np.int16))
    gained_hu = [fitted(one).contrast_hu - untouched(one).contrast_hu for one in (volume, noisy)]
    assert gained_hu[1] == pytest.approx(gained_hu[0], rel=0.3)


def test_a_ball_that_scatter_bends_comes_to_rest() -> None:
    volume = beside_a_head(MUCH)
    assert not at_the_ball(volume, MadeGood.NOTHING).converged
    fit = at_the_ball(volume, MadeGood.ALL)
    assert fit.converged
    assert fit.verdict.round_share > 0.8
    assert fit.center_mm == pytest.approx(CENTER_MM, abs=0.04)


def test_it_is_not_believed_of_what_comes_out_of_another_size() -> None:
    larger_mm = (1.0 + 3.0 * MOST_OFF) * 2.0 * RADIUS_MM
    assert not at_the_ball(beside_a_head(MUCH), MadeGood.ALL, larger_mm).converged


def test_rows_with_septa_are_not_believed_to_receive_so_much_scatter() -> None:
    assert not at_the_ball(beside_a_head(MUCH, is_a_panels=False), MadeGood.ALL).converged
