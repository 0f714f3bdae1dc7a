"""Directions in which no ball is seen are left out, and no others."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.ndimage import gaussian_filter

from phantoms.scene import Part, Scene
from phantoms.solids import cylinder
from ronnaplan.ct import CTVolume
from ronnaplan.geometry import FloatArray
from ronnaplan.localization.examine import fit_place
from ronnaplan.localization.fit.directions import judge_directions
from ronnaplan.localization.fit.model import has_skin
from ronnaplan.localization.fit.parameters import CENTER
from ronnaplan.localization.scanner.scan import Scan
from tests.scans import balls, offsets_mm, on_grid, scan, small_stack

RADIUS_MM, NEAR_MM = 5.75, 0.5
POST = Scene((Part(cylinder((0.0, 0.0, 0.0), (0.0, 0.0, -1.0), 14.0, 6.0), "acrylic"),))


def test_voxels_on_the_surface_agree_where_no_post_stands_and_none_does_far_away() -> None:
    volume = scan(Scene((*balls([(0.0, 0.0, 0.0)]).parts, *POST.parts)), small_stack())
    fit = fit_place(Scan(volume), np.array([0.2, -0.1, 0.2]), 2 * RADIUS_MM)
    around = fit.neighbourhood
    _, agreeing = judge_directions(around, fit.theta, fit.prior.layer_mm)
    offsets_mm = around.offsets_mm - fit.theta[CENTER]
    far_mm = np.linalg.norm(offsets_mm, axis=1)
    is_on_surface = np.abs(far_mm - RADIUS_MM) < NEAR_MM
    aside_deg = np.degrees(np.arccos(offsets_mm @ around.axes @ [0.0, 0.0, -1.0] / far_mm))
    assert not agreeing[is_on_surface & (aside_deg < 20.0)].any()
    assert np.mean(agreeing[is_on_surface & (aside_deg > 75.0)]) > 0.97
    assert not agreeing[far_mm > RADIUS_MM + 3.0].any()
    assert (far_mm > RADIUS_MM + 3.0).any()


def clipped_on_a_peg(center_mm: FloatArray, outward: FloatArray, diameter_mm: float, peg_mm: float) -> CTVolume:
    """A ball of steel on a plastic peg, blurred, in a scale that ends at 3,071 HU."""
    stack = small_stack(start_mm=-9, stop_mm=9, matrix=40, field_of_view_mm=20, spacing_mm=0.75)
    volume = on_grid(np.zeros((len(stack.positions_mm), 40, 40), dtype=np.int16), stack)
    x, y, z = offsets_mm(volume, center_mm)
    parts = np.array([-1.0, 0.0, 1.0]) / 3.0
    lines = (z[:, 0, 0], 0.75), (y[0, :, 0], 0.5), (x[0, 0], 0.5)
    w, v, u = np.meshgrid(*((mm[:, np.newaxis] + step * parts).ravel() for mm, step in lines), indexing="ij")
    along, squares = u * outward[0] + v * outward[1] + w * outward[2], u * u + v * v + w * w
    fine_hu = np.where((along < 0.0) & (squares - along**2 < peg_mm**2 / 4.0), 150.0, -1000.0)
    fine_hu[squares < diameter_mm**2 / 4.0] = 15_000.0
    blurred_hu = gaussian_filter(fine_hu, (0.0, 2.4, 2.4)).reshape(len(z), 3, 40, 3, 40, 3).mean(axis=(1, 3, 5))
    noise_hu = np.random.default_rng(4).normal(0.0, 10.0, blurred_hu.shape)
    return replace(volume, voxels_hu=np.clip(blurred_hu + noise_hu, -1024, 3071).astype(np.int16))


def test_a_plastic_peg_draws_no_ball_of_metal_that_the_scale_clips() -> None:
    """A peg is faint beside the metal, but not beside the foot of its edge, which is all that is seen of it."""
    center_mm, outward = np.array([0.3, 0.2, 0.4]), np.array([0.6, -0.5, 0.62]) / np.linalg.norm([0.6, -0.5, 0.62])
    fit = fit_place(Scan(clipped_on_a_peg(center_mm, outward, 6.0, 4.8)), center_mm + 0.2, 6.0)
    assert fit.is_clipped
    assert np.linalg.norm(fit.center_mm - center_mm) < 0.015


def test_a_wide_plastic_peg_is_not_taken_for_skin() -> None:
    """Flat skin explained it but for what is dark beside it, and drew the ball by 37 um."""
    center_mm, outward = np.array([0.3, 0.2, 0.4]), np.array([0.0, 1.0, 0.2]) / np.linalg.norm([0.0, 1.0, 0.2])
    fit = fit_place(Scan(clipped_on_a_peg(center_mm, outward, 6.0, 4.8)), center_mm + 0.2, 6.0)
    assert not has_skin(fit.theta)
    assert np.linalg.norm(fit.center_mm - center_mm) < 0.02
