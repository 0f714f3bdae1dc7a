"""Sockets nearly as wide as the ball that sits in them, whose rim draws it into them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from phantoms.scene import Part, Scene
from phantoms.solids import cylinder
from ronnaplan.ct import CTVolume
from ronnaplan.geometry import FloatArray
from ronnaplan.localization.examine import fit_place
from ronnaplan.localization.fit.ball_fit import BallFit
from ronnaplan.localization.judge.evidence import Evidence
from ronnaplan.localization.judge.noise import noise_level
from ronnaplan.localization.judge.rim import _was_drawn
from ronnaplan.localization.scanner.scan import Scan
from tests.long import few_and_others
from tests.scans import balls, scan, small_stack

CENTER_MM, DIAMETER_MM = np.array([0.2, -0.3, 3.1]), 5.0


def in_a_socket(width: float, into: FloatArray) -> CTVolume:
    """A ball in a stem that goes ``into`` a direction (3,), as wide as this share of the ball."""
    begin = CENTER_MM + 0.25 * DIAMETER_MM * into
    stem = Part(cylinder(tuple(begin), tuple(into), 12.0, width * DIAMETER_MM), "acrylic")
    place = (float(CENTER_MM[0]), float(CENTER_MM[1]), float(CENTER_MM[2]))
    return scan(Scene((stem,)) + balls([place], DIAMETER_MM), small_stack(spacing_mm=1.0, thickness_mm=1.0))


def fit_of(volume: CTVolume) -> BallFit:
    return fit_place(Scan(volume), CENTER_MM + 0.1, DIAMETER_MM)


def test_a_socket_does_not_draw_its_ball_in() -> None:
    volume = in_a_socket(0.8, np.array([-1.0, 0.0, 0.0]))
    fit = fit_of(volume)
    error_mm = fit.center_mm - CENTER_MM
    evidence = Evidence(fit, DIAMETER_MM, 1.0, 1.0, noise_level(fit), 0.0, volume)
    assert np.abs(error_mm).max() < 0.012  # 0.044 with what the rim shines into
    assert error_mm @ np.linalg.solve(evidence.covariance_mm2, error_mm) < 7.8
    assert fit.drawn is not None
    assert evidence.edge.fit is fit.drawn  # one of a ball that moved tells of it, by all of its edge


def test_a_thin_post_leaves_its_ball_as_it_was_fitted() -> None:
    fit = fit_of(in_a_socket(0.3, np.array([-1.0, 0.0, 0.0])))
    assert fit.by_part_mm2 is None


@few_and_others("jump_mm", [(0.25, 0.0, 0.0)], [(-0.25, 0.0, 0.0), (0.0, -0.25, 0.0)])
def test_a_ball_that_jumped_while_it_was_scanned_is_not_taken_for_one_in_a_socket(
    jump_mm: tuple[float, float, float],
) -> None:
    """The clear directions saw one side of the jump, were believed, and no motion was told any more."""
    into, diameter_mm = np.array([-0.6, 0.0, -0.8]), 11.5

    def seen(shift_mm: FloatArray) -> CTVolume:
        x, y, z = (float(one) for one in CENTER_MM + shift_mm)
        begin = np.array([x, y, z]) + 0.25 * diameter_mm * into
        stem = Part(cylinder(tuple(begin), tuple(into), 9.0, 0.5 * diameter_mm), "acrylic")
        return scan(Scene((stem,)) + balls([(x, y, z)], diameter_mm), small_stack(), noise_hu=8.0)

    before, after = seen(np.zeros(3)), seen(np.array(jump_mm))
    is_after = before.grid.slice_positions_mm > CENTER_MM[2]
    voxels_hu = np.where(is_after[:, np.newaxis, np.newaxis], after.voxels_hu, before.voxels_hu)
    fit = fit_place(Scan(replace(before, voxels_hu=voxels_hu)), CENTER_MM + 0.1, diameter_mm)
    assert fit.by_part_mm2 is None


def test_the_profile_of_thick_slices_is_no_rim() -> None:
    """The center was moved by 12 um towards the socket, which draws none of it in along the slices' normal."""
    stem = Part(cylinder((0.2, -0.3, 1.1), (0.0, 0.0, -1.0), 12.0, 5.2), "acrylic")
    place = (float(CENTER_MM[0]), float(CENTER_MM[1]), float(CENTER_MM[2]))
    volume = scan(
        Scene((stem,)) + balls([place], 8.0), small_stack(spacing_mm=2.0, thickness_mm=2.0), noise_hu=5.0
    )
    fit = fit_place(Scan(volume), CENTER_MM + 0.1, 8.0)
    assert np.abs(fit.center_mm - CENTER_MM).max() < 0.006


def test_what_moves_a_ball_farther_than_rims_do_is_none() -> None:
    towards = np.array([0.0, 0.0, -20.0])
    assert _was_drawn(np.array([0.0, 0.0, 0.05]), towards)
    assert not _was_drawn(np.array([0.0, 0.0, 0.12]), towards)  # as the poles of 5 mm slices do
