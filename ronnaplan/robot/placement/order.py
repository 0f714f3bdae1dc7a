"""The order of least cost: of places that may come in any order, and through layers of which each gives one place."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from ronnaplan.geometry import FloatArray

LESS = 1e-9
"""A way is shorter than another by more than this (degrees)."""
MOST_MOVED = 3
"""Parts of an order that are longer stay where they are."""


def cheapest(costs: Sequence[FloatArray]) -> list[int]:
    """Return the way of least cost through layers, from the only place of the first to the only one of the last."""
    left = [np.zeros(1)]
    for cost in reversed(costs):
        left.append((cost + left[-1]).min(axis=1))
    way = [0]
    for cost, ahead in zip(costs, left[-2::-1], strict=True):
        way.append(int((cost[way[-1]] + ahead).argmin()))
    return way


def shortest(cost: Sequence[Sequence[float]], start: int, group: list[int]) -> list[int]:
    """Return ``group`` in the order of least cost from ``start``: nearest first from every one, parts then reversed."""
    best: list[int] = []
    least = np.inf
    for first in group:
        order, left = [first], set(group) - {first}
        while left:
            nearest = min(left, key=lambda n: (cost[order[-1]][n], n))
            order.append(nearest)
            left.remove(nearest)
        order, total = _bettered(cost, start, order)
        if total < least:
            best, least = order, total
    return best


def _bettered(cost: Sequence[Sequence[float]], start: int, order: list[int]) -> tuple[list[int], float]:
    """Reverse or move parts of ``order`` as long as that shortens it; return it with its length."""
    length, better = _length(cost, start, order), True
    while better:
        better, enough = False, length - LESS
        for other in _others(order):
            total = _length(cost, start, other)
            if total < enough:
                order, length, better = other, total, True
                break
    return order, length


def _others(order: list[int]) -> Iterator[list[int]]:
    """Yield ``order`` with each of its parts reversed, and each short one moved."""
    for a in range(len(order)):
        for b in range(a + 1, len(order) + 1):
            part, rest = order[a:b], order[:a] + order[b:]
            yield order[:a] + part[::-1] + order[b:]
            if b - a <= MOST_MOVED:
                yield from [rest[:c] + part + rest[c:] for c in range(len(rest) + 1)]


def _length(cost: Sequence[Sequence[float]], start: int, order: list[int]) -> float:
    length, here = 0.0, start
    for there in order:
        length += cost[here][there]
        here = there
    return length
