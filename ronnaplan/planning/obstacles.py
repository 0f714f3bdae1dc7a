"""What a path must keep away from: metal, no-go label maps, and markers with their posts."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

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

    Only voxels at its surface are listed; ``mask`` (K, J, I) holds all.
    """

    kind: Kind
    name: str
    axes: FloatArray
    low_mm: FloatArray
    high_mm: FloatArray
    mask: NDArray[np.bool_]
    centres_mm: FloatArray

    @classmethod
    def of(cls, kind: Kind, name: str, mask: NDArray[np.bool_], head: Head) -> Voxels:
        """Lay out the voxels of ``mask`` (K, J, I). A voxel reaches half way to its neighbours."""
        scan = head.scan
        k, j, i = np.nonzero(_boundary(mask))
        edges = np.concatenate([scan.w_mm[:1], (scan.w_mm[1:] + scan.w_mm[:-1]) / 2, scan.w_mm[-1:]])
        edges[0] -= (scan.w_mm[1] - scan.w_mm[0]) / 2
        edges[-1] += (scan.w_mm[-1] - scan.w_mm[-2]) / 2
        u = scan.origins_uv_mm[k, 0] + i * scan.steps_mm[0]
        v = scan.origins_uv_mm[k, 1] + j * scan.steps_mm[1]
        half = scan.steps_mm / 2
        low = np.stack([u - half[0], v - half[1], edges[k]], axis=-1)
        high = np.stack([u + half[0], v + half[1], edges[k + 1]], axis=-1)
        return cls(kind, name, scan.axes, low, high, mask, ((low + high) / 2) @ scan.axes)

    def clearance(self, trajectory: Trajectory, head: Head) -> Clearance | None:
        """Return the least distance of the path to the obstacle; None when the obstacle is empty."""
        if len(self.low_mm) == 0:
            return None
        distance, share = box_distance(
            self.axes @ trajectory.entry_mm, self.axes @ trajectory.target_mm, self.low_mm, self.high_mm
        )
        for end, place in ((0.0, trajectory.entry_mm), (1.0, trajectory.target_mm)):
            if holds(self.mask, head, place):
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
    return Voxels.of(Kind.METAL, "metal", head.volume.voxels_hu >= METAL_HU, head)


def markers_on(head: Head, names: tuple[str, ...], centres_mm: FloatArray, diameter_mm: float) -> list[Marker]:
    """Return markers at ``centres_mm`` (N, 3), each with a post to the nearest place of the head."""
    boundary = head.boundary_mm
    nearest = [boundary[np.linalg.norm(boundary - centre, axis=1).argmin()] for centre in centres_mm]
    return [
        Marker(name, centre, foot, diameter_mm)
        for name, centre, foot in zip(names, centres_mm, nearest, strict=True)
    ]


def _boundary(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Voxels of ``mask`` with one of their six neighbours outside it."""
    padded = np.pad(mask, 1)
    surrounded = mask.copy()
    for axis in range(3):
        for shift in (-1, 1):
            surrounded &= np.roll(padded, shift, axis=axis)[1:-1, 1:-1, 1:-1]
    return mask & ~surrounded


def holds(mask: NDArray[np.bool_], head: Head, places_mm: FloatArray) -> NDArray[np.bool_]:
    """Return whether each LPS place (..., 3) lies in a voxel of ``mask`` (K, J, I)."""
    index = np.rint(head.volume.grid.indices(places_mm)).astype(int)
    inside = np.asarray(((index >= 0) & (index < mask.shape)).all(axis=-1))
    k, j, i = np.moveaxis(np.where(inside[..., np.newaxis], index, 0), -1, 0)
    held: NDArray[np.bool_] = inside & mask[k, j, i]
    return held
