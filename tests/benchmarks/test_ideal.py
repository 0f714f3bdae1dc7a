"""The plain fit that is told where to look finds a plain ball."""

from __future__ import annotations

import numpy as np

from benchmarks.ideal import ideal_center
from tests.scans import balls, scan, small_stack

CENTER = np.array([1.3, -2.4, 3.1])


def test_a_ball_in_tilted_slices_is_fitted_to_a_few_micrometres() -> None:
    volume = scan(balls([tuple(CENTER)]), small_stack(tilt_deg=12.0), noise_hu=2.0)
    assert np.linalg.norm(ideal_center(volume, CENTER, 11.5) - CENTER) < 0.005
    aside = CENTER + np.array([0.3, -0.2, 0.4])
    assert np.linalg.norm(ideal_center(volume, aside, 11.5) - CENTER) < 0.005
