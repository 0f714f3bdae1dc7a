"""What a scan's balls show in common is the scan's; what one alone shows is its own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ronnaplan.localization.build import SOLID, Build
from ronnaplan.localization.examine import Examined
from ronnaplan.localization.fit.parameters import BLUR
from ronnaplan.localization.judge.evidence import Usual
from ronnaplan.localization.scanner.scan import Scan
from ronnaplan.localization.scanwide.usual import (
    BLURRED_MM2,
    by_the_usual,
    unlike_turned_down,
    usual_of,
    usual_profiles_mm,
)
from tests.localization.scanwide.shown import at

TOO_WIDE = (("thickness", "its ends are blurred"),)


def test_a_profile_wider_than_the_header_says_is_the_scans_where_all_its_balls_show_it(ball: Examined) -> None:
    wide = [replace(at(ball, 20.0 * n, width=5.0 + 0.1 * n), failures=TOO_WIDE) for n in range(1, 4)]
    assert usual_of(wide).broadening_mm == pytest.approx(5.2 - ball.thickness_mm + 0.75)
    assert usual_of(wide[:2]).broadening_mm == 0.0  # of two nobody knows
    assert usual_of([wide[0], *wide[:2]]).broadening_mm == 0.0  # one place, seen twice
    assert usual_of([ball, *wide]).broadening_mm == 0.0  # one ball is as the header says: the others are none


def test_the_slices_are_as_thick_as_the_markers_show_at_the_median(ball: Examined) -> None:
    shown = [at(ball, 20.0 * n, width=width_mm, shape=0.0) for n, width_mm in enumerate((0.6, 0.7, 2.4, 0.6))]
    assert usual_profiles_mm(shown) == pytest.approx([0.65] * 4)
    assert usual_profiles_mm(shown[1:3]) == pytest.approx([0.7, 2.4])  # of two nobody knows


def test_a_ragged_edge_is_usual_where_the_markers_nearest_in_height_show_it(ball: Examined) -> None:
    """Cone beams make edges ragged far from the plane of their source, and leave those near it clean."""

    def lifted(height_mm: float, misfit: float) -> Examined:
        return replace(ball, center_mm=ball.center_mm + np.array([0.0, 0.0, height_mm]), misfit=misfit)

    shown = usual_of([lifted(height_mm, (100.0 - height_mm) / 2000.0) for height_mm in range(10, 100, 10)])
    normal = np.array([0.0, 0.0, 1.0])
    assert shown.near(lifted(0.0, 0.06), normal).misfit == pytest.approx(0.04)
    assert shown.near(lifted(95.0, 0.06), normal).misfit == pytest.approx(0.01)
    assert shown.near(ball, normal).diameter_mm == pytest.approx(ball.diameter_mm)
    two = usual_of([ball, lifted(30.0, 0.05)]).near(ball, normal)  # tell nothing
    assert two.misfit == 0.0
    assert np.isnan(two.diameter_mm)


def test_what_is_found_by_the_usual_tells_what_is_usual_farther_from_the_plane_of_the_source(
    scanned: Scan, ball: Examined, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of 160 markers in eight cone beams three were missed: all that was found was above them, and less ragged."""
    ragged = [
        replace(ball, center_mm=ball.center_mm - [0.0, 0.0, 10.0 * n], misfit=0.01 * n, candidate_mm=np.full(3, n))
        for n in range(9)
    ]
    failing = [one if n < 3 else replace(one, failures=(("roundness", "ragged"),)) for n, one in enumerate(ragged)]

    def judged(_: Scan, place_mm: np.ndarray, stated_mm: float, build: Build, usual: Usual) -> Examined:
        one = int(place_mm[0])
        return ragged[one] if ragged[one].misfit < usual.misfit + 0.025 else failing[one]

    monkeypatch.setattr("ronnaplan.localization.scanwide.usual.examine_place", judged)
    above, below = by_the_usual([(scanned, failing[:5]), (scanned, failing[5:])], SOLID)
    assert all(one.is_marker for one in [*above, *below])
    assert not any(one.is_marker for one in by_the_usual([(scanned, failing[5:])], SOLID)[0])  # nothing tells


def test_what_is_softer_than_the_others_is_none_unless_metal_is_clipped(ball: Examined) -> None:
    """An egg in thick slices passes for a ball behind a softer kernel."""
    softer_mm = float(np.hypot(ball.parameters[BLUR], np.sqrt(1.1 * BLURRED_MM2)))
    others = [at(ball, 20.0 * n, edge=0.0) for n in range(3)]
    egg = at(ball, 80.0, edge=0.0, blur=softer_mm)
    assert [one.is_marker for one in unlike_turned_down([*others, egg])] == [True, True, True, False]
    assert all(one.is_marker for one in unlike_turned_down([*others, replace(egg, is_clipped=True)]))
    assert all(one.is_marker for one in unlike_turned_down([*others[:1], egg]))  # of two nobody knows


def test_slices_that_lie_farther_apart_in_a_part_of_a_scan_may_be_thicker_there_or_leave_gaps(
    ball: Examined,
) -> None:
    """Of slices of 1 mm, first every millimetre and then every other, balls among the former were turned down."""
    near = [replace(at(ball, 20.0 * n, width=1.0), thickness_mm=1.0) for n in range(3)]
    gapped = [replace(at(ball, 20.0 * n, width=1.0), thickness_mm=2.0) for n in range(3, 11)]
    thick = [replace(at(ball, 20.0 * n, width=3.0), thickness_mm=3.0) for n in range(3, 11)]
    assert all(one.is_marker for one in unlike_turned_down([*near, *gapped]))
    assert all(one.is_marker for one in unlike_turned_down([*near, *thick]))
    egg = replace(at(ball, 300.0, width=2.0), thickness_mm=1.0)
    assert "over 2.0 mm, the others' over 1.0 mm" in unlike_turned_down([*near, *gapped, egg])[-1].failures[0][1]


def test_a_steep_kernel_that_is_fitted_now_one_way_now_the_other_makes_no_ball_softer(ball: Examined) -> None:
    """Nine balls were fitted as overshooting and seven, as close, with long tails, which were turned down."""
    overshooting = [at(ball, 20.0 * n, blur=0.869, edge=0.62) for n in range(9)]
    long_tails = [at(ball, 20.0 * n, blur=0.38, edge=-0.41) for n in range(9, 16)]
    assert all(one.is_marker for one in unlike_turned_down([*overshooting, *long_tails]))


def test_what_is_more_oval_within_the_slices_than_the_others_is_none(ball: Examined) -> None:
    """Of eggs of 0.9 as large as balls of 5 and 8 mm nearly all were taken for markers, and doubt cast on the balls."""

    def oval(number: int, share: float) -> Examined:
        shape = ball.shape @ np.diag([1.0 + share, 1.0 - share, 1.0])
        return replace(at(ball, 20.0 * number), shape=shape)

    round_ones, egg = [oval(n, 0.001) for n in range(3)], oval(4, 0.05)
    assert [one.is_marker for one in unlike_turned_down([*round_ones, egg])] == [True, True, True, False]
    assert "oval by 5" in unlike_turned_down([*round_ones, egg])[-1].failures[0][1]
    ragged = [oval(n, 0.015) for n in range(3)]  # in cone beams
    assert all(one.is_marker for one in unlike_turned_down([*ragged, egg]))
    sheared = replace(ball, shape=ball.shape + 0.1 * (np.eye(3)[:, [2, 1, 0]] - np.diag([0.0, 1.0, 0.0])))
    assert all(one.is_marker for one in unlike_turned_down([*round_ones, at(sheared, 100.0)]))  # the head jumped
    assert all(one.is_marker for one in unlike_turned_down([*round_ones, replace(egg, is_covered=True)]))
    assert all(one.is_marker for one in unlike_turned_down([*round_ones[:1], egg]))  # of two nobody knows
