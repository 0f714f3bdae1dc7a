"""Directions in which no ball is seen are left out, and no others."""

from __future__ import annotations

import numpy as np

from phantoms.scene import Part, Scene
from phantoms.solids import cylinder
from ronnaplan.localization.examine import fit_place
from ronnaplan.localization.fit.directions import judge
from ronnaplan.localization.fit.parameters import CENTER
from ronnaplan.localization.scanner.scan import Scan
from tests.scans import balls, scan, small_stack

RADIUS_MM, NEAR_MM = 5.75, 0.5
POST = Scene((Part(cylinder((0.0, 0.0, 0.0), (0.0, 0.0, -1.0), 14.0, 6.0), "acrylic"),))


def test_voxels_on_the_surface_agree_where_no_post_stands_and_none_does_far_away() -> None:
    volume = scan(Scene((*balls([(0.0, 0.0, 0.0)]).parts, *POST.parts)), small_stack())
    fit = fit_place(Scan(volume), np.array([0.2, -0.1, 0.2]), 2 * RADIUS_MM)
    around = fit.neighbourhood
    _, agreeing = judge(around, fit.theta, fit.prior.layer_mm, fit.ceiling_hu)
    offsets_mm = around.offsets_mm - fit.theta[CENTER]
    far_mm = np.linalg.norm(offsets_mm, axis=1)
    is_on_surface = np.abs(far_mm - RADIUS_MM) < NEAR_MM
    aside_deg = np.degrees(np.arccos(offsets_mm @ around.axes @ [0.0, 0.0, -1.0] / far_mm))
    assert not agreeing[is_on_surface & (aside_deg < 20.0)].any()
    assert np.mean(agreeing[is_on_surface & (aside_deg > 75.0)]) > 0.97
    assert not agreeing[far_mm > RADIUS_MM + 3.0].any()
    assert (far_mm > RADIUS_MM + 3.0).any()
