"""Balls that are sunk into a plate are found; pegs with round ends, and balls that are sunk into a head, are not."""

from __future__ import annotations

import numpy as np
import pytest

from phantoms.scene import Part, Scene
from phantoms.solids import Solid, box, cylinder
from phantoms.stack import SliceStack
from ronnaplan.ct import CTVolume
from ronnaplan.localization.build import SOLID
from ronnaplan.localization.examine import Examined, examine_place
from ronnaplan.localization.fit.ball_fit import BallFit
from ronnaplan.localization.scanner.beside import Beside, all_beside
from ronnaplan.localization.scanner.scan import Scan
from tests.scans import balls, scan, small_stack

CENTER_MM, DIAMETER_MM = (1.0, 2.0, 3.0), 10.0
FACE_MM = 3.4
"""How far below the center the face is: the ball is sunk in by 0.16 of its diameter."""


def held_in(solid: Solid, stack: SliceStack | None = None) -> Examined:
    """Return what is made of a ball of plastic in something of the same plastic, below it (y)."""
    scene = Scene((Part(solid, "polyoxymethylene"),)) + balls([CENTER_MM], DIAMETER_MM, "polyoxymethylene")
    return examine_place(Scan(scan(scene, stack or small_stack())), np.array(CENTER_MM), DIAMETER_MM, SOLID)


def slab(thickness_mm: float, width_mm: float = 24.0) -> Solid:
    return box((1.0, 2.0 - FACE_MM - thickness_mm / 2.0, 3.0), (24.0, thickness_mm, width_mm))


def test_a_ball_that_is_sunk_into_a_plate_or_a_bar_is_found_where_it_is() -> None:
    for found in (held_in(slab(4.0)), held_in(slab(4.0, width_mm=9.0))):
        assert found.is_marker, found.failures
        error_mm = found.center_mm - CENTER_MM
        assert error_mm @ np.linalg.solve(found.covariance_mm2, error_mm) < 7.8  # 95 %
        assert np.linalg.norm(error_mm) < 0.03


def test_what_is_no_wider_than_its_round_end_or_as_thick_as_a_head_is_none() -> None:
    for other in (slab(20.0), cylinder((1.0, 2.0, 3.0), (0.0, -1.0, 0.0), 12.0, 8.8)):
        assert "free" in held_in(other).failed


def test_nothing_is_made_good_of_what_surely_is_no_ball_and_its_reasons_are_the_same(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """What a head does takes as long to make good as to fit a ball."""
    made_good: list[BallFit] = []

    def summed_up(volume: CTVolume, fit: BallFit) -> Beside:
        made_good.append(fit)
        return all_beside(volume, fit)

    monkeypatch.setattr("ronnaplan.localization.scanner.hardened.all_beside", summed_up)
    in_a_head, no_panels = slab(20.0), small_stack(field_of_view_mm=60)
    assert held_in(slab(4.0), no_panels).is_marker
    assert len(made_good) == 1
    reasons = held_in(in_a_head, no_panels).failures
    assert len(made_good) == 1
    monkeypatch.setattr("ronnaplan.localization.examine.is_surely_attached", lambda *_: False)
    assert held_in(in_a_head, no_panels).failures == reasons
    assert len(made_good) == 2
