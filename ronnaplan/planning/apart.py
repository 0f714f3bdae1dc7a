"""How far the trajectories of a plan are apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ronnaplan.geometry import FloatArray
from ronnaplan.planning.segments import segment_distances
from ronnaplan.planning.trajectory import Trajectory, ends_mm

ROUNDING_MM = 1e-6
"""A distance differs by less when it is measured from the other trajectory."""


@dataclass(frozen=True)
class Spacing:
    """Least distance of a trajectory to another one: between axes, and between the instruments' surfaces."""

    other: str
    distance_mm: float
    clearance_mm: float
    depth_mm: float


def spacings(trajectory: Trajectory, others: Sequence[Trajectory]) -> tuple[Spacing, ...]:
    """Return how near ``trajectory`` comes to each of ``others``, itself left out by name."""
    beside = [one for one in others if one.name != trajectory.name]
    found = _measured(trajectory, beside)
    return tuple(map(Spacing, (one.name for one in beside), *(values.tolist() for values in found)))


def _measured(trajectory: Trajectory, beside: Sequence[Trajectory]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return distances, clearances and depths (N,) of a trajectory to others, of all at once: there may be hundreds."""
    for one in beside:
        trajectory.frame.require(one.frame)
    ends = ends_mm(beside)
    distances, shares = segment_distances(trajectory.entry_mm, trajectory.target_mm, ends[:, 0], ends[:, 1])
    clearances = distances - trajectory.instrument.radius_mm - [one.instrument.radius_mm for one in beside]
    return distances, clearances, shares * trajectory.length_mm


class Apart:
    """Tells which trajectories of a plan are near to each other; after a change only what it changed is measured."""

    def __init__(self) -> None:
        self._known: tuple[Sequence[Trajectory], FloatArray] = ((), np.empty((0, 0)))

    def near(self, among: Sequence[Trajectory], reach_mm: float) -> list[tuple[Trajectory, ...]]:
        """Return for each trajectory the others whose instruments come within ``reach_mm`` of its own."""
        before, clearances_mm = self._known
        if before is not among:
            clearances_mm = _clearances_mm(among, before, clearances_mm)
            self._known = among, clearances_mm  # at once, for another thread may ask, too
        is_near = clearances_mm <= reach_mm + ROUNDING_MM
        return [tuple(among[n] for n in np.flatnonzero(row).tolist()) for row in is_near]


def _clearances_mm(among: Sequence[Trajectory], before: Sequence[Trajectory], before_mm: FloatArray) -> FloatArray:
    """Return the clearances (N, N) between trajectories, none to itself; ``before_mm`` are those that are known."""
    known = {one: number for number, one in enumerate(before)}
    kept = [number for number, one in enumerate(among) if one in known]
    found = np.full((len(among), len(among)), np.inf)
    were = [known[among[number]] for number in kept]
    found[np.ix_(kept, kept)] = before_mm[np.ix_(were, were)]
    for number, one in enumerate(among):
        if one not in known:
            found[number] = found[:, number] = _measured(one, among)[1]
            found[number, number] = np.inf
    return found
