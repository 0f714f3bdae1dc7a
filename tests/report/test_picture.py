"""Pictures show what the numbers say."""

from __future__ import annotations

import numpy as np
import pytest

from ronnaplan.report.picture import cut_image
from ronnaplan.report.tables import align
from tests.scans import balls, scan, small_stack


def test_a_cut_through_a_marker_is_a_disc_in_the_middle() -> None:
    center = np.array([3.0, -4.0, 2.0])
    volume = scan(balls([tuple(center)]), small_stack(tilt_deg=12.0))
    for axes in ((0, 1), (0, 2), (1, 2)):
        image = cut_image(volume, center, axes, 10.0)
        bright = np.argwhere(image > -440)
        assert bright.mean(axis=0) == pytest.approx(np.array(image.shape) / 2 - 0.5, abs=0.5)
        assert len(bright) * 0.25**2 == pytest.approx(np.pi * 5.75**2, rel=0.03)


def test_columns_line_up() -> None:
    assert align([["a", "x", "note"], ["longer", "1.25", "-"]]) == "a          x  note\nlonger  1.25  -"
