"""A ball whose filling has settled to one side is found where it is, not nearer to that side."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ronnaplan.ct import CTVolume
from ronnaplan.localization.examine import fit_place
from ronnaplan.localization.fit import refine, uneven
from ronnaplan.localization.fit.ball_fit import BallFit
from ronnaplan.localization.fit.uneven import LEAST_UNEVEN
from ronnaplan.localization.judge.uncertainty import STILL_UNEVEN
from ronnaplan.localization.localizer import localize
from ronnaplan.localization.scanner.scan import Scan
from tests.scans import balls, offsets_mm, scan, small_stack

CENTER = np.array([1.0, 2.0, 3.0])
DIAMETER_MM = 11.5
TOWARDS = np.array([0.6, 0.0, 0.8])


def settled(share: float, spacing_mm: float = 0.8, deep_mm: float = 0.0) -> CTVolume:
    """A ball that is brighter by this share of its contrast at its surface, on one side, and fainter on the other.

    Within ``deep_mm`` of its center it is even.
    """
    even = scan(balls([(1.0, 2.0, 3.0)]), small_stack(spacing_mm=spacing_mm), noise_hu=10.0)
    away_mm = offsets_mm(even, CENTER)
    along_mm = np.tensordot(TOWARDS, away_mm, 1) * (np.linalg.norm(away_mm, axis=0) > deep_mm)
    ball_hu = np.maximum(even.voxels_hu + 1000.0, 0.0)
    voxels_hu = even.voxels_hu + ball_hu * share * along_mm / (DIAMETER_MM / 2.0)
    return replace(even, voxels_hu=voxels_hu.astype(np.float32))


def fitted(volume: CTVolume) -> BallFit:
    return fit_place(Scan(volume), CENTER + 0.1, DIAMETER_MM)


def test_an_uneven_ball_is_found_where_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    volume = settled(0.1)
    assert np.linalg.norm(fitted(volume).center_mm - CENTER) < 0.006
    monkeypatch.setattr(refine, "uneven_hu", lambda _fit: None)
    assert np.linalg.norm(fitted(volume).center_mm - CENTER) > 0.02


def test_nothing_is_made_of_less_than_scanners_and_heads_do() -> None:
    assert fitted(settled(0.0)).neighbourhood.evened_mm is None
    assert fitted(settled(0.8 * LEAST_UNEVEN)).neighbourhood.evened_mm is None


def test_what_edges_alone_tell_is_no_uneven_filling(monkeypatch: pytest.MonkeyPatch) -> None:
    """Balls of aluminium on pegs as wide as they are came out 60 to 100 um nearer to the head."""
    volume = settled(0.3, deep_mm=0.86 * DIAMETER_MM / 2.0)
    assert fitted(volume).neighbourhood.evened_mm is None
    monkeypatch.setattr(uneven, "LEAST_SHOWN", -1.0)
    assert fitted(volume).neighbourhood.evened_mm is not None


def test_a_share_of_how_far_it_was_moved_is_stated() -> None:
    volume = settled(0.1)
    (marker,) = localize(volume, diameter_mm=DIAMETER_MM)
    moved_mm = fitted(volume).neighbourhood.evened_mm
    assert moved_mm is not None
    assert moved_mm @ TOWARDS == pytest.approx(-np.linalg.norm(moved_mm), rel=0.1)
    assert TOWARDS @ marker.covariance_mm2 @ TOWARDS > (0.9 * STILL_UNEVEN * np.linalg.norm(moved_mm)) ** 2


def test_a_flat_panels_pictures_tell_nothing_of_it() -> None:
    """Scatter shades balls there, too: markers came out farther off."""
    assert fitted(settled(0.1, spacing_mm=0.5)).neighbourhood.evened_mm is None
