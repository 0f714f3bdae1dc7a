"""Transmission of a polychromatic cone beam through a scene, by exact path lengths.

A view is a source and a virtual detector through the axis of rotation; each view has a geometry of its own, so an
orbit may be of any form and the scene may move.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from phantoms.attenuation import Matter, add_arriving
from phantoms.compiled import compiled, parallel_range
from phantoms.ray_rows import Rays, Row, mark_between, room_for
from phantoms.rays import FAR, PackedSolids, along, put_unit, put_unit_place
from phantoms.solids import FloatArray


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
    columns, half = len(signal), 0.5 * (panel.row_mm + panel.spot_up_mm)
    fine = np.zeros(columns, np.bool_)
    axis = views.middles[view] - views.sources[view]
    distance = np.sqrt(np.sum(axis * axis))
    forward = axis / distance
    row, found = room_for(len(solids.shapes)), 0
    for n in range(len(solids.shapes)):
        low, high, seen = _shadow(solids, n, views, view, forward, distance, row_mm, half)
        if not seen:
            continue
        low, high = low - 0.5 * panel.spot_across_mm, high + 0.5 * panel.spot_across_mm
        affine = solids.unit_from_world[n]
        row.solids[found], row.low_mm[found], row.high_mm[found] = n, low, high
        put_unit_place(affine, views.sources[view], row.origins[found])
        put_unit(affine, axis, row.directions[found])
        put_unit(affine, views.across[view], row.directions_by_mm[found])
        put_unit(affine, views.up[view], row.up[found])
        found += 1
        if matter.fine[n]:
            mark_between(low, high, panel.first_column_mm, panel.bin_mm, fine)
    total = np.zeros(columns)
    _add_samples(solids, matter, panel, row, found, row_mm, distance, 1, ~fine, total)
    if fine.any():
        _add_samples(solids, matter, panel, row, found, row_mm, distance, panel.fine, fine, total)
    for column in range(columns):
        signal[column] = total[column]


@compiled()
def _add_samples(
    solids: PackedSolids,
    matter: Matter,
    panel: Panel,
    row: Row,
    found: int,
    row_mm: float,
    distance_mm: float,
    samples: int,
    wanted: NDArray[np.bool_],
    total: FloatArray,
) -> None:
    """Add to ``total`` (U,) what arrives at the ``wanted`` elements along ``samples`` squared rays each."""
    columns, reach = len(total), panel.reach_mm / distance_mm
    starts, stops = np.full(columns, 1.0 - reach), np.full(columns, 1.0 + reach)
    sources, middles = row.origins[:found].copy(), row.directions[:found].copy()
    across, up = row.directions_by_mm[:found], row.up[:found]
    for sample in range(samples * samples):
        # Element and focal spot are sampled together so that every pair of places meets once (a Latin square).
        i, j = sample % samples, sample // samples
        first_mm = panel.first_column_mm + _offset(i, samples) * panel.bin_mm
        v = row_mm + _offset(j, samples) * panel.row_mm
        p = _offset((i + j) % samples, samples) * panel.spot_across_mm
        q = _offset((i + 2 * j) % samples, samples) * panel.spot_up_mm
        for n in range(found):
            for axis in range(3):
                row.origins[n, axis] = sources[n, axis] + p * across[n, axis] + q * up[n, axis]
                row.directions[n, axis] = middles[n, axis] - p * across[n, axis] + (v - q) * up[n, axis]
        aside = first_mm + np.arange(columns) * panel.bin_mm - p
        lengths = np.sqrt(distance_mm * distance_mm + aside * aside + (v - q) ** 2)
        rays = Rays(first_mm, panel.bin_mm, starts, stops, lengths, 0.0)
        add_arriving(solids, matter, row, found, rays, wanted, 1.0 / (samples * samples), total)
    for n in range(found):
        for axis in range(3):
            row.origins[n, axis], row.directions[n, axis] = sources[n, axis], middles[n, axis]


@compiled()
def _offset(n: int, samples: int) -> float:
    """Return sample ``n`` of a width of 1 about 0; all together have the width's own variance, 1 / 12."""
    if samples == 1:
        return 0.0
    offset: float = ((n + 0.5) / samples - 0.5) / np.sqrt(1 - 1 / (samples * samples))
    return offset


@compiled()
def _shadow(
    solids: PackedSolids,
    n: int,
    views: Views,
    view: int,
    forward: FloatArray,
    distance: float,
    row_mm: float,
    half_mm: float,
) -> tuple[float, float, bool]:
    """Return between which columns (mm) a solid's bounding ball casts its shadow, and whether on this row at all."""
    source, center, radius = views.sources[view], solids.centers_mm[n], solids.radii_mm[n]
    depth = along(forward, center, source)
    if depth <= radius + 1.0:
        return -FAR, FAR, True
    beside, above = along(views.across[view], center, source), along(views.up[view], center, source)
    large, small = distance / (depth - radius), distance / (depth + radius)
    low_row, high_row = above - radius, above + radius
    if min(low_row * large, low_row * small) > row_mm + half_mm:
        return 0.0, 0.0, False
    if max(high_row * large, high_row * small) < row_mm - half_mm:
        return 0.0, 0.0, False
    low, high = beside - radius, beside + radius
    return min(low * large, low * small), max(high * large, high * small), True
