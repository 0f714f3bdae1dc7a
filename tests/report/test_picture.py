"""Pictures show what the numbers say."""

from __future__ import annotations

import numpy as np
import pytest

from ronnaplan.report.picture import cut_image, sampled
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


def test_between_voxels_lies_what_lies_between_their_values_and_beyond_them_what_was_asked_for() -> None:
    k, j, i = np.indices((3, 4, 5))
    voxels = (100 * k * j + 10 * i).astype(np.int16)  # linear along each axis
    indices = np.array([[0.0, 0.0, 0.0], [1.25, 2.5, 3.75], [2.0, 3.0, 4.0], [2.01, 3.0, 4.0], [1.0, -0.01, 1.0]])
    expected = [0.0, 100 * 1.25 * 2.5 + 37.5, 640.0, -7.0, -7.0]
    np.testing.assert_allclose(sampled(voxels, indices, -7.0), expected, rtol=1e-6)


def test_columns_line_up() -> None:
    assert align([["a", "x", "note"], ["longer", "1.25", "-"]]) == "a          x  note\nlonger  1.25  -"
