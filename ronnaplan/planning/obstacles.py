"""What a path must keep away from: metal, no-go label maps, and markers with their posts."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from ronnaplan.ct.volume import SliceGrid
from ronnaplan.geometry import FloatArray
from ronnaplan.planning.head import Head
from ronnaplan.planning.segments import box_distance, point_distances, segment_distances
from ronnaplan.planning.trajectory import Trajectory

METAL_HU = 2500.0
"""Denser than any bone and enamel (2,100 HU); the scale of most scanners ends at 3,071."""

POST_RADIUS_MM = 5.0
"""A marker's post and its base are taken as this wide all along."""


class Kind(StrEnum):
    """The kinds of obstacle, each with its own limit."""

    NO_GO = "no-go"
    METAL = "metal"
    MARKER = "marker"


@dataclass(frozen=True)
class Clearance:
    """The least distance of a path to one obstacle.

    ``distance_mm`` is from the path's axis to the obstacle's surface, ``clearance_mm`` from the instrument's
    surface (negative: they meet). ``depth_mm`` is where, from the entry towards the target.
    """

    kind: Kind
    name: str
    distance_mm: float
    clearance_mm: float
    depth_mm: float

    @property
    def crosses(self) -> bool:
        """Whether the instrument meets the obstacle."""
        return self.clearance_mm <= 0.0


@dataclass(frozen=True, eq=False)
class Voxels:
    """An obstacle made of whole voxels of the scan: boxes ``low_mm``..``high_mm`` (N, 3) along the slice axes.

    Only voxels at its surface are listed; ``held`` (H,), ascending, numbers all of them in the scan's order.
    """

    kind: Kind
    name: str
    axes: FloatArray
    low_mm: FloatArray
    high_mm: FloatArray
    held: NDArray[np.int64]
    grid: SliceGrid
    shape: tuple[int, ...]

    @classmethod
    def of(cls, kind: Kind, name: str, mask: NDArray[np.bool_], head: Head) -> Voxels:
        """Lay out the voxels of ``mask`` (K, J, I)."""
        return cls.at(kind, name, np.flatnonzero(mask), head)

    @classmethod
    def at(cls, kind: Kind, name: str, held: NDArray[np.int64], head: Head) -> Voxels:
        """Lay out voxels by their numbers (H,), ascending. A voxel reaches half way to its neighbours."""
        scan, shape = head.scan, head.volume.voxels_hu.shape
        k, j, i = _boundary(held, shape)
        edges = np.concatenate([scan.w_mm[:1], (scan.w_mm[1:] + scan.w_mm[:-1]) / 2, scan.w_mm[-1:]])
        edges[0] -= (scan.w_mm[1] - scan.w_mm[0]) / 2
        edges[-1] += (scan.w_mm[-1] - scan.w_mm[-2]) / 2
        u = scan.origins_uv_mm[k, 0] + i * scan.steps_mm[0]
        v = scan.origins_uv_mm[k, 1] + j * scan.steps_mm[1]
        half = scan.steps_mm / 2
        low = np.stack([u - half[0], v - half[1], edges[k]], axis=-1)
        high = np.stack([u + half[0], v + half[1], edges[k + 1]], axis=-1)
        return cls(kind, name, scan.axes, low, high, held, head.volume.grid, shape)

    @property
    def centres_mm(self) -> FloatArray:
        """Middles (N, 3) of the listed voxels in LPS mm."""
        centres: FloatArray = ((self.low_mm + self.high_mm) / 2) @ self.axes
        return centres

    def holds(self, places_mm: FloatArray) -> NDArray[np.bool_]:
        """Return whether each LPS place (..., 3) lies in one of the voxels."""
        index = np.rint(self.grid.indices(places_mm)).astype(int)
        within = np.asarray(((index >= 0) & (index < self.shape)).all(axis=-1))
        k, j, i = np.moveaxis(np.where(within[..., np.newaxis], index, 0), -1, 0)
        held: NDArray[np.bool_] = within & _among((k * self.shape[1] + j) * self.shape[2] + i, self.held)
        return held

    def clearance(self, trajectory: Trajectory, head: Head) -> Clearance | None:
        """Return the least distance of the path to the obstacle; None when the obstacle is empty."""
        if len(self.low_mm) == 0:
            return None
        distance, share = box_distance(
            self.axes @ trajectory.entry_mm, self.axes @ trajectory.target_mm, self.low_mm, self.high_mm
        )
        for end, place in ((0.0, trajectory.entry_mm), (1.0, trajectory.target_mm)):
            if self.holds(place):
                distance, share = 0.0, end
        return Clearance(
            self.kind,
            self.name,
            float(distance),
            float(distance) - trajectory.instrument.radius_mm,
            float(share) * trajectory.length_mm,
        )


@dataclass(frozen=True, eq=False)
class Marker:
    """A sphere at ``centre_mm`` (3,) on a post that reaches to ``foot_mm`` (3,) on the head."""

    name: str
    centre_mm: FloatArray
    foot_mm: FloatArray
    diameter_mm: float

    def clearance(self, trajectory: Trajectory, head: Head) -> Clearance:
        """Return the least distance of the whole instrument, outside the head too, to the sphere and its post."""
        tail = (
            trajectory.target_mm - max(trajectory.instrument.length_mm, trajectory.length_mm) * trajectory.inward
        )
        sphere = float(point_distances(self.centre_mm, tail, trajectory.target_mm)) - self.diameter_mm / 2
        axis, _ = segment_distances(tail, trajectory.target_mm, self.centre_mm, self.foot_mm)
        distance = max(min(sphere, float(axis) - POST_RADIUS_MM), 0.0)
        _, share = segment_distances(trajectory.entry_mm, trajectory.target_mm, self.centre_mm, self.foot_mm)
        clearance = distance - trajectory.instrument.radius_mm
        return Clearance(Kind.MARKER, self.name, distance, clearance, float(share) * trajectory.length_mm)


Obstacle = Voxels | Marker


def metal(head: Head) -> Voxels:
    """Return all voxels of the scan at or above `METAL_HU`."""
    planes = head.volume.voxels_hu  # one at a time: a mask of the whole scan would take half its memory
    held = [np.flatnonzero(plane >= METAL_HU) + k * plane.size for k, plane in enumerate(planes)]
    return Voxels.at(Kind.METAL, "metal", np.concatenate(held), head)


def markers_on(head: Head, names: tuple[str, ...], centres_mm: FloatArray, diameter_mm: float) -> list[Marker]:
    """Return markers at ``centres_mm`` (N, 3), each with a post to the nearest place of the head."""
    boundary = head.boundary_mm
    nearest = [boundary[np.linalg.norm(boundary - centre, axis=1).argmin()] for centre in centres_mm]
    return [
        Marker(name, centre, foot, diameter_mm)
        for name, centre, foot in zip(names, centres_mm, nearest, strict=True)
    ]


def _boundary(held: NDArray[np.int64], shape: tuple[int, ...]) -> tuple[NDArray[np.intp], ...]:
    """Slices, rows and columns of the voxels ``held`` (H,) with one of their six neighbours not among them."""
    places = np.unravel_index(held, shape)
    surrounded = np.ones(len(held), dtype=np.bool_)
    for place, size, step in zip(places, shape, (shape[1] * shape[2], shape[2], 1), strict=True):
        surrounded &= (place > 0) & _among(held - step, held) & (place < size - 1) & _among(held + step, held)
    return tuple(place[~surrounded] for place in places)


def _among(numbers: NDArray[np.int64], held: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return whether each of ``numbers`` (...) is one of ``held`` (H,), which ascend."""
    if len(held) == 0:
        return np.zeros(numbers.shape, dtype=np.bool_)
    found: NDArray[np.bool_] = held[np.minimum(np.searchsorted(held, numbers), len(held) - 1)] == numbers
    return found
