"""The surfaces of the head along one path, measured: scalp, outer and inner table."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ronnaplan.geometry import FloatArray
from ronnaplan.planning.head import Head
from ronnaplan.planning.layers import Way, way_out
from ronnaplan.planning.surface import Surface, fit_crossing

SCALP_LIMITS_HU = (-1024.0, 120.0)
"""Bone below thin skin counts as skin."""

BONE_LIMITS_HU = (-150.0, 2500.0)
"""Air above thin skin counts as fat; metal as dense bone."""

LAYER_SHARE = 0.5
"""Share of the layers beside a surface that is fitted with it: the rest belongs to their far sides."""

MOST_KEPT = 1000
"""Rays whose crossings are kept: those of a large plan, and an end's way while it is dragged for a minute or two."""


@dataclass(frozen=True, eq=False)
class Crossings:
    """What a ray from inside the head meets on its way out; a surface that is not there is None.

    ``way`` tells how the search ended; only an `Way.OPEN` one has surfaces to rely on.
    """

    way: Way
    scalp: Surface | None = None
    outer: Surface | None = None
    inner: Surface | None = None


def find_crossings(head: Head, start_mm: FloatArray, outward: FloatArray) -> Crossings:
    """Measure the surfaces along the ray from ``start_mm`` (3,), in the head, along unit ``outward`` (3,)."""
    ray = (*start_mm.tolist(), *outward.tolist())
    known: Crossings | None = head.met.get(ray)
    if known is None:
        known = head.met[ray] = _crossings(head, start_mm, outward)
        if len(head.met) > MOST_KEPT:
            head.met.popitem(last=False)
    return known


def _crossings(head: Head, start_mm: FloatArray, outward: FloatArray) -> Crossings:
    way, scalp, outer, inner = way_out(head.scan, head.inside, head.cell, start_mm, outward)
    if way is not Way.OPEN:
        return Crossings(way)

    def fitted(
        reach: float, limits: tuple[float, float], *neighbours: float, last: bool = False
    ) -> Surface | None:
        if not np.isfinite(reach):
            return None
        gaps = [abs(reach - other) * LAYER_SHARE for other in neighbours if np.isfinite(other)]
        return fit_crossing(
            head.volume,
            start_mm,
            outward,
            reach,
            limits_hu=limits,
            brighter_outside=last,
            half_depth_mm=min(gaps, default=np.inf),
        )

    return Crossings(
        way,
        fitted(scalp, SCALP_LIMITS_HU, outer),
        fitted(outer, BONE_LIMITS_HU, scalp, inner),
        fitted(inner, BONE_LIMITS_HU, outer, last=True),
    )
