"""Thousands of balls, as the pellets of a sandbag beneath a head are, take no longer than each takes to fit."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np

from ronnaplan.localization.examine import Examined, distinct

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
