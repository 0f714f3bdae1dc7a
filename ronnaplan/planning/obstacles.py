"""What a path must keep away from: metal, no-go label maps, and markers with their posts."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from ronnaplan.bounds import METAL_HU
from ronnaplan.ct.grid import SliceGrid
from ronnaplan.geometry import FloatArray
from ronnaplan.planning.head import Head
from ronnaplan.planning.segments import box_distance, point_distances, segment_distances
from ronnaplan.planning.smooth import Patch, fit_patch
from ronnaplan.planning.trajectory import Trajectory

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
    surface (negative: they meet). ``depth_mm`` is where, from the entry towards the target. ``at_least_mm`` is the
    clearance that is sure: the surface behind a label's voxels is known so far and no further. Limits count it.
    ``smooth`` tells that the distance is to that surface, not to the voxels.
    """

    kind: Kind
    name: str
    distance_mm: float
    clearance_mm: float
    depth_mm: float
    at_least_mm: float
    smooth: bool = False

    @property
    def crosses(self) -> bool:
        """Whether the instrument meets the obstacle, or may meet it."""
        return self.at_least_mm <= 0.0


@dataclass(frozen=True, eq=False)
class Voxels:
    """An obstacle made of whole voxels of the scan: boxes ``low_mm``..``high_mm`` (N, 3) along the slice axes.

    Only voxels at its surface are listed, ``kji`` (N, 3); ``held`` (H,), ascending, numbers all of them in the scan's
    order. ``patches`` keeps the pieces of smooth surface that were fitted so far, by number in the list.
    """

    kind: Kind
    name: str
    axes: FloatArray
    low_mm: FloatArray
    high_mm: FloatArray
    kji: NDArray[np.intp]
    held: NDArray[np.int64]
    grid: SliceGrid
    shape: tuple[int, ...]
    patches: dict[int, Patch | None] = field(default_factory=dict)

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
        return cls(kind, name, scan.axes, low, high, np.stack([k, j, i], axis=1), held, head.volume.grid, shape)

    @property
    def centers_mm(self) -> FloatArray:
        """Middles (N, 3) of the listed voxels in LPS mm."""
        centers: FloatArray = ((self.low_mm + self.high_mm) / 2) @ self.axes
        return centers

    def holds(self, places_mm: FloatArray) -> NDArray[np.bool_]:
        """Return whether each LPS place (..., 3) lies in one of the voxels."""
        return self.has(np.rint(self.grid.indices(places_mm)).astype(int))

    def has(self, index: NDArray[np.intp]) -> NDArray[np.bool_]:
        """Return whether each voxel (k, j, i) (..., 3), in the scan or not, is one of these."""
        within = np.asarray(((index >= 0) & (index < self.shape)).all(axis=-1))
        k, j, i = np.moveaxis(np.where(within[..., np.newaxis], index, 0), -1, 0)
        held: NDArray[np.bool_] = within & _among((k * self.shape[1] + j) * self.shape[2] + i, self.held)
        return held

    def clearance(self, trajectory: Trajectory, *, rough: bool = False) -> Clearance | None:
        """Return the least distance of the path to the obstacle; None when the obstacle is empty.

        ``rough``: of a label too only to its voxels, which is quicker.
        """
        if len(self.low_mm) == 0:
            return None
        near = self._to_voxels(trajectory, slice(None))
        for end, place in ((0.0, trajectory.entry_mm), (1.0, trajectory.target_mm)):
            if self.holds(place):
                near = _Near(0.0, 0.0, end)
        if self.kind is Kind.NO_GO and near.distance_mm > 0.0 and not rough:
            near = self._to_surface(trajectory)
        radius = trajectory.instrument.radius_mm
        return Clearance(
            self.kind,
            self.name,
            near.distance_mm,
            near.distance_mm - radius,
            near.share * trajectory.length_mm,
            near.at_least_mm - radius,
            near.smooth,
        )

    def _to_voxels(self, trajectory: Trajectory, which: slice | NDArray[np.intp]) -> _Near:
        """Return how near some of the voxels come.

        A label's voxel only says that the next center is outside, so its wall may reach to there: twice its size.
        """
        start, stop = self.axes @ trajectory.entry_mm, self.axes @ trajectory.target_mm
        low, high = self.low_mm[which], self.high_mm[which]
        distance, share = box_distance(start, stop, low, high)
        if self.kind is not Kind.NO_GO:
            return _Near(distance, distance, share)
        half = (high - low) / 2
        return _Near(distance, box_distance(start, stop, low - half, high + half)[0], share)

    def _to_surface(self, trajectory: Trajectory) -> _Near:
        """Return how near the smooth surface comes, piece by piece; where there is none, the voxels."""
        apart = point_distances(self.centers_mm, trajectory.entry_mm, trajectory.target_mm)
        sizes = (self.high_mm - self.low_mm).max(axis=1)
        nearest, sure = _Near(np.inf, np.inf, 0.0), np.inf
        left = np.argsort(apart, kind="stable")
        left = left[apart[left] <= (apart + sizes).min()]
        while len(left) and apart[left[0]] - sizes[left[0]] < sure:
            patch = self._patch(int(left[0]))
            radius = patch.reach_mm if patch else 2.0 * sizes[left[0]]
            here = np.linalg.norm(self.centers_mm[left] - self.centers_mm[left[0]], axis=1) <= radius
            known = patch.nearest(trajectory.entry_mm, trajectory.target_mm) if patch else None
            one = _Near(*known, smooth=True) if known else self._to_voxels(trajectory, left[here])
            nearest, sure = min(nearest, one, key=lambda near: near.distance_mm), min(sure, one.at_least_mm)
            left = left[~here]
        return replace(nearest, at_least_mm=sure)

    def _patch(self, number: int) -> Patch | None:
        if number not in self.patches:
            self.patches[number] = fit_patch(self.has, self.grid, self.shape, self.kji[number])
        return self.patches[number]


@dataclass(frozen=True)
class _Near:
    """How near a path comes, and at which share of it."""

    distance_mm: float
    at_least_mm: float
    share: float
    smooth: bool = False


@dataclass(frozen=True, eq=False)
class PostedMarker:
    """A sphere at ``center_mm`` (3,) on a post that reaches to ``foot_mm`` (3,) on the head."""

    name: str
    center_mm: FloatArray
    foot_mm: FloatArray
    diameter_mm: float

    def clearance(self, trajectory: Trajectory, *, rough: bool = False) -> Clearance:
        """Return the least distance of the whole instrument, outside the head too, to the sphere and its post."""
        tail = (
            trajectory.target_mm - max(trajectory.instrument.length_mm, trajectory.length_mm) * trajectory.inward
        )
        sphere = float(point_distances(self.center_mm, tail, trajectory.target_mm)) - self.diameter_mm / 2
        axis, _ = segment_distances(tail, trajectory.target_mm, self.center_mm, self.foot_mm)
        distance = max(min(sphere, float(axis) - POST_RADIUS_MM), 0.0)
        _, share = segment_distances(trajectory.entry_mm, trajectory.target_mm, self.center_mm, self.foot_mm)
        clearance = distance - trajectory.instrument.radius_mm
        depth = float(share) * trajectory.length_mm
        return Clearance(Kind.MARKER, self.name, distance, clearance, depth, clearance)


Obstacle = Voxels | PostedMarker


def metal(head: Head) -> Voxels:
    """Return all voxels of the scan at or above `METAL_HU`."""
    planes = head.volume.voxels_hu  # one at a time: a mask of the whole scan would take half its memory
    held = [np.flatnonzero(plane >= METAL_HU) + k * plane.size for k, plane in enumerate(planes)]
    return Voxels.at(Kind.METAL, "metal", np.concatenate(held), head)


def markers_on(
    head: Head, names: tuple[str, ...], centers_mm: FloatArray, diameter_mm: float
) -> list[PostedMarker]:
    """Return markers at ``centers_mm`` (N, 3), each with a post to the nearest place of the head."""
    boundary = head.boundary_mm
    nearest = [boundary[((boundary - center) ** 2).sum(axis=1).argmin()] for center in centers_mm]
    return [
        PostedMarker(name, center, foot, diameter_mm)
        for name, center, foot in zip(names, centers_mm, nearest, strict=True)
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
