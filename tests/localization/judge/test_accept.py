"""Each acceptance test turns down what it is named for, and says why."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from ronnaplan.ct import CTVolume
from ronnaplan.localization.build import SOLID
from ronnaplan.localization.examine import fit_place
from ronnaplan.localization.fit.ball_fit import BallFit, fit_at
from ronnaplan.localization.fit.directions import Verdict
from ronnaplan.localization.fit.parameters import BLUR, CONTRAST, RADIUS, WIDTH, U
from ronnaplan.localization.judge.accept import TESTS, failures
from ronnaplan.localization.judge.evidence import Evidence, Usual
from ronnaplan.localization.scanner.scan import Scan
from ronnaplan.localization.search.look import surface_shares
from tests.scans import balls, scan, small_stack


@cache
def volume() -> CTVolume:
    return scan(balls([(1.0, 2.0, 3.0)]), small_stack())


@pytest.fixture(scope="module")
def fit() -> BallFit:
    return fit_place(Scan(volume()), np.array([1.0, 2.0, 3.0]), 11.5)


def changed(fit: BallFit, parameter: int, value: float) -> BallFit:
    theta = fit.theta.copy()
    theta[parameter] = value
    return replace(fit, theta=theta)


def round_in(verdict: Verdict, share: float) -> Verdict:
    """Return a verdict in which the edges are a ball's in this share of the directions."""
    count = len(verdict.state)
    off_mm = np.where(np.arange(count) < int(share * count), 0.0, 5.0)
    return replace(verdict, state=np.ones_like(verdict.state), off_mm=off_mm)


def spoiled(name: str, fit: BallFit) -> BallFit:
    verdict = fit.verdict
    return {
        "stayed": lambda: changed(fit, U, 4.0),
        "contrast": lambda: changed(fit, CONTRAST, 200.0),
        "blur": lambda: changed(fit, BLUR, 2.5),
        "thickness": lambda: changed(fit, WIDTH, 5.0),
        "diameter": lambda: changed(fit, RADIUS, 6.3),
        "coverage": lambda: replace(fit, verdict=round_in(verdict, 0.5)),
        "free": lambda: replace(fit, verdict=replace(verdict, attached_share=0.4)),
        "informed": lambda: replace(fit, verdict=replace(verdict, state=np.zeros_like(verdict.state))),
        "roundness": lambda: replace(fit, residuals_hu=fit.residuals_hu + 150.0),
        "whole": lambda: replace(fit, verdict=replace(verdict, off_mm=round_in(verdict, 0.9).off_mm * -1.0)),
        "converged": lambda: replace(fit, converged=False),
        "certainty": lambda: replace(fit, influence_mm_per_hu=fit.influence_mm_per_hu * 3000.0),
    }[name]()


def evidence(fit: BallFit, gap_mm: float = 1.0) -> Evidence:
    return Evidence(fit, 11.5, 1.0, gap_mm, 10.0, 0.0, volume())


@pytest.mark.parametrize("name", list(TESTS))
def test_every_test_can_fail_and_gives_its_reason(name: str, fit: BallFit) -> None:
    apart = name == "hidden"
    reason = TESTS[name](evidence(fit, gap_mm=6.0) if apart else evidence(spoiled(name, fit)))
    assert reason is not None
    assert len(reason) > 15
    assert TESTS[name](evidence(fit)) is None


def test_a_fit_without_any_surface_is_turned_down_in_finite_words(fit: BallFit) -> None:
    unused = replace(fit, used=np.zeros_like(fit.used), verdict=round_in(fit.verdict, 0.91))
    assert TESTS["coverage"](evidence(unused)) == (
        "only 91% of what is seen of its surface is a sphere's, 100% expected"
    )
    assert TESTS["roundness"](evidence(unused)) == "nothing of its surface can be used"


def test_a_ball_that_the_scan_cuts_off_is_said_to_be(fit: BallFit) -> None:
    cut_off = replace(evidence(fit), unseen=0.9)
    reason = TESTS["informed"](cut_off)
    assert reason is not None
    assert "of its surface can be used, 90% is outside the scan, " in reason


def test_directions_left_out_where_a_holder_ends_are_no_spheres(fit: BallFit) -> None:
    near_faces = replace(fit.neighbourhood, ending_share=0.3)
    mostly_round = replace(fit, verdict=round_in(fit.verdict, 0.81))
    assert TESTS["coverage"](evidence(mostly_round)) is None
    reason = TESTS["coverage"](evidence(replace(mostly_round, neighbourhood=near_faces)))
    assert reason == "only 56% of its surface is a sphere's, 58% expected"


def test_what_is_attached_to_more_than_a_post_leaves_a_round_rest(fit: BallFit) -> None:
    on_skin = replace(round_in(fit.verdict, 0.85), attached_share=0.12)
    assert TESTS["free"](evidence(replace(fit, verdict=on_skin))) is None
    peg = round_in(on_skin, 0.65)
    assert TESTS["free"](evidence(replace(fit, verdict=peg))) == (
        "it goes on into something as bright, and 23% of its surface beside that is no sphere's, 14% allowed"
    )


def test_a_contrast_beyond_zirconias_is_no_markers(fit: BallFit) -> None:
    reason = TESTS["contrast"](evidence(changed(fit, CONTRAST, 50000.0)))
    assert reason == "contrast 50000 HU or more: it is larger than stated, or absorbs more than zirconia"


def test_what_ends_from_one_voxel_to_the_next_was_pasted_in(fit: BallFit) -> None:
    within = changed(changed(fit, BLUR, 0.3 * fit.neighbourhood.pixel_mm), WIDTH, 0.02)
    around = fit.neighbourhood
    steep = replace(within, neighbourhood=replace(around, ceiling_hu=float(around.values_hu[fit.used].max())))
    reason = TESTS["blur"](evidence(steep))
    assert reason is not None
    assert reason.startswith(
        "it ends from one voxel to the next, as what artifact reduction puts back in; localize in"
    )
    assert TESTS["blur"](evidence(within)) is None
    assert TESTS["blur"](evidence(changed(steep, WIDTH, 0.5))) is None  # the slices' profile is a scanner's


def test_a_fit_that_no_voxel_informed_is_turned_down(fit: BallFit) -> None:
    nothing = np.zeros(len(fit.used), dtype=np.bool_)
    empty = fit_at(fit.neighbourhood, fit.theta, fit.prior, fit.verdict, nothing, converged=False)
    assert len(empty.neighbourhood.values_hu) == 0
    assert "converged" in dict(failures(Evidence(empty, 11.5, 1.0, 1.0, 10.0, 0.0, volume())))


def test_a_ball_passes_them_all(fit: BallFit) -> None:
    assert list(failures(evidence(fit))) == []


def test_the_quick_look_sees_a_ball_and_not_its_flank() -> None:
    places = np.array([[1.0, 2.0, 3.0], [7.0, 2.0, 3.0], [500.0, 2.0, 3.0]])
    ball, flank, outside = surface_shares(volume(), places, 11.5, SOLID, np.ones(len(places)), 0.6)
    assert ball > 0.9
    assert flank < 0.6
    assert outside == 0.0


def test_thick_slices_must_show_more_of_a_sphere(fit: BallFit) -> None:
    ragged = replace(fit, verdict=round_in(fit.verdict, 0.625))
    assert TESTS["coverage"](evidence(ragged)) is None
    reason = TESTS["coverage"](replace(evidence(changed(ragged, WIDTH, 5.0)), thickness_mm=5.0))
    assert reason is not None
    assert "is a sphere's" in reason


@pytest.mark.parametrize("name", ["coverage", "informed", "roundness"])
def test_less_has_to_be_round_where_the_scan_makes_all_ragged_and_the_size_is_theirs(
    name: str, fit: BallFit
) -> None:
    informed = np.where(np.arange(len(fit.verdict.state)) < 0.27 * len(fit.verdict.state), 1, 0).astype(np.int8)
    ragged = {
        "coverage": lambda: replace(fit, verdict=round_in(fit.verdict, 0.53)),
        "informed": lambda: replace(fit, verdict=replace(fit.verdict, state=informed)),
        "roundness": lambda: replace(fit, residuals_hu=fit.residuals_hu + 0.075 * fit.contrast_hu),
    }[name]()
    assert TESTS[name](evidence(ragged)) is not None
    assert TESTS[name](replace(evidence(ragged), usual=Usual(0.04, diameter_mm=fit.diameter_mm + 0.05))) is None
    for usual in (Usual(0.02, diameter_mm=fit.diameter_mm), Usual(0.04, diameter_mm=fit.diameter_mm - 0.1)):
        assert TESTS[name](replace(evidence(ragged), usual=usual)) is not None


@pytest.mark.parametrize("noise_hu", [5.0, 40.0, 60.0])
def test_noise_does_not_make_a_ball_ragged(noise_hu: float) -> None:
    """In coarse voxels 40 HU move an edge by a tenth of a millimeter, so that a fifth of them lie elsewhere."""
    stack = small_stack(matrix=52, spacing_mm=3.0)
    volume = scan(balls([(1.0, 2.0, 3.0)], 10.0), stack, blur_mm=0.8, noise_hu=noise_hu)
    fit = fit_place(Scan(volume), np.array([1.0, 2.0, 3.0]), 10.0)
    assert fit.verdict.in_noise(noise_hu).round_share > 0.94
    if noise_hu >= 40.0:
        assert fit.verdict.round_share < 0.85
