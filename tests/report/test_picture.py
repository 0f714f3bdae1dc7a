"""Pictures show what the numbers say."""

from __future__ import annotations

import numpy as np
import pytest

from ronnaplan.report.head import head_view
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


def test_the_head_view_marks_the_markers_where_it_says_they_are() -> None:
    center = np.array([[3.0, -4.0, 2.0]])
    view = head_view(scan(balls([(3.0, -4.0, 2.0)]), small_stack()), center, 11.5)
    lit = np.argwhere(view.image.sum(axis=-1) > 0)
    up, across = lit.mean(axis=0) * 1.5
    expected = view.project(center)[0] - [view.extent_mm[0], view.extent_mm[2]]
    assert [across, up] == pytest.approx(expected, abs=1.0)


def test_an_empty_scan_can_be_drawn() -> None:
    view = head_view(scan(balls([(300.0, 0.0, 0.0)]), small_stack()), np.empty((0, 3)), 11.5)
    assert view.image.max() == 0.0


def test_columns_line_up() -> None:
    assert align([["a", "x", "note"], ["longer", "1.25", "-"]]) == "a          x  note\nlonger  1.25  -"
