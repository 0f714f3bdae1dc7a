"""Places on the scalp where a marker may stand, and which of them the rules leave open."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ronnaplan.errors import InputError, RefusedError, check_type
from ronnaplan.geometry import FloatArray, as_points, unit
from ronnaplan.planning.candidates import Field, cast, spread_directions
from ronnaplan.planning.head import SKIN_HU, Head
from ronnaplan.planning.layers import Way
from ronnaplan.planning.lengths import (
    BASE_MM,
    LEAST_APART_MM,
    LEAST_FROM_ENTRIES_MM,
    USUAL_DIAMETER_MM,
    VISIBLE_DEG,
)
from ronnaplan.sigmas import SIGMA_CT_MM, SIGMA_OTS_MM

SITES = 4_000
"""Directions from the head's center that are looked at; those that reach the scalp become sites, 6 mm apart."""

FREE_ABOVE_MM = (4.0, 22.0, 2.0)
"""Heights over the scalp (from, to, step) at which there must be air: there the marker will be."""

NEIGHBOURS = 12
"""The slope of the scalp at a site is that of the plane through so many sites about it."""

MOST_TURNS = 100
"""Times the lattice of `even_layout` is turned before it is given up."""


@dataclass(frozen=True, eq=False)
class Sites:
    """Places where a marker may stand: on the scalp (S, 3), with the outward normals (S, 3), LPS mm.

    ``inside_mm`` (3,) is a place about the middle of the head.
    """

    scalp_mm: FloatArray
    normals: FloatArray
    inside_mm: FloatArray

    def __len__(self) -> int:
        return len(self.scalp_mm)

    def centers_mm(self, height_mm: float) -> FloatArray:
        """Return where the markers' centers would be (S, 3)."""
        return self.scalp_mm + height_mm * self.normals

    def chosen(self, keep: NDArray[np.bool_] | NDArray[np.int64]) -> Sites:
        """Return some of the sites: ``keep`` (S,) says of each whether, or (N,) which."""
        return Sites(self.scalp_mm[keep], self.normals[keep], self.inside_mm)


@dataclass(frozen=True, kw_only=True)
class PlacementRules:
    """What a layout must keep.

    ``sigma_ct_mm`` and ``sigma_ots_mm`` are standard deviations per axis of a marker in the scan and of its reading;
    ``base_mm`` is the height of a marker's base above the scalp. Markers keep ``least_apart_mm`` from each other and
    ``least_from_entries_mm`` from the entries; none stands below ``lowest_mm`` (LPS z; None: anywhere). The tracker
    stands in direction ``tracker`` (3,), LPS, seen from the head; a marker is visible when its normal leans away from
    that by at most ``visible_deg``. None: seen from anywhere.
    """

    sigma_ct_mm: float = SIGMA_CT_MM
    sigma_ots_mm: float = SIGMA_OTS_MM
    diameter_mm: float = USUAL_DIAMETER_MM
    base_mm: float = BASE_MM
    least_apart_mm: float = LEAST_APART_MM
    least_from_entries_mm: float = LEAST_FROM_ENTRIES_MM
    tracker: tuple[float, float, float] | None = None
    visible_deg: float = VISIBLE_DEG
    lowest_mm: float | None = None

    @property
    def height_mm(self) -> float:
        """Height of a marker's middle above the scalp."""
        return self.base_mm + self.diameter_mm / 2

    @property
    def sigma_mm(self) -> float:
        """Standard deviation per axis of a pair's difference."""
        return float(np.hypot(self.sigma_ct_mm, self.sigma_ots_mm))


def scalp_sites(head: Head, count: int = SITES) -> Sites:
    """Return places spread over the scalp of ``head``, with normals: those of ``count`` directions that show it.

    Those on attached things, or with something over them (a headrest, a tube), are left out. Raises `InputError` where
    too few are left to tell normals.
    """
    check_type(head, Head, "the head", "Head.of(volume) returns one")
    center = head.center_mm
    found = cast(head, center, spread_directions(count), Field.of([], head))
    sites = surface_sites(found.entries_mm[found.way == Way.OPEN], center)
    over = sites.scalp_mm[:, np.newaxis] + np.arange(*FREE_ABOVE_MM)[:, np.newaxis] * sites.normals[:, np.newaxis]
    values = head.scan.values_hu(over.reshape(-1, 3)).reshape(over.shape[:2])
    return sites.chosen(np.asarray((~(values >= SKIN_HU)).all(axis=1)))


def surface_sites(points_mm: ArrayLike, inside_mm: ArrayLike) -> Sites:
    """Return the points (S, 3) of any surface of a head about ``inside_mm`` (3,) as sites."""
    points, inside = as_points(points_mm, "surface points"), np.asarray(inside_mm, dtype=np.float64)
    return Sites(points, surface_normals(points, inside), inside)


def surface_normals(points_mm: FloatArray, inside_mm: FloatArray) -> FloatArray:
    """Return outward unit normals (S, 3) of a surface given by points (S, 3) about ``inside_mm`` (3,)."""
    from scipy.spatial import cKDTree

    if len(points_mm) < NEIGHBOURS:
        raise InputError(f"a surface of {len(points_mm)} points was given; expected {NEIGHBOURS} or more")
    near = points_mm[np.asarray(cKDTree(points_mm).query(points_mm, k=NEIGHBOURS)[1])]
    offsets = near - near.mean(axis=1, keepdims=True)
    normals: FloatArray = np.linalg.eigh(offsets.swapaxes(1, 2) @ offsets)[1][:, :, 0]
    outward = ((points_mm - inside_mm) * normals).sum(axis=1, keepdims=True)
    return np.where(outward < 0, -normals, normals)


def allowed_sites(sites: Sites, rules: PlacementRules, entries_mm: ArrayLike = ()) -> Sites:
    """Return the sites that are far enough from the entries (E, 3), visible to the tracker, and high enough."""
    keep = np.ones(len(sites), dtype=np.bool_)
    for entry in as_points(entries_mm, "entries"):
        keep &= np.linalg.norm(sites.scalp_mm - entry, axis=1) >= rules.least_from_entries_mm
    if rules.tracker is not None:
        keep &= sites.normals @ unit(rules.tracker) >= np.cos(np.radians(rules.visible_deg))
    if rules.lowest_mm is not None:
        keep &= sites.scalp_mm[:, 2] >= rules.lowest_mm
    return sites.chosen(keep)


def even_layout(sites: Sites, count: int, generator: np.random.Generator) -> NDArray[np.int64]:
    """Return (``count``,) sites spread evenly: a Fibonacci lattice, randomly turned, so dense that so many fit.

    What a careful person does who does not think of the target; the measure for `place_markers`.
    """
    from scipy.spatial import cKDTree
    from scipy.spatial.transform import Rotation

    directions = sites.scalp_mm - sites.inside_mm
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    tree = cKDTree(directions)
    near = 0.75 * float(np.median(np.asarray(tree.query(directions, k=2)[0])[:, 1]))
    for _ in range(MOST_TURNS):
        turn = Rotation.random(rng=generator).as_matrix()
        for total in range(count, 60 * count):
            distance, site = (np.asarray(found) for found in tree.query(spread_directions(total) @ turn.T))
            if (distance < near).sum() == count:
                return site[distance < near].astype(np.int64)
    raise RefusedError(f"{count} markers cannot be spread over {len(sites)} places; allow more of the scalp")
