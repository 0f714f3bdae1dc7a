"""Markers of every kind, and decoys: what could be taken for a marker and must not be. LPS mm."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from phantoms.anatomy import Foot
from phantoms.errors import PhantomError
from phantoms.scene import Decoy, Marker, Part, Scene
from phantoms.solids import FloatArray, Solid, box, cone, cylinder, ellipsoid, sphere

POST_MM = 8.0
"""Distance from the scalp to the lowest point of a sphere on a post."""
FRAME_ARMS = ((24.0, 33.0), (136.0, 58.0), (205.0, 58.0), (329.0, 57.0))
"""Angle (degrees) and length (mm) of the x-shaped frame's arms; the six distances differ by more than 10 mm."""


@dataclass(frozen=True)
class MarkerKind:
    """A sphere on a post or, without ``post``, one that touches the skin."""

    diameter_mm: float
    material: str
    post: bool = False
    insert: bool = False
    """Whether a threaded metal sleeve sits in the lower half of the sphere."""
    screw: str = "titanium"
    """Material of the bone screw below the post."""


KINDS = {
    "post": MarkerKind(11.5, "acrylic", post=True),
    "post with insert": MarkerKind(11.5, "acrylic", post=True, insert=True),
    "plastic screw post": MarkerKind(11.5, "acrylic", post=True, screw="nylon"),
    "ceramic": MarkerKind(10.0, "ceramic"),
    "steel": MarkerKind(5.0, "steel"),
    "titanium 3": MarkerKind(3.0, "titanium"),
    "titanium 4": MarkerKind(4.0, "titanium"),
}
"""The marker kinds by name: the retro-reflective sphere on a screw, and balls glued to the skin."""


def marker_kind(name: str) -> MarkerKind:
    """Return the kind called ``name``; raises `PhantomError` with the known names."""
    if name not in KINDS:
        raise PhantomError(f"unknown marker kind {name!r}; expected one of {', '.join(KINDS)}")
    return KINDS[name]


def marker(label: str, foot: Foot, kind: str | MarkerKind = "post") -> Scene:
    """Return one marker standing on ``foot``."""
    if isinstance(kind, str):
        kind = marker_kind(kind)
    center = foot.above(_height(kind) + kind.diameter_mm / 2)
    ball = Part(sphere(center, kind.diameter_mm), kind.material, f"marker {label}")
    parts = [*_post(foot, kind), ball]
    if kind.insert:
        parts.append(_along(foot, POST_MM + 0.5, 5.0, 3.0, "titanium", "metal insert"))
    return Scene(tuple(parts), (Marker(label, center, kind.diameter_mm, kind.material),))


def _height(kind: MarkerKind) -> float:
    return POST_MM if kind.post else 0.1


def _along(foot: Foot, start: float, length: float, diameter: float, material: str, name: str) -> Part:
    """Return a cylinder that stands on ``foot`` from the height ``start``."""
    return Part(cylinder(foot.above(start), foot.outward, length, diameter), material, name, embedded=True)


def _post(foot: Foot, kind: MarkerKind) -> list[Part]:
    """Return the self-drilling screw, the base and the neck below a sphere; nothing without a post."""
    if not kind.post:
        return []
    return [
        Part(cone(foot.above(-8), -foot.outward, 4, 2.0), kind.screw, "screw tip", embedded=True),
        _along(foot, 0, 4, 10.0, kind.material, "base"),
        _along(foot, 4, POST_MM - 2.5, 4.0, kind.material, "neck"),
        _along(foot, -8, 10, 2.0, kind.screw, "bone screw"),
        _along(foot, -1, 4, 4.0, kind.screw, "screw head"),
    ]


def x_frame(foot: Foot, prefix: str = "X", kind: str = "post") -> Scene:
    """Return the bone-implanted x-shaped frame: four spheres at unique distances, on two bars and one screw."""
    known = marker_kind(kind)
    side = np.cross(foot.outward, [0.0, 1.0, 0.2])
    side /= np.linalg.norm(side)
    ahead = np.cross(foot.outward, side)
    parts = [
        _along(foot, -11, 26, 3.0, "titanium", "frame screw"),
        _along(foot, 0, 16, 12.0, "PEEK", "frame column"),
    ]
    markers = []
    for number, (angle_deg, length) in enumerate(FRAME_ARMS, start=1):
        angle = np.radians(angle_deg)
        arm = np.cos(angle) * side + np.sin(angle) * ahead
        turn = np.column_stack([arm, np.cross(foot.outward, arm), foot.outward])
        bar = box(foot.above(18) + arm * (length + 6) / 2, (length + 6, 9, 5), turn)
        center = foot.above(20.5 + 5 + known.diameter_mm / 2) + arm * length
        neck = cylinder(foot.above(20) + arm * length, foot.outward, 7, 4.0)
        label = f"{prefix}{number}"
        parts += [Part(bar, "PEEK", "frame arm", embedded=True), Part(neck, known.material, "neck", embedded=True)]
        parts.append(Part(sphere(center, known.diameter_mm), known.material, f"marker {label}"))
        markers.append(Marker(label, center, known.diameter_mm, known.material))
    return Scene(tuple(parts), tuple(markers))


def decoy(name: str, foot: Foot, kind: str | MarkerKind = "post") -> Scene:
    """Return the decoy called ``name`` (a key of `DECOYS`), made like a marker of ``kind``."""
    if name not in DECOYS:
        raise PhantomError(f"unknown decoy {name!r}; expected one of {', '.join(DECOYS)}")
    if isinstance(kind, str):
        kind = marker_kind(kind)
    center = foot.above(_height(kind) + kind.diameter_mm / 2)
    parts = DECOYS[name](foot, center, kind)
    return Scene(tuple(parts), (), (Decoy(name, parts[-1].solid.center_mm),))


DecoyMaker = Callable[[Foot, FloatArray, MarkerKind], list[Part]]


def _on_post(foot: Foot, kind: MarkerKind, name: str, *solids: Solid) -> list[Part]:
    return [*_post(foot, kind), *(Part(solid, kind.material, name) for solid in solids)]


def _other_sphere(factor: float) -> DecoyMaker:
    def make(foot: Foot, center: FloatArray, kind: MarkerKind) -> list[Part]:
        size = factor * kind.diameter_mm
        return _on_post(foot, kind, "other sphere", sphere(foot.above(_height(kind) + size / 2), size))

    return make


def _cylinder(foot: Foot, center: FloatArray, kind: MarkerKind) -> list[Part]:
    start = foot.above(_height(kind))
    return _on_post(
        foot, kind, "cylinder", cylinder(start, foot.outward, 1.4 * kind.diameter_mm, kind.diameter_mm)
    )


def _ellipsoid(foot: Foot, center: FloatArray, kind: MarkerKind) -> list[Part]:
    semi_axes = kind.diameter_mm / 2 * np.array([0.8, 1.0, 1.35])
    place = foot.above(_height(kind) + semi_axes.max())
    return _on_post(foot, kind, "ellipsoid", ellipsoid(place, semi_axes))


def _capsule(foot: Foot, center: FloatArray, kind: MarkerKind) -> list[Part]:
    length = 0.7 * kind.diameter_mm
    ends = [sphere(center + rise * foot.outward, kind.diameter_mm) for rise in (0.0, length)]
    return _on_post(foot, kind, "capsule", *ends, cylinder(center, foot.outward, length, kind.diameter_mm))


def _screw(foot: Foot, center: FloatArray, kind: MarkerKind) -> list[Part]:
    return [
        _along(foot, -11, 17, 2.0, "titanium", "bare screw"),
        _along(foot, 6, 3, 5.0, "titanium", "bare screw head"),
    ]


def _cone(foot: Foot, center: FloatArray, kind: MarkerKind) -> list[Part]:
    solid = cone(foot.above(_height(kind)), foot.outward, 1.5 * kind.diameter_mm, kind.diameter_mm)
    return _on_post(foot, kind, "cone", solid)


def _box(foot: Foot, center: FloatArray, kind: MarkerKind) -> list[Part]:
    place = foot.above(_height(kind) + 0.9 * kind.diameter_mm)
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
