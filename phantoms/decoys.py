"""Decoys: what could be taken for a marker and must not be. LPS mm."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from phantoms.anatomy import Foot
from phantoms.errors import PhantomError
from phantoms.markers import MarkerKind, enters_neck, marker_kind, post_parts, stand_mm, upright
from phantoms.scene import Decoy, Part, Scene
from phantoms.solids import FloatArray, Solid, box, cone, cylinder, ellipsoid, sphere


def decoy(name: str, foot: Foot, kind: str | MarkerKind = "post") -> Scene:
    """Return the decoy called ``name`` (a key of `DECOYS`), made like a marker of ``kind``."""
    if name not in DECOYS:
        raise PhantomError(f"unknown decoy {name!r}; expected one of {', '.join(DECOYS)}")
    if isinstance(kind, str):
        kind = marker_kind(kind)
    center = foot.above(stand_mm(kind) + kind.diameter_mm / 2)
    parts = DECOYS[name](foot, center, kind)
    return Scene(tuple(parts), (), (Decoy(name, parts[-1].solid.center_mm),))


DecoyMaker = Callable[[Foot, FloatArray, MarkerKind], list[Part]]


def _on_post(foot: Foot, kind: MarkerKind, name: str, *solids: Solid) -> list[Part]:
    embedded = enters_neck(kind)
    return [*post_parts(foot, kind), *(Part(solid, kind.material, name, embedded) for solid in solids)]


def _other_sphere(factor: float) -> DecoyMaker:
    def make(foot: Foot, center: FloatArray, kind: MarkerKind) -> list[Part]:
        size = factor * kind.diameter_mm
        return _on_post(foot, kind, "other sphere", sphere(foot.above(stand_mm(kind) + size / 2), size))

    return make


def _cylinder(foot: Foot, center: FloatArray, kind: MarkerKind) -> list[Part]:
    start = foot.above(stand_mm(kind))
    return _on_post(
        foot, kind, "cylinder", cylinder(start, foot.outward, 1.4 * kind.diameter_mm, kind.diameter_mm)
    )


def _ellipsoid(foot: Foot, center: FloatArray, kind: MarkerKind) -> list[Part]:
    semi_axes = kind.diameter_mm / 2 * np.array([0.8, 1.0, 1.35])
    place = foot.above(stand_mm(kind) + semi_axes.max())
    return _on_post(foot, kind, "ellipsoid", ellipsoid(place, semi_axes))


def _capsule(foot: Foot, center: FloatArray, kind: MarkerKind) -> list[Part]:
    length = 0.7 * kind.diameter_mm
    ends = [sphere(center + rise * foot.outward, kind.diameter_mm) for rise in (0.0, length)]
    return _on_post(foot, kind, "capsule", *ends, cylinder(center, foot.outward, length, kind.diameter_mm))


def _screw(foot: Foot, center: FloatArray, kind: MarkerKind) -> list[Part]:
    return [
        upright(foot, -11, 17, 2.0, "titanium", "bare screw"),
        upright(foot, 6, 3, 5.0, "titanium", "bare screw head"),
    ]


def _cone(foot: Foot, center: FloatArray, kind: MarkerKind) -> list[Part]:
    solid = cone(foot.above(stand_mm(kind)), foot.outward, 1.5 * kind.diameter_mm, kind.diameter_mm)
    return _on_post(foot, kind, "cone", solid)


def _box(foot: Foot, center: FloatArray, kind: MarkerKind) -> list[Part]:
    place = foot.above(stand_mm(kind) + 0.9 * kind.diameter_mm)
    return _on_post(foot, kind, "box", box(place, (kind.diameter_mm,) * 3))


def _bubble(foot: Foot, center: FloatArray, kind: MarkerKind) -> list[Part]:
    return [Part(sphere(foot.above(-32), kind.diameter_mm), "air", "gas bubble", embedded=True)]


DECOYS: dict[str, DecoyMaker] = {
    "larger sphere": _other_sphere(1.45),
    "smaller sphere": _other_sphere(0.7),
    "cylinder": _cylinder,
    "ellipsoid": _ellipsoid,
    "capsule": _capsule,
    "bare screw": _screw,
    "cone": _cone,
    "box": _box,
    "gas bubble": _bubble,
}
"""Makers of decoys by name."""
