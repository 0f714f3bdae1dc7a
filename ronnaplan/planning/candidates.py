"""All straight ways from a target to the scalp, measured coarsely: tens of thousands in a second.

What is found here ranks candidates; those that are proposed are measured anew with `ronnaplan.planning.measure`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ronnaplan.geometry import FloatArray
from ronnaplan.planning.head import Head
from ronnaplan.planning.obstacles import Voxels
from ronnaplan.threads import in_threads

FIELD_MM = 2.0
"""Spacing of the nodes of the distance field."""

BALL_MM, BALL_POINTS = 3.0, 48
"""Radius of the ball over which the skull's normal is taken, and the places read on its surface."""

CHUNK = 512
"""Candidates a thread takes at a time."""


@dataclass(frozen=True, eq=False)
class Field:
    """Distance (mm) to the nearest obstacle voxel at nodes ``corner_mm`` + `FIELD_MM` * (x, y, z), slice axes.

    Negative inside an obstacle. Right to about half a millimetre: a voxel counts as a ball as wide as its mean
    size; at an obstacle thinner than the nodes' spacing too large, by a millimetre at most.
    """

    corner_mm: FloatArray
    distances_mm: NDArray[np.float32]

    @classmethod
    def of(cls, obstacles: Sequence[Voxels], head: Head) -> Field:
        """Compute the field over the head; far away everywhere when there is no obstacle."""
        from scipy.ndimage import distance_transform_edt

        boundary = head.boundary_mm @ head.scan.axes.T
        corner = boundary.min(axis=0) - 2 * FIELD_MM
        shape = np.ceil((boundary.max(axis=0) - corner) / FIELD_MM).astype(int) + 4
        points = np.concatenate([(o.low_mm + o.high_mm) / 2 for o in obstacles] or [np.empty((0, 3))])
        cells = np.rint((points - corner) / FIELD_MM).astype(int)
        near = ((cells >= 0) & (cells < shape)).all(axis=1)
        points, cells = points[near], cells[near]
        if len(points) == 0:
            return cls(corner, np.full(shape, np.inf, dtype=np.float32))
        owner = np.full(shape, -1)
        owner[tuple(cells.T)] = np.arange(len(points))
        nearest = distance_transform_edt(owner < 0, return_distances=False, return_indices=True)
        nodes = corner + FIELD_MM * np.moveaxis(np.indices(owner.shape), 0, -1)
        sizes = np.concatenate([(o.high_mm - o.low_mm).mean(axis=1) for o in obstacles])[near]
        at = owner[tuple(nearest)]
        distances = np.linalg.norm(nodes - points[at], axis=-1) - sizes[at] / 2
        for one in obstacles:
            within = one.holds(nodes @ head.scan.axes)
            distances[within] = -np.abs(distances[within])
        return cls(corner, distances.astype(np.float32))


@dataclass(frozen=True, eq=False)
class Candidates:
    """Rays from one target: ``outward`` (M, 3) in LPS and, for each, what was met on the way.

    ``way`` (M,) holds `Way` numbers; lengths in mm along the ray, NaN where not met. ``clean`` tells that no bone
    and no air lie between inner table and target; ``angle_deg`` is to the skull's normal, ``distance_mm`` from the
    axis to the nearest obstacle voxel.
    """

    target_mm: FloatArray
    outward: FloatArray
    way: NDArray[np.int64]
    scalp_mm: FloatArray
    outer_mm: FloatArray
    inner_mm: FloatArray
    angle_deg: FloatArray
    distance_mm: FloatArray
    clean: NDArray[np.bool_]

    @property
    def entries_mm(self) -> FloatArray:
        """Scalp points (M, 3) in LPS; NaN where the scalp is not reached."""
        entries: FloatArray = self.target_mm + self.scalp_mm[:, np.newaxis] * self.outward
        return entries


def spread_directions(count: int) -> FloatArray:
    """Return ``count`` unit vectors (count, 3) spread evenly over the sphere (Fibonacci lattice)."""
    z = 1.0 - (2.0 * np.arange(count) + 1.0) / count
    angle = np.pi * (1.0 + np.sqrt(5.0)) * np.arange(count)
    ring = np.sqrt(1.0 - z**2)
    return np.column_stack([ring * np.cos(angle), ring * np.sin(angle), z])


def cast(head: Head, target_mm: FloatArray, outward: FloatArray, field: Field) -> Candidates:
    """Follow each of the rays ``outward`` (M, 3) from ``target_mm`` (3,), on all cores."""
    from ronnaplan.planning.compiled import search

    count = len(outward)
    numbers = np.full((count, 5), np.nan)
    states = np.zeros((count, 2), dtype=np.int64)
    scan = head.scan
    local = np.ascontiguousarray(outward @ scan.axes.T)

    def run(start: int) -> None:
        part = slice(start, start + CHUNK)
        search(
            scan.voxels,
            scan.origins_uv_mm,
            scan.w_mm,
            scan.steps_mm,
            head.inside,
            head.cell,
            scan.axes @ target_mm,
            local[part],
            FIELD_MM,
            field.corner_mm,
            field.distances_mm,
            BALL_MM * spread_directions(BALL_POINTS),
            numbers[part],
            states[part],
        )

    list(in_threads(run, range(0, count, CHUNK)))
    scalp, outer, inner, angle, distance = numbers.T
    clean = states[:, 1] > 0
    return Candidates(target_mm, outward, states[:, 0], scalp, outer, inner, angle, distance, clean)
