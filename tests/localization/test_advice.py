"""A scan's settings are only found wanting where they cost something, and each advice says what it rests on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ronnaplan.ct import SeriesSource, SliceGrid
from ronnaplan.localization import Fiducial, FiducialFlag, Fiducials
from ronnaplan.localization.advice import recommended_settings
from ronnaplan.localization.fit.parameters import BLUR, EDGE, PARAMETERS, RADIUS, SHAPE, WIDTH


def grid(pixel_mm: float = 0.5, gap_mm: float = 1.0) -> SliceGrid:
    origins = np.arange(20)[:, np.newaxis] * [0, 0, gap_mm]
    return SliceGrid(origins, np.array([0, pixel_mm, 0]), np.array([pixel_mm, 0, 0]), 1.0)


def found(width_mm: float = 1.0, blur_mm: float = 0.5, edge: float = 0.1) -> Fiducials:
    parameters = np.zeros(len(PARAMETERS))
    parameters[[RADIUS, BLUR, EDGE, WIDTH, SHAPE]] = 5.75, blur_mm, edge, width_mm, 0.0
    covariance = np.eye(3) * 1e-5
    one = Fiducial("F1", np.zeros(3), covariance, covariance, parameters, 0.9, 0.01)
    return Fiducials((one,), (), (11.5,), SeriesSource(), "", stated_thickness_mm=1.0)


def test_a_good_scan_has_nothing_to_gain() -> None:
    assert recommended_settings(grid(), found()) == ()
    assert recommended_settings(grid(), replace(found(), fiducials=())) == ()


def test_each_shortcoming_is_named_with_what_was_found() -> None:
    cases = {
        "slice thickness": (grid(), found(width_mm=5.0), "5.00 mm"),
        "field of view": (grid(pixel_mm=0.9), found(), "0.90 mm"),
    }
    for setting, (places, markers, seen) in cases.items():
        (advice,) = recommended_settings(places, markers)
        assert advice.setting == setting
        assert seen in advice.found
    (soft,) = recommended_settings(grid(), found(blur_mm=1.1))
    (sharp,) = recommended_settings(grid(), found(edge=2.0))
    assert (soft.setting, sharp.setting) == ("kernel", "kernel")
    assert soft.reason != sharp.reason


def test_slices_that_touch_are_not_told_to_lie_nearer() -> None:
    """A box of 1 mm is fitted as 0.97 mm wide at half height at times: that leaves nothing unseen."""
    touching = found(width_mm=0.97)
    assert recommended_settings(grid(gap_mm=1.0), touching) == ()
    gapped = replace(touching.fiducials[0], flags=(FiducialFlag.GAPPED,))
    (advice,) = recommended_settings(grid(gap_mm=1.5), replace(touching, fiducials=(gapped,)))
    assert advice.setting == "slice spacing"
    assert advice.reason == str(FiducialFlag.GAPPED)


def test_flags_are_turned_into_what_to_do() -> None:
    markers = found()
    flagged = replace(markers.fiducials[0], flags=(FiducialFlag.CUT,))
    (advice,) = recommended_settings(grid(), replace(markers, fiducials=(flagged,)))
    assert advice.setting == "scan length"
    assert "F1" in advice.found
