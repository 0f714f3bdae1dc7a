"""A fit that is no ball's is given up soon."""

from __future__ import annotations

import numpy as np
import pytest

from ronnaplan.localization import refine
from ronnaplan.localization.build import SOLID
from ronnaplan.localization.descent import HOPELESS_SIZE, descend
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

    def counting(*given, is_look=False):  # type: ignore[no-untyped-def]
        settled.append(not is_look)
        return descend(*given, is_look=is_look)

    monkeypatch.setattr(refine, "descend", counting)
    monkeypatch.setattr(refine, "HOPELESS_ROUND", hopeless)
    volume = scan(balls([(0.3, 0.2, 1.0)]), small_stack())
    fit = fit_place(Scan(volume), np.array([0.5, 0.0, 1.2]), 11.5)
    assert fit.converged == is_pursued
    assert is_pursued or sum(settled) == 1


def test_what_turns_out_to_be_of_another_size_is_given_up_on_the_way_there() -> None:
    volume = scan(balls([(0.3, 0.2, 1.0)], diameter_mm=14.0), small_stack())
    around = gather(volume, np.array([0.3, 0.2, 1.0]), 10.0, volume.grid.axes)
    start = first_guess(around, 11.5, SOLID, 1.0, np.inf)
    theta, is_at_rest = descend(around, start, ball_prior(start, SOLID, is_clipped=False), np.inf)
    assert abs(2.0 * theta[RADIUS] - 11.5) > HOPELESS_SIZE * 11.5
    assert not is_at_rest  # left to itself, it would come to rest as the ball that is there
