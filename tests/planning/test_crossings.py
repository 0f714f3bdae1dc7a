"""Scalp, outer and inner table are found where the ellipsoids are: within 0.05 mm and 0.1 degree, on any stack."""

from __future__ import annotations

import numpy as np
import pytest

from phantoms.scene import Part, Scene
from phantoms.solids import ellipsoid, sphere
from phantoms.stack import axial_stack
from ronnaplan.errors import InputError
from ronnaplan.planning import Head
from ronnaplan.planning.crossings import find_crossings
from ronnaplan.planning.layers import Way
from ronnaplan.planning.surface import Surface
from tests.long import few_and_others
from tests.planning.heads import BRAIN, FOOT, SCALP, SKULL, normal, paths, reach, scanned
from tests.scans import scan


@few_and_others("stack", ["tilted", "uneven"], ["plain", "oblique"])
def test_each_surface_equals_its_closed_form(stack: str) -> None:
    head = scanned(stack)
    for start, outward in paths(12, seed=5):
        crossings = find_crossings(head, start, outward)
        assert crossings.way is Way.OPEN
        for surface, axes in ((crossings.scalp, SCALP), (crossings.outer, SKULL), (crossings.inner, BRAIN)):
            assert surface is not None
            assert surface.clear
            truth = reach(start, outward, axes)
            assert abs(surface.reach_mm - truth) < 0.05
            np.testing.assert_allclose(surface.position_mm, start + truth * outward, atol=0.05)
            assert angle_deg(surface, normal(start + truth * outward, axes)) < 0.1


def test_the_stated_error_is_of_the_size_of_the_true_one() -> None:
    head = scanned("plain")
    ratios = []
    for start, outward in paths(25, seed=6):
        surface = find_crossings(head, start, outward).outer
        assert surface is not None
        ratios.append((surface.reach_mm - reach(start, outward, SKULL)) / surface.sd_mm)
    assert 0.3 < np.sqrt(np.mean(np.square(ratios))) < 6.0


def test_a_surface_between_slices_that_leave_a_gap_says_so() -> None:
    positions = np.array([*np.arange(-30.0, 78.1, 1.5), *np.arange(82.0, 90.0, 1.5)])
    settings = {"start_mm": 0, "stop_mm": 0, "spacing_mm": 1.5, "positions_mm": positions}
    scene = Scene((Part(ellipsoid((0, 0, 0), SCALP), "skin"),))
    head = Head.of(scan(scene, axial_stack(matrix=128, field_of_view_mm=190.0, **settings)))  # type: ignore[arg-type]
    surface = find_crossings(head, np.zeros(3), np.array([0.0, 0.0, 1.0])).scalp
    assert surface is not None
    assert surface.sd_mm > 0.3


def test_a_sinus_is_not_the_outside() -> None:
    sinus = Part(sphere((0.0, -56.0, 28.0), 14.0), "air", "sinus", embedded=True)
    scene = Scene((Part(ellipsoid((0, 0, 0), SCALP), "skin"), sinus))
    head = Head.of(scan(scene, axial_stack(start_mm=-32, stop_mm=90, matrix=128, field_of_view_mm=190.0)))
    outward = np.array([0.0, -2.0, 1.0]) / np.sqrt(5.0)
    surface = find_crossings(head, np.zeros(3), outward).scalp
    assert surface is not None
    assert abs(surface.reach_mm - reach(np.zeros(3), outward, SCALP)) < 0.05


def test_a_path_through_a_post_is_covered_and_one_out_of_the_scan_is_cut() -> None:
    head = scanned("plain", post=True)
    assert find_crossings(head, np.zeros(3), FOOT / 84.0).way is Way.COVERED
    assert find_crossings(head, np.zeros(3), np.array([0.0, 0.0, -1.0])).way is Way.CUT


def test_no_skull_is_told_rather_than_made_up() -> None:
    scene = Scene((Part(ellipsoid((0, 0, 0), SCALP), "skin"),))
    head = Head.of(scan(scene, axial_stack(start_mm=-32, stop_mm=90, matrix=128, field_of_view_mm=190.0)))
    crossings = find_crossings(head, np.zeros(3), np.array([0.0, 1.0, 0.0]))
    assert crossings.scalp is not None
    assert crossings.outer is None
    assert crossings.inner is None


def test_a_scan_without_a_head_is_refused() -> None:
    scene = Scene((Part(sphere((0, 0, 0), 20.0), "acrylic"),))
    with pytest.raises(InputError, match="expected a head"):
        Head.of(scan(scene, axial_stack(start_mm=-20, stop_mm=20, matrix=64, field_of_view_mm=64.0)))


def angle_deg(surface: Surface, truth: np.ndarray) -> float:
    return float(np.degrees(np.arcsin(np.linalg.norm(np.cross(surface.normal, truth)))))
