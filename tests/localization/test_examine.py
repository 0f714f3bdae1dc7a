"""Thousands of balls, as the pellets of a sandbag beneath a head are, take no longer than each takes to fit."""

from __future__ import annotations

import time
from types import SimpleNamespace
from typing import Any, cast

import numpy as np

from ronnaplan.geometry import first_apart
from ronnaplan.localization.examine import Examined, distinct

PELLETS_MM = 5.0 * np.stack(np.meshgrid(*[np.arange(14.0)] * 3), axis=-1).reshape(-1, 3)


def seen_at(center_mm: Any, misfit: float) -> Examined:
    return cast("Examined", SimpleNamespace(center_mm=center_mm, stated_mm=4.0, misfit=misfit))


def test_thousands_of_balls_are_told_apart_at_once() -> None:
    pellets = [seen_at(place, 0.02) for place in PELLETS_MM]
    again = [seen_at(place + 1.0, 0.01) for place in PELLETS_MM[:3]]
    began = time.process_time()
    kept = distinct([*pellets, *again])
    assert time.process_time() - began < 2.0
    assert len(kept) == len(pellets)
    assert kept[:3] == again  # of two in one place the better fit


def test_thousands_of_places_are_looked_through_at_once() -> None:
    began = time.process_time()
    places = np.concatenate([PELLETS_MM, PELLETS_MM + 1.0])
    kept = places[first_apart(places, 2.0)]
    assert time.process_time() - began < 2.0
    np.testing.assert_array_equal(kept, PELLETS_MM)
