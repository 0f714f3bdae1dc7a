"""The order of least cost: no part of it can be turned or moved to shorten it, and many places take no longer."""

from __future__ import annotations

import numpy as np

from ronnaplan.geometry import FloatArray
from ronnaplan.robot.placement.order import MOST_MOVED, shortest


def apart(count: int, seed: int) -> FloatArray:
    """Return how far postures drawn at random are from each other (N, N), the start first."""
    postures = np.random.default_rng(seed).normal(size=(count + 1, 6)) * 40
    found: FloatArray = np.abs(postures[:, None] - postures).max(axis=-1)
    return found


def length(cost: FloatArray, order: list[int]) -> float:
    return float(cost[[0, *order[:-1]], order].sum())


def test_no_part_of_the_order_is_better_turned_or_moved() -> None:
    for seed in range(5):
        cost = apart(9, seed)
        order = shortest(cost, 0, list(range(1, 10)))
        assert sorted(order) == list(range(1, 10))
        least = length(cost, order)
        for a in range(9):
            for b in range(a + 1, 10):
                part, rest = order[a:b], order[:a] + order[b:]
                assert length(cost, order[:a] + part[::-1] + order[b:]) > least - 1e-6
                for c in range(len(rest) + 1 if b - a <= MOST_MOVED else 0):
                    assert length(cost, rest[:c] + part + rest[c:]) > least - 1e-6


def test_places_of_which_there_are_one_or_none_are_in_order() -> None:
    assert shortest(apart(2, 0), 0, [2]) == [2]
    assert shortest(apart(2, 0), 0, []) == []


def test_a_hundred_places_are_ordered() -> None:
    cost = apart(100, 1)
    order = shortest(cost, 0, list(range(1, 101)))
    assert sorted(order) == list(range(1, 101))
    assert length(cost, order) < 0.5 * length(cost, list(range(1, 101)))
