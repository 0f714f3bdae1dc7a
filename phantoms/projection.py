"""Transmission of a polychromatic parallel beam through a scene, by exact path lengths."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from phantoms.attenuation import Matter, add_arriving
from phantoms.compiled import compiled, parallel_range
from phantoms.ray_rows import Rays, mark_between, room_for
from phantoms.rays import PackedSolids, along, put_unit, put_unit_place
from phantoms.solids import FloatArray

BEND = 5e-3
"""Elements about which the intensity bends by more than this share of itself are looked at closely, too: single rays
tell too little of an edge that they run along, and a large disc of water would be brighter near its own."""


class Detector(NamedTuple):
    """Elements ``bin_mm`` wide and ``row_mm`` high.

    Near what is looked at closely, and at edges, each is sampled by ``samples`` squared rays, elsewhere by one. Only
    what lies within ``bore_mm`` of the plane's center is seen.
    """

    bin_mm: float
    row_mm: float
    samples: int
    bore_mm: float


@compiled(parallel=True)
def transmission(
    solids: PackedSolids,
    matter: Matter,
    detector: Detector,
    planes: FloatArray,
    axes: FloatArray,
    angles: FloatArray,
    signal: NDArray[np.float32],
) -> None:
    """Fill ``signal`` (R, V, U) with the fraction of the beam that arrives.

    ``planes`` (R, V, 3) are the centers of the detector rows' planes in each view; the rows of ``axes`` (R, V, 3, 3)
    are the column, row and normal directions. Over one element intensities, not logarithms, are averaged, as in a
    real detector.
    """
    rows, views, _ = signal.shape
    for job in parallel_range(rows * views):
        row, view = job // views, job % views
        _measure_view(
            solids, matter, detector, planes[row, view], axes[row, view], angles[view], signal[row, view]
        )


@compiled()
def _measure_view(
    solids: PackedSolids,
    matter: Matter,
    detector: Detector,
    plane: FloatArray,
    axes: FloatArray,
    angle: float,
    signal: NDArray[np.float32],
) -> None:
    """Fill one view (U,) of one detector row."""
    columns, samples = len(signal), detector.samples
    first_mm = -(columns - 1) / 2 * detector.bin_mm
    across = np.cos(angle) * axes[0] + np.sin(angle) * axes[1]
    forward = np.cos(angle) * axes[1] - np.sin(angle) * axes[0]
    fine = np.zeros(columns, np.bool_)
    row, found = room_for(len(solids.shapes)), 0
    for n in range(len(solids.shapes)):
        radius = solids.radii_mm[n]
        height = max(0.0, abs(along(axes[2], solids.centers_mm[n], plane)) - 0.5 * detector.row_mm)
        if height >= radius:
            continue
        reach, aside = np.sqrt(radius * radius - height * height), along(across, solids.centers_mm[n], plane)
        affine = solids.unit_from_world[n]
        row.solids[found], row.low_mm[found], row.high_mm[found] = n, aside - reach, aside + reach
        put_unit_place(affine, plane, row.origins[found])
        put_unit(affine, across, row.origins_by_mm[found])
        put_unit(affine, forward, row.directions[found])
        put_unit(affine, axes[2], row.up[found])
        found += 1
        if matter.fine[n]:
            mark_between(aside - reach, aside + reach, first_mm, detector.bin_mm, fine)
    places = first_mm + np.arange(columns) * detector.bin_mm
    bore = np.sqrt(np.maximum(0.0, detector.bore_mm**2 - places * places))
    total, ones = np.zeros(columns), np.ones(columns)
    rays = Rays(first_mm, detector.bin_mm, -bore, bore, ones, 0.5 * detector.row_mm)
    add_arriving(solids, matter, row, found, rays, ~fine, 1.0, total)
    _mark_bends(total, fine)
    if fine.any():
        total[fine] = 0.0
        middles = row.origins.copy()
        for sample in range(samples * samples):
            aside = ((sample % samples + 0.5) / samples - 0.5) * detector.bin_mm
            height = ((sample // samples + 0.5) / samples - 0.5) * detector.row_mm
            for n in range(found):
                for axis in range(3):
                    row.origins[n, axis] = middles[n, axis] + height * row.up[n, axis]
            rays = Rays(first_mm + aside, detector.bin_mm, -bore, bore, ones, 0.5 * detector.row_mm / samples)
            add_arriving(solids, matter, row, found, rays, fine, 1.0 / samples**2, total)
    for column in range(columns):
        signal[column] = total[column]


@compiled()
def _mark_bends(intensity: FloatArray, marks: NDArray[np.bool_]) -> None:
    """Mark the elements, of those not yet marked, about which the intensity bends."""
    known = ~marks
    for n in range(1, len(intensity) - 1):
        if known[n - 1] and known[n] and known[n + 1]:
            bend = intensity[n - 1] - 2.0 * intensity[n] + intensity[n + 1]
            if abs(bend) > BEND * intensity[n]:
                marks[n - 1 : n + 2] = True
