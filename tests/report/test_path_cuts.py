"""The cuts of a trajectory tell which side of the patient is where, and its profile is seen on paper."""

from __future__ import annotations

import numpy as np

from ronnaplan.ct import CTVolume
from ronnaplan.planning import Head, Trajectory, measure
from ronnaplan.planning.trajectory import COLOURS
from ronnaplan.report.path_cuts import path_cut, path_figure
from ronnaplan.scene.cut import axes_beside
from tests import cases
from tests.scans import balls, scan, small_stack


def test_edges_are_named_after_the_patients_sides_and_the_profile_is_dark() -> None:
    head = Head.of(cases.volume())
    path = Trajectory("left", cases.ENTRY_MM, cases.TARGET_MM, head.volume.frame, colour=COLOURS[-1])
    cuts = path_figure(head.volume, measure(path, head)).axes
    named = [sorted((text.get_position()[0], text.get_text()) for text in one.texts) for one in cuts[:2]]
    assert [[name for _, name in one] for one in named] == [["R", "L"], ["A", "P"]]
    (profile,) = (line for line in cuts[2].lines if line.get_linestyle() == "-")
    assert profile.get_color() not in COLOURS


def test_what_lies_to_the_patients_left_is_drawn_where_the_letter_says() -> None:
    volume: CTVolume = scan(balls([(8.0, 0.0, 0.0)]), small_stack())
    path = Trajectory("A", np.array([0.0, 0.0, 20.0]), np.array([0.0, 0.0, -20.0]), volume.frame)
    across, _ = axes_beside(path.inward)
    columns = np.flatnonzero((path_cut(volume, path, across) > -300).any(axis=0))
    assert columns.min() > path_cut(volume, path, across).shape[1] // 2
