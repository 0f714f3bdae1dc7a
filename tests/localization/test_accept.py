"""Each acceptance test turns down what it is named for, and says why."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ronnaplan.localization.accept import TESTS, Evidence, failures, profile_share
from ronnaplan.localization.examine import Scan, fit_place
from ronnaplan.localization.refine import BallFit
from tests.scans import balls, scan, small_stack


@pytest.fixture(scope="module")
def fit() -> BallFit:
    return fit_place(Scan(scan(balls([(1.0, 2.0, 3.0)]), small_stack())), np.array([1.0, 2.0, 3.0]), 11.5)


def changed(fit: BallFit, parameter: int, value: float) -> BallFit:
    theta = fit.theta.copy()
    theta[parameter] = value
    return replace(fit, theta=theta)


def spoiled(name: str, fit: BallFit) -> BallFit:
    verdict = fit.verdict
    return {
        "stayed": lambda: changed(fit, 0, 4.0),
        "contrast": lambda: changed(fit, 6, 200.0),
        "blur": lambda: changed(fit, 4, 2.5),
        "thickness": lambda: changed(fit, 5, 4.0),
        "diameter": lambda: changed(fit, 3, 6.3),
        "coverage": lambda: replace(fit, verdict=replace(verdict, round_share=0.5)),
        "free": lambda: replace(fit, verdict=replace(verdict, attached_share=0.4)),
        "informed": lambda: replace(fit, verdict=replace(verdict, state=np.zeros_like(verdict.state))),
        "roundness": lambda: replace(fit, residuals_hu=fit.residuals_hu + 150.0),
        "converged": lambda: replace(fit, converged=False),
        "certainty": lambda: replace(fit, influence_mm_per_hu=fit.influence_mm_per_hu * 3000.0),
    }[name]()


@pytest.mark.parametrize("name", list(TESTS))
def test_every_test_can_fail_and_gives_its_reason(name: str, fit: BallFit) -> None:
    reason = TESTS[name](Evidence(spoiled(name, fit), 11.5, 1.0, 0.5, 10.0))
    assert reason is not None
    assert len(reason) > 15


def test_what_is_too_long_or_too_short_along_the_slices_must_be_rounder(fit: BallFit) -> None:
    three_quarters = replace(fit, verdict=replace(fit.verdict, round_share=0.75))
    assert TESTS["coverage"](Evidence(three_quarters, 11.5, 1.0, 0.5, 10.0)) is None
    for thickness_mm in (0.5, 1.5):
        other = Evidence(changed(three_quarters, 5, thickness_mm), 11.5, 1.0, 0.5, 10.0)
        assert TESTS["coverage"](other) is not None


def test_a_ball_passes_them_all(fit: BallFit) -> None:
    assert list(failures(Evidence(fit, 11.5, 1.0, 0.5, 10.0))) == []


def test_the_quick_look_sees_a_ball_and_not_its_flank() -> None:
    volume = scan(balls([(1.0, 2.0, 3.0)]), small_stack())
    assert profile_share(volume, np.array([1.0, 2.0, 3.0]), 11.5, 1.0) > 0.9
    assert profile_share(volume, np.array([7.0, 2.0, 3.0]), 11.5, 1.0) < 0.6
    assert profile_share(volume, np.array([500.0, 2.0, 3.0]), 11.5, 1.0) == 0.0
