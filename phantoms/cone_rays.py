"""Transmission of a polychromatic cone beam through a scene, by exact path lengths.

A view is a source and a virtual detector through the axis of rotation; each view has a geometry of its own, so an
orbit may be of any form and the scene may move.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from phantoms.compiled import compiled, parallel_range
from phantoms.projection import Matter, exp_minus
from phantoms.rays import FAR, PackedSolids, to_unit, unit_interval
from phantoms.solids import FloatArray

TILE = 16
"""Columns for which the solids that they may see are listed together."""
MOST_HITS = 96
"""Solids that one ray may cross."""


class Views(NamedTuple):
    """Where source and virtual detector are in each view, in the scene's own coordinates (LPS mm); all (V, 3)."""

    sources: FloatArray
    middles: FloatArray
    """Where the detector's column 0 mm and row 0 mm is: on the axis of rotation."""
    across: FloatArray
    """Unit direction of increasing columns."""
    up: FloatArray
    """Unit direction of increasing rows."""


class Panel(NamedTuple):
    """A flat detector, scaled down to the axis of rotation, and the focal spot in its true size."""

    bin_mm: float
    row_mm: float
    """Width and height of an element."""
    first_column_mm: float
    first_row_mm: float
    """Middles of the first column and row."""
    fine: int
    """Rays along each edge of an element near what is looked at closely; elsewhere one ray an element."""
    reach_mm: float
    """Only what lies this near the axis of rotation, along the ray, is seen."""
    spot_across_mm: float = 0.0
    spot_up_mm: float = 0.0
    """Focal spot, sampled where rays are fine."""


class _Near(NamedTuple):
    """Solids that a detector row may see: their number, the columns (mm) between which they lie, and their rays.

    A ray at column u and row v has, in unit coordinates, the origin ``o`` and direction ``d + u across + v up``.
    """

    solids: NDArray[np.int64]
    low_mm: FloatArray
    high_mm: FloatArray
    o: FloatArray
    d: FloatArray
    across: FloatArray
    up: FloatArray


class _Work(NamedTuple):
    """Storage for one ray."""

    edges: FloatArray
    marks: NDArray[np.int64]
    owners: NDArray[np.int64]
    open: NDArray[np.bool_]
    lengths: FloatArray
    touched: NDArray[np.int64]
    depths: FloatArray


@compiled(parallel=True)
def cone_transmission(
    solids: PackedSolids, matter: Matter, panel: Panel, views: Views, signal: NDArray[np.float32]
) -> None:
    """Fill ``signal`` (V, rows, columns) with the fraction of the beam that arrives at each element."""
    count, rows, _ = signal.shape
    for job in parallel_range(count * rows):
        view, row = job // rows, job % rows
        _measure_row(
            solids, matter, panel, views, view, panel.first_row_mm + row * panel.row_mm, signal[view, row]
        )


@compiled()
def _measure_row(
    solids: PackedSolids,
    matter: Matter,
    panel: Panel,
    views: Views,
    view: int,
    row_mm: float,
    signal: NDArray[np.float32],
) -> None:
    """Fill one row (U,) of one view."""
    parts, columns, half = len(solids.shapes), len(signal), 0.5 * (panel.row_mm + panel.spot_up_mm)
    near = _Near(
        np.empty(parts, np.int64),
        np.empty(parts),
        np.empty(parts),
        np.empty((parts, 3)),
        np.empty((parts, 3)),
        np.empty((parts, 3)),
        np.empty((parts, 3)),
    )
    fine = np.zeros(columns, np.bool_)
    found = 0
    for n in range(parts):
        low, high, seen = _shadow(solids, n, views, view, row_mm, half)
        if not seen:
            continue
        low, high = low - 0.5 * panel.spot_across_mm, high + 0.5 * panel.spot_across_mm
        near.solids[found], near.low_mm[found], near.high_mm[found] = n, low, high
        affine = solids.unit_from_world[n]
        near.o[found] = to_unit(affine, views.sources[view]) + affine[:, 3]
        near.d[found] = to_unit(affine, views.middles[view] - views.sources[view])
        near.across[found] = to_unit(affine, views.across[view])
        near.up[found] = to_unit(affine, views.up[view])
        found += 1
        if matter.fine[n]:
            first = max(0, int((low - panel.first_column_mm) / panel.bin_mm - 0.5))
            last = min(columns - 1, int((high - panel.first_column_mm) / panel.bin_mm + 1.5))
            fine[first : last + 1] = True
    materials, energies = matter.attenuation.shape
    work = _Work(
        np.empty(2 * MOST_HITS),
        np.empty(2 * MOST_HITS, np.int64),
        np.empty(MOST_HITS, np.int64),
        np.zeros(MOST_HITS, np.bool_),
        np.zeros(materials),
        np.empty(materials, np.int64),
        np.empty(energies),
    )
    distance = np.sqrt(np.sum((views.middles[view] - views.sources[view]) ** 2))
    active, count = np.empty(found, np.int64), 0
    for column in range(columns):
        if column % TILE == 0:
            start = panel.first_column_mm + (column - 0.5) * panel.bin_mm
            count = _within(near, found, start, start + TILE * panel.bin_mm, active)
        samples = panel.fine if fine[column] else 1
        total = 0.0
        for sample in range(samples * samples):
            # Element and focal spot are sampled together so that every pair of places meets once (a Latin square).
            i, j = sample % samples, sample // samples
            u = panel.first_column_mm + (column + _offset(i, samples)) * panel.bin_mm
            v = row_mm + _offset(j, samples) * panel.row_mm
            p = _offset((i + j) % samples, samples) * panel.spot_across_mm
            q = _offset((i + 2 * j) % samples, samples) * panel.spot_up_mm
            total += _arriving(solids, matter, near, active[:count], u, v, p, q, distance, panel.reach_mm, work)
        signal[column] = total / (samples * samples)


@compiled()
def _within(near: _Near, found: int, low: float, high: float, active: NDArray[np.int64]) -> int:
    """Put the solids that some column between ``low`` and ``high`` may see into ``active``; returns how many."""
    count = 0
    for c in range(found):
        if near.low_mm[c] <= high and near.high_mm[c] >= low:
            active[count] = c
            count += 1
    return count


@compiled()
def _offset(n: int, samples: int) -> float:
    """Return sample ``n`` of a width of 1 about 0; all together have the width's own variance, 1 / 12."""
    if samples == 1:
        return 0.0
    offset: float = ((n + 0.5) / samples - 0.5) / np.sqrt(1 - 1 / (samples * samples))
    return offset


@compiled()
def _shadow(
    solids: PackedSolids, n: int, views: Views, view: int, row_mm: float, half_mm: float
) -> tuple[float, float, bool]:
    """Return between which columns (mm) a solid's bounding ball casts its shadow, and whether on this row at all."""
    axis = views.middles[view] - views.sources[view]
    distance = np.sqrt(np.sum(axis * axis))
    offset = solids.centers_mm[n] - views.sources[view]
    depth, radius = np.sum(offset * axis) / distance, solids.radii_mm[n]
    if depth <= radius + 1.0:
        return -FAR, FAR, True
    beside, above = np.sum(offset * views.across[view]), np.sum(offset * views.up[view])
    large, small = distance / (depth - radius), distance / (depth + radius)
    low_row, high_row = above - radius, above + radius
    if min(low_row * large, low_row * small) > row_mm + half_mm:
        return 0.0, 0.0, False
    if max(high_row * large, high_row * small) < row_mm - half_mm:
        return 0.0, 0.0, False
    low, high = beside - radius, beside + radius
    return min(low * large, low * small), max(high * large, high * small), True


@compiled()
def _arriving(
    solids: PackedSolids,
    matter: Matter,
    near: _Near,
    active: NDArray[np.int64],
    u: float,
    v: float,
    p: float,
    q: float,
    distance: float,
    reach_mm: float,
    work: _Work,
) -> float:
    """Return the fraction of the beam that arrives along the ray from (p, q) on the focal spot to (u, v)."""
    nearest, farthest = 1.0 - reach_mm / distance, 1.0 + reach_mm / distance
    hits = 0
    for c in active:
        if not near.low_mm[c] <= u <= near.high_mm[c]:
            continue
        n, a, b, o, d = near.solids[c], near.across[c], near.up[c], near.o[c], near.d[c]
        t0, t1 = unit_interval(
            solids.shapes[n],
            o[0] + p * a[0] + q * b[0],
            o[1] + p * a[1] + q * b[1],
            o[2] + p * a[2] + q * b[2],
            d[0] + (u - p) * a[0] + (v - q) * b[0],
            d[1] + (u - p) * a[1] + (v - q) * b[1],
            d[2] + (u - p) * a[2] + (v - q) * b[2],
            solids.top_ratios[n],
        )
        t0, t1 = max(t0, nearest), min(t1, farthest)
        if t1 > t0 and hits < MOST_HITS:
            _insert(work, 2 * hits, t0, hits)
            _insert(work, 2 * hits + 1, t1, hits)
            work.owners[hits] = matter.material_of[n]
            hits += 1
    if hits == 0:
        return 1.0
    return _attenuated(matter, hits, np.sqrt(distance * distance + (u - p) ** 2 + (v - q) ** 2), work)


@compiled()
def _insert(work: _Work, filled: int, value: float, hit: int) -> None:
    """Keep the edges in ascending order."""
    place = filled
    while place > 0 and work.edges[place - 1] > value:
        work.edges[place] = work.edges[place - 1]
        work.marks[place] = work.marks[place - 1]
        place -= 1
    work.edges[place] = value
    work.marks[place] = hit


@compiled()
def _attenuated(matter: Matter, hits: int, length_mm: float, work: _Work) -> float:
    """Sweep the sorted edges: each piece belongs to the last solid that is open; then weigh all energies."""
    owner, kinds = -1, 0
    for edge in range(2 * hits - 1):
        hit = work.marks[edge]
        if work.open[hit]:
            work.open[hit] = False
            if hit == owner:
                owner -= 1
                while owner >= 0 and not work.open[owner]:
                    owner -= 1
        else:
            work.open[hit] = True
            owner = max(owner, hit)
        piece = work.edges[edge + 1] - work.edges[edge]
        if owner >= 0 and piece > 0:
            kind = work.owners[owner]
            if work.lengths[kind] == 0.0:
                work.touched[kinds] = kind
                kinds += 1
            work.lengths[kind] += piece
    work.open[:hits] = False
    energies = len(matter.weights)
    work.depths[:] = 0.0
    for k in range(kinds):
        kind = work.touched[k]
        for b in range(energies):
            work.depths[b] += matter.attenuation[kind, b] * (work.lengths[kind] * length_mm)
        work.lengths[kind] = 0.0
    total = 0.0
    for b in range(energies):
        total += matter.weights[b] * exp_minus(work.depths[b])
    return total
