"""A fit that is no ball's is given up soon."""

from __future__ import annotations

import numpy as np
import pytest

from ronnaplan.localization import refine
from ronnaplan.localization.build import SOLID
from ronnaplan.localization.descent import BEGIN, HOPELESS_SIZE, LOOK, WHOLE, Effort, descend
from ronnaplan.localization.examine import Scan, fit_place
from ronnaplan.localization.guess import ball_prior, first_guess
from ronnaplan.localization.neighbourhood import gather
from ronnaplan.localization.parameters import RADIUS
from tests.scans import balls, scan, small_stack


@pytest.mark.parametrize(("hopeless", "is_pursued"), [(0.0, True), (1.01, False)])
def test_what_is_not_round_once_its_directions_were_chosen_is_not_pursued(
    hopeless: float, is_pursued: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    settled = []

    def counting(*given):  # type: ignore[no-untyped-def]
        settled.append(given[-1] is not LOOK)
        return descend(*given)

    monkeypatch.setattr(refine, "descend", counting)
    monkeypatch.setattr(refine, "HOPELESS_ROUND", hopeless)
    volume = scan(balls([(0.3, 0.2, 1.0)]), small_stack())
    fit = fit_place(Scan(volume), np.array([0.5, 0.0, 1.2]), 11.5)
    assert fit.converged == is_pursued
    assert is_pursued or sum(settled) == 1


@pytest.mark.parametrize(("share", "is_pursued"), [(0.0, True), (1.01, False)])
def test_what_is_neither_at_rest_nor_round_after_the_first_steps_is_not_pursued(
    share: float, is_pursued: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    efforts = []

    def noting(*given):  # type: ignore[no-untyped-def]
        efforts.append(given[4] if len(given) > 4 else WHOLE)
        return descend(*given)

    monkeypatch.setattr(refine, "descend", noting)
    monkeypatch.setattr(refine, "BEGIN", Effort(1, 0.0, 0.0))
    monkeypatch.setattr(refine, "HOPELESS_SOON", share)
    monkeypatch.setattr(refine, "HOPELESS_ROUND", 1.01)  # what was given up stays so
    volume = scan(balls([(0.3, 0.2, 1.0)]), small_stack())
    fit = fit_place(Scan(volume), np.array([0.5, 0.0, 1.2]), 11.5)
    assert not fit.converged
    assert (WHOLE in efforts) == is_pursued


def test_the_first_steps_are_those_of_the_whole_descent() -> None:
    volume = scan(balls([(0.3, 0.2, 1.0)]), small_stack())
    around = gather(volume, np.array([0.3, 0.2, 1.0]), 10.0, volume.grid.axes)
    start = first_guess(around, 11.5, SOLID, 1.0, np.inf)
    given = around, start, ball_prior(start, SOLID, is_clipped=False), np.inf
    whole, soon = descend(*given), descend(*given, BEGIN)
    assert whole[1]
    assert soon[1]
    assert np.array_equal(whole[0], soon[0])
    assert not descend(*given, Effort(1, 0.0, 0.0))[1]
    assert descend(*given, Effort(1, 0.0, np.inf))[1]


def test_what_turns_out_to_be_of_another_size_is_given_up_on_the_way_there() -> None:
    volume = scan(balls([(0.3, 0.2, 1.0)], diameter_mm=14.0), small_stack())
    around = gather(volume, np.array([0.3, 0.2, 1.0]), 10.0, volume.grid.axes)
    start = first_guess(around, 11.5, SOLID, 1.0, np.inf)
    theta, is_at_rest = descend(around, start, ball_prior(start, SOLID, is_clipped=False), np.inf)
    assert abs(2.0 * theta[RADIUS] - 11.5) > HOPELESS_SIZE * 11.5
    assert not is_at_rest  # left to itself, it would come to rest as the ball that is there
