"""Each ball is one marker, and thousands, as pellets beneath a head are, take no longer than each takes to fit."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from ronnaplan.localization.examine import Examined, distinct, markers_in

PELLETS_MM = 5.0 * np.stack(np.meshgrid(*[np.arange(14.0)] * 3), axis=-1).reshape(-1, 3)


class Seen(SimpleNamespace):
    """A ball that counts how often somebody looks where it is."""

    looks = 0

    @property
    def center_mm(self) -> Any:
        Seen.looks += 1
        return self.place_mm


def seen_at(place_mm: Any, misfit: float) -> Examined:
    return cast("Examined", Seen(place_mm=place_mm, stated_mm=4.0, misfit=misfit))


def test_thousands_of_balls_are_told_apart_without_looking_at_each_pair_of_them() -> None:
    pellets = [seen_at(place, 0.02) for place in PELLETS_MM]
    again = [seen_at(place + 1.0, 0.01) for place in PELLETS_MM[:3]]
    kept = distinct([*pellets, *again])
    assert len(kept) == len(pellets)
    assert kept[:3] == again  # of two in one place the better fit
    assert Seen.looks <= 4 * len([*pellets, *again])


def marker_of(stated_mm: float, off_mm: float, misfit: float, is_clipped: bool = False) -> Examined:
    seen = {"place_mm": np.zeros(3), "stated_mm": stated_mm, "misfit": misfit, "excess_mm": off_mm}
    return cast("Examined", Seen(**seen, is_clipped=is_clipped, is_marker=True))


@pytest.mark.parametrize("from_the_last", [False, True])
@pytest.mark.parametrize(
    "first_is_it",
    [
        [marker_of(5.5, 0.04, 0.03), marker_of(5.0, 0.54, 0.02), marker_of(6.0, -0.46, 0.01)],
        [marker_of(5.5, 0.2, 0.01), marker_of(5.0, 0.0, 0.02, is_clipped=True)],  # which hides its size
        [marker_of(5.0, 0.2, 0.01), marker_of(5.0, 0.1, 0.02)],  # of one size
    ],
    ids=["nearest", "clipped", "better fit"],
)
def test_a_ball_is_one_marker_in_whatever_order_its_sizes_are_stated(
    first_is_it: list[Examined], from_the_last: bool
) -> None:
    assert markers_in(first_is_it[::-1] if from_the_last else first_is_it) == first_is_it[:1]
