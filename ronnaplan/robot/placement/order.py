"""The order of least cost: of places that may come in any order, and through layers of which each gives one place."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from kernelcache import njit
from ronnaplan.geometry import FloatArray

LESS = 1e-9
"""A way is shorter than another by more than this (degrees)."""
MOST_MOVED = 3
"""Parts of an order that are longer stay where they are."""
MOST_STARTS = 64
"""Of more places only so many are begun with."""


def cheapest(costs: Sequence[FloatArray]) -> list[int]:
    """Return the way of least cost (P, Q) through layers, from the only place of the first to that of the last."""
    left = [np.zeros(1)]
    for cost in reversed(costs):
        left.append((cost + left[-1]).min(axis=1))
    way = [0]
    for cost, ahead in zip(costs, left[-2::-1], strict=True):
        way.append(int((cost[way[-1]] + ahead).argmin()))
    return way


def shortest(cost: FloatArray, start: int, group: Sequence[int]) -> list[int]:
    """Return ``group`` in the order of least ``cost`` (N, N), the same both ways, from ``start``.

    The nearest comes first, from every one or from `MOST_STARTS` of them; then parts are reversed and moved.
    """
    if not group:
        return []
    members = np.array(group, dtype=np.int64)
    apart = (len(members) - 1) // MOST_STARTS + 1
    orders = [_bettered(cost, start, _nearest_first(cost, first, members)) for first in members[::apart]]
    lengths = [_length(cost, start, order) for order in orders]
    return [int(n) for n in orders[int(np.argmin(lengths))]]


@njit(cache=True, nogil=True, error_model="numpy")
def _nearest_first(cost: FloatArray, first: int, members: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return ``members`` (N,), ``first`` the first, each next one the nearest of those that are left."""
    order, left = members.copy(), np.ones(len(members), dtype=np.bool_)
    left[members == first] = False
    order[0] = first
    for k in range(1, len(members)):
        nearest, least = -1, np.inf
        for n in range(len(members)):
            if left[n] and (nearest < 0 or cost[order[k - 1], members[n]] < least):
                nearest, least = n, cost[order[k - 1], members[n]]
        order[k], left[nearest] = members[nearest], False
    return order


@njit(cache=True, nogil=True, error_model="numpy")
def _bettered(cost: FloatArray, start: int, order: NDArray[np.int64]) -> NDArray[np.int64]:
    """Reverse parts of ``order`` (N,), or move short ones, as long as that shortens it; return it."""
    better = True
    while better:
        better = False
        for a in range(len(order)):
            for b in range(a + 1, len(order) + 1):
                if _joined(cost, start, order, a, b) < -LESS:
                    order, better = np.concatenate((order[:a], order[a:b][::-1], order[b:])), True
                elif b - a <= MOST_MOVED:
                    rest = np.concatenate((order[:a], order[b:]))
                    to = _place_for(cost, start, order, a, b, rest)
                    if to >= 0:
                        order, better = np.concatenate((rest[:to], order[a:b], rest[to:])), True
                if better:
                    break
            if better:
                break
    return order


@njit(cache=True, nogil=True, error_model="numpy")
def _joined(cost: FloatArray, start: int, order: NDArray[np.int64], a: int, b: int) -> float:
    """Return by how much the way gets longer with the part from ``a`` to before ``b`` reversed."""
    before, first, last = order[a - 1] if a else start, order[a], order[b - 1]
    longer: float = cost[before, last] - cost[before, first]
    if b < len(order):
        longer += cost[first, order[b]] - cost[last, order[b]]
    return longer


@njit(cache=True, nogil=True, error_model="numpy")
def _place_for(
    cost: FloatArray, start: int, order: NDArray[np.int64], a: int, b: int, rest: NDArray[np.int64]
) -> int:
    """Return where in the ``rest`` the part from ``a`` to before ``b`` shortens the way; -1 where it does not."""
    first, last = order[a], order[b - 1]
    before = order[a - 1] if a else start
    left = -cost[before, first]
    if b < len(order):
        left += cost[before, order[b]] - cost[last, order[b]]
    for c in range(len(rest) + 1):
        before = rest[c - 1] if c else start
        longer = left + cost[before, first]
        if c < len(rest):
            longer += cost[last, rest[c]] - cost[before, rest[c]]
        if longer < -LESS:
            return c
    return -1


@njit(cache=True, nogil=True, error_model="numpy")
def _length(cost: FloatArray, start: int, order: NDArray[np.int64]) -> float:
    length, here = 0.0, start
    for there in order:
        length += cost[here, there]
        here = there
    return length
