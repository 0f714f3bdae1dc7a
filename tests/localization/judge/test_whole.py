"""A ball that is cut where nothing stands beside it is none; one that is whole, held or in two places is not cut."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from phantoms.scene import Part, Scene
from phantoms.solids import Solid, box, cylinder
from ronnaplan.localization.build import SOLID
from ronnaplan.localization.examine import Examined, examine_place, fit_place
from ronnaplan.localization.fit.cells import cell_directions
from ronnaplan.localization.judge.whole import MOST_MISSING, missing_share
from ronnaplan.localization.scanner.scan import Scan
from tests.scans import balls, scan, small_stack

CENTER_MM, DIAMETER_MM = (1.0, 2.0, 3.0), 8.0


def looked_at(solid: Solid, material: str) -> Examined:
    """Return what is made of a ball of plastic, of which something takes the place."""
    scene = balls([CENTER_MM], DIAMETER_MM, "polyoxymethylene") + Scene((Part(solid, material, embedded=True),))
    return examine_place(Scan(scan(scene, small_stack())), np.array(CENTER_MM), DIAMETER_MM, SOLID)


def air_above(height_mm: float) -> Solid:
    """All that lies farther than so much beyond the center (y)."""
    return box((1.0, 2.0 + height_mm + 6.0, 3.0), (24.0, 12.0, 24.0))


@pytest.mark.parametrize("height", [0.5, 0.7])
def test_a_ball_that_is_cut_off_at_half_of_its_radius_and_more_is_none(height: float) -> None:
    found = looked_at(air_above(height * DIAMETER_MM / 2.0), "air")
    assert not found.is_marker
    assert "whole" in found.failed


def test_a_ball_is_not_cut_where_a_post_holds_it_or_little_is_missing() -> None:
    held = looked_at(cylinder((1.0, 2.0 - 14.0, 3.0), (0.0, 1.0, 0.0), 11.0, 3.0), "polyoxymethylene")
    for found in (held, looked_at(air_above(0.97 * DIAMETER_MM / 2.0), "air")):
        assert found.is_marker, found.failures


def test_what_is_missing_on_one_side_and_too_much_on_the_other_is_not_cut() -> None:
    fit = fit_place(Scan(scan(balls([CENTER_MM], DIAMETER_MM), small_stack())), np.array(CENTER_MM), DIAMETER_MM)
    along = cell_directions()[:, 0]
    cut = replace(fit.verdict, off_mm=np.where(along < -0.7, -1.0, 0.0))
    moved = replace(fit.verdict, off_mm=np.where(np.abs(along) > 0.7, np.sign(along), 0.0))
    assert missing_share(cut, fit.contrast_hu) > MOST_MISSING
    assert missing_share(moved, fit.contrast_hu) < MOST_MISSING
