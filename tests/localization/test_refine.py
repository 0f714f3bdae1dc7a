"""A fit that is no ball's is given up soon."""

from __future__ import annotations

import numpy as np
import pytest

from ronnaplan.localization import refine
from ronnaplan.localization.descent import descend
from ronnaplan.localization.examine import Scan, fit_place
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
