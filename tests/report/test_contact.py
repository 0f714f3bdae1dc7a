"""What a marker's model leaves over, as the report draws it."""

from __future__ import annotations

import numpy as np
import pytest

from ronnaplan import localize
from ronnaplan.report.contact import Candidate, residual_image
from ronnaplan.report.picture import CUTS
from tests.scans import balls, scan, small_stack

CENTER = (3.0, -4.0, 2.0)


@pytest.mark.parametrize("tilt_deg", [0.0, 12.0])
def test_a_ball_that_the_model_fits_leaves_only_noise_on_every_cut(tilt_deg: float) -> None:
    volume = scan(balls([CENTER]), small_stack(tilt_deg=tilt_deg), noise_hu=5.0)
    found = localize(volume, diameter_mm=11.5, expected=1).fiducials[0]
    for cut in CUTS:
        fitted = residual_image(volume, Candidate("F1", found.center_mm, found.parameters, True), cut, 9.0)
        assert np.std(fitted) < 8.0
        assert np.abs(fitted).max() < 0.05 * found.contrast_hu
        moved = Candidate("F1", found.center_mm + 0.5, found.parameters, True)
        assert np.abs(residual_image(volume, moved, cut, 9.0)).max() > 0.1 * found.contrast_hu


def test_a_marker_at_the_edge_of_the_scan_can_be_drawn() -> None:
    volume = scan(balls([(3.0, -4.0, 20.0)]), small_stack())
    row = Candidate("x", np.array([3.0, -4.0, 20.0]), localized_parameters(), False)
    assert np.isfinite(residual_image(volume, row, "coronal", 12.0)).all()


def localized_parameters() -> np.ndarray:
    volume = scan(balls([CENTER]), small_stack())
    return localize(volume, diameter_mm=11.5, expected=1).fiducials[0].parameters
