"""What rows of polychromatic rays lose on their way through solids that replace each other where they overlap."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from phantoms.compiled import compiled
from phantoms.ray_rows import Rays, Row, intervals
from phantoms.rays import PackedSolids
from phantoms.solids import FloatArray

TILE = 32
"""Rays of a row that are worked on together."""


class Matter(NamedTuple):
    """What the beam meets: each solid's row of ``attenuation`` (M, B) per mm, and the beam's ``weights`` (B,).

    ``fine`` (N,) tells which solids are looked at closely.
    """

    material_of: NDArray[np.int64]
    attenuation: FloatArray
    weights: FloatArray
    fine: NDArray[np.bool_]


@compiled()
def add_arriving(
    solids: PackedSolids,
    matter: Matter,
    row: Row,
    found: int,
    rays: Rays,
    wanted: NDArray[np.bool_],
    share: float,
    signal: FloatArray,
) -> None:
    """Add to ``signal`` (U,), times ``share``, the part of the beam that arrives along each ``wanted`` ray."""
    starts, stops = np.empty((found, TILE)), np.empty((found, TILE))
    kinds, (materials, energies) = np.empty(found, np.int64), matter.attenuation.shape
    room = _Room(
        np.empty(found), np.empty(found), np.zeros(materials), np.empty(materials, np.int64), np.empty(energies)
    )
    for first in range(0, len(wanted), TILE):
        last = min(first + TILE, len(wanted))
        if not wanted[first:last].any():
            continue
        left, right = rays.first_mm + first * rays.step_mm, rays.first_mm + (last - 1) * rays.step_mm
        met = 0
        for c in range(found):
            if row.low_mm[c] <= right and row.high_mm[c] >= left:
                intervals(solids, row, c, rays, first, last, starts[met], stops[met])
                kinds[met] = matter.material_of[row.solids[c]]
                met += 1
        for i in range(first, last):
            if wanted[i]:
                touched = _add_lengths(starts, stops, kinds, met, i - first, rays.starts[i], rays.stops[i], room)
                signal[i] += share * _passing(matter, touched, rays.lengths_mm[i], room)


class _Room(NamedTuple):
    """Storage for one ray: what is hidden so far, how long it is in each material, and which those are."""

    low: FloatArray
    high: FloatArray
    lengths: FloatArray
    touched: NDArray[np.int64]
    depths: FloatArray


@compiled()
def _add_lengths(
    starts: FloatArray,
    stops: FloatArray,
    kinds: NDArray[np.int64],
    met: int,
    ray: int,
    nearest: float,
    farthest: float,
    room: _Room,
) -> int:
    """Add the length of what is seen of each interval to its material's; returns how many materials there are.

    From the last solid, which hides what it overlaps, to the first.
    """
    hidden, touches = 0, 0
    for c in range(met - 1, -1, -1):
        start, stop = max(starts[c, ray], nearest), min(stops[c, ray], farthest)
        if stop <= start:
            continue
        seen, kept, lowest, highest = stop - start, 0, start, stop
        for h in range(hidden):
            low, high = room.low[h], room.high[h]
            if low > stop or high < start:
                room.low[kept], room.high[kept] = low, high
                kept += 1
            else:
                seen -= min(stop, high) - max(start, low)
                lowest, highest = min(lowest, low), max(highest, high)
        room.low[kept], room.high[kept] = lowest, highest
        hidden = kept + 1
        if seen > 0:
            if room.lengths[kinds[c]] == 0.0:
                room.touched[touches] = kinds[c]
                touches += 1
            room.lengths[kinds[c]] += seen
    return touches


@compiled()
def _passing(matter: Matter, touched: int, length_mm: float, room: _Room) -> float:
    """Return what passes the ``touched`` materials, all energies together, and clear their lengths."""
    if touched == 0:
        return 1.0
    energies, total = len(matter.weights), 0.0
    room.depths[:] = 0.0
    for k in range(touched):
        kind = room.touched[k]
        for b in range(energies):
            room.depths[b] += matter.attenuation[kind, b] * (room.lengths[kind] * length_mm)
        room.lengths[kind] = 0.0
    for b in range(energies):
        total += matter.weights[b] * _exp_minus(room.depths[b])
    return total


@compiled()
def _exp_minus(depth: float) -> float:
    """Return ``exp(-depth)`` to 1e-7 or better, in a form that the compiler turns into vector instructions."""
    x = min(depth, 700.0) / 1024
    y: float = 1 - x * (1 - x * (0.5 - x * (1 / 6 - x / 24)))
    for _ in range(10):
        y *= y
    result: float = y
    return result
