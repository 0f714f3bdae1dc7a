"""Sockets nearly as wide as the ball that sits in them, whose rim draws it into them."""

from __future__ import annotations

import numpy as np

from phantoms.scene import Part, Scene
from phantoms.solids import cylinder
from ronnaplan.ct import CTVolume
from ronnaplan.geometry import FloatArray
from ronnaplan.localization.examine import fit_place
from ronnaplan.localization.fit.ball_fit import BallFit
from ronnaplan.localization.judge.evidence import Evidence
from ronnaplan.localization.judge.uncertainty import noise_level
from ronnaplan.localization.scanner.scan import Scan
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
    evidence = Evidence(fit, DIAMETER_MM, 1.0, noise_level(fit), 0.0, volume)
    assert np.abs(error_mm).max() < 0.012  # 0.044 with what the rim shines into
    assert error_mm @ np.linalg.solve(evidence.covariance_mm2, error_mm) < 7.8
    assert len(evidence.edge.used) == np.count_nonzero(fit.used)  # the others would tell of motion


def test_a_thin_post_leaves_its_ball_as_it_was_fitted() -> None:
    fit = fit_of(in_a_socket(0.3, np.array([-1.0, 0.0, 0.0])))
    assert fit.rim_mm2 is None
