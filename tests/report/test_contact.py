"""What a marker's model leaves over, as the contact sheet and the report draw it."""

from __future__ import annotations

import numpy as np
import pytest

from ronnaplan import localize
from ronnaplan.report.contact import Candidate, _left_over
from ronnaplan.report.picture import CUTS, cut_image
from tests.scans import balls, scan, small_stack

CENTER = (3.0, -4.0, 2.0)
REACH_MM = 9.0


@pytest.mark.parametrize("tilt_deg", [0.0, 12.0])
def test_a_ball_that_the_model_fits_leaves_only_noise_on_every_cut(tilt_deg: float) -> None:
    volume = scan(balls([CENTER]), small_stack(tilt_deg=tilt_deg), noise_hu=5.0)
    found = localize(volume, diameter_mm=11.5, expected=1).fiducials[0]
    fitted = Candidate("F1", found.center_mm, found.parameters, accepted=True)
    moved = Candidate("F1", found.center_mm + 0.5, found.parameters, accepted=True)
    for axes in CUTS.values():
        rest = cut_image(_left_over(volume, fitted, REACH_MM), found.center_mm, axes, REACH_MM, outside_hu=0.0)
        assert np.std(rest) < 8.0
        assert np.abs(rest).max() < 0.05 * found.contrast_hu
        wrong = cut_image(_left_over(volume, moved, REACH_MM), found.center_mm, axes, REACH_MM, outside_hu=0.0)
        assert np.abs(wrong).max() > 0.1 * found.contrast_hu
