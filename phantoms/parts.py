"""Ready-made parts of scenes: a head, markers, and what could be taken for markers. LPS mm throughout."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from phantoms.scene import Decoy, Marker, Part, Scene
from phantoms.solids import FloatArray, Solid, Vector, box, cone, cylinder, ellipsoid, sphere

SCALP_SEMI_AXES_MM = (76.0, 96.0, 92.0)
"""Half width, half length and height of the head of a large adult."""


@dataclass(frozen=True)
class Foot:
    """A place on a surface with the outward unit normal there."""

    place_mm: FloatArray
    outward: FloatArray

    def above(self, height_mm: float, aside_mm: float = 0.0) -> FloatArray:
        """Return the point ``height_mm`` over the surface, moved ``aside_mm`` along it."""
        across = np.cross(self.outward, [0.3, 0.5, 0.8])
        return self.place_mm + height_mm * self.outward + aside_mm * across / np.linalg.norm(across)


def scalp_foot(direction: Vector, size: float = 1.0) -> Foot:
    """Return where a ray from the head's centre along ``direction`` leaves the scalp of `head`."""
    axes = np.asarray(SCALP_SEMI_AXES_MM) * size
    ray = np.asarray(direction, dtype=np.float64)
    place = ray / np.linalg.norm(ray / axes)
    outward = place / axes**2
    return Foot(place, outward / np.linalg.norm(outward))


def head(size: float = 1.0, *, teeth: bool = True) -> Scene:
    """Return a head of skin, skull, brain, ventricles, air sinuses, petrous bones, neck and teeth.

    Its centre is the origin; it looks along -y (anterior) and stands along +z (superior).
    """
    scalp = np.asarray(SCALP_SEMI_AXES_MM) * size
    anatomy: list[tuple[str, str, Solid]] = [
        ("neck", "skin", cylinder(size * np.array([0, 18, -50]), (0, 0.1, -1), 120 * size, 112 * size)),
        ("face", "skin", ellipsoid(size * np.array([0, -40, -66]), size * np.array([56, 52, 58]))),
        ("scalp", "skin", ellipsoid((0, 0, 0), scalp)),
        ("skull", "skull", ellipsoid((0, 0, 0), scalp - 6 * size)),
        ("brain", "brain", ellipsoid((0, size, -size), scalp - 13 * size)),
        ("spine", "skull", cylinder(size * np.array([0, 26, -66]), (0, 0.1, -1), 104 * size, 28 * size)),
        ("maxilla", "skull", ellipsoid(size * np.array([0, -54, -78]), size * np.array([34, 28, 14]))),
        ("nasal cavity", "air", ellipsoid(size * np.array([0, -62, -56]), size * np.array([11, 22, 16]))),
        ("frontal sinus", "air", ellipsoid(size * np.array([0, -81.5, 18]), size * np.array([12, 2.5, 7]))),
    ]
    for side in (-1, 1):
        anatomy += [
            ("ventricle", "cerebrospinal fluid", ellipsoid(size * np.array([side * 9, 0, 12]), (6, 30, 9))),
            ("petrous bone", "cortical bone", ellipsoid(size * np.array([side * 36, 14, -40]), (18, 9, 9))),
            ("maxillary sinus", "air", ellipsoid(size * np.array([side * 27, -54, -62]), (10, 13, 12))),
        ]
    parts = [Part(solid, name, title, embedded=True) for title, name, solid in anatomy]
    if teeth:
        parts += [Part(solid, "tooth", "tooth", embedded=True) for solid in _teeth(size)]
    return Scene(tuple(parts), name="head")


def _teeth(size: float) -> Iterable[Solid]:
    for angle in np.radians(np.linspace(-66, 66, 12)):
        place = size * np.array([26 * np.sin(angle), -46 - 30 * np.cos(angle), -94])
        yield cylinder(place, (0, 0, 1), 16 * size, 6.5 * size)


def marker_on_post(label: str, foot: Foot, *, diameter_mm: float = 11.5, insert: bool = False) -> Scene:
    """Return a plastic sphere on a base that is fixed by a titanium bone screw.

    With ``insert`` a threaded metal sleeve sits inside the sphere, off its centre.
    """
    center = foot.above(8.0 + diameter_mm / 2)
    parts = [
        Part(cylinder(foot.above(-11), foot.outward, 13, 2.0), "titanium", "bone screw", embedded=True),
        Part(cylinder(foot.above(0), foot.outward, 4, 10.0), "acrylic", "base", embedded=True),
        Part(cylinder(foot.above(4), foot.outward, 5.5, 4.0), "acrylic", "post", embedded=True),
        Part(sphere(center, diameter_mm), "acrylic", f"marker {label}", embedded=True),
        Part(cylinder(foot.above(-1), foot.outward, 4, 4.0), "titanium", "screw head", embedded=True),
    ]
    if insert:
        parts.append(Part(cylinder(foot.above(8.5), foot.outward, 5, 3.0), "titanium", "insert", embedded=True))
    return Scene(tuple(parts), (Marker(label, center, diameter_mm, "acrylic"),))


def ball_on_skin(label: str, foot: Foot, *, diameter_mm: float, material: str) -> Scene:
    """Return a bare ball (ceramic, steel, titanium) that touches the skin."""
    center = foot.above(diameter_mm / 2 + 0.1)
    return Scene(
        (Part(sphere(center, diameter_mm), material, f"marker {label}", embedded=True),),
        (Marker(label, center, diameter_mm, material),),
    )


def decoy(kind: str, foot: Foot, *, diameter_mm: float = 11.5) -> Scene:
    """Return a decoy of ``kind`` (a key of `DECOYS`) about as large as a marker of ``diameter_mm``."""
    center = foot.above(8.0 + diameter_mm / 2)
    return Scene(tuple(DECOYS[kind](foot, center, diameter_mm)), (), (Decoy(kind, center),))


def _post(foot: Foot) -> list[Part]:
    return [
        Part(cylinder(foot.above(0), foot.outward, 4, 10.0), "acrylic", "base", embedded=True),
        Part(cylinder(foot.above(4), foot.outward, 5.5, 4.0), "acrylic", "post", embedded=True),
    ]


def _large_sphere(foot: Foot, center: FloatArray, diameter_mm: float) -> list[Part]:
    size = 1.45 * diameter_mm
    return [*_post(foot), Part(sphere(foot.above(8 + size / 2), size), "acrylic", "larger sphere", embedded=True)]


def _small_sphere(foot: Foot, center: FloatArray, diameter_mm: float) -> list[Part]:
    size = 0.7 * diameter_mm
    return [*_post(foot), Part(sphere(foot.above(8 + size / 2), size), "acrylic", "smaller sphere", embedded=True)]


def _cylinder(foot: Foot, center: FloatArray, diameter_mm: float) -> list[Part]:
    solid = cylinder(foot.above(8), foot.outward, 1.4 * diameter_mm, diameter_mm)
    return [*_post(foot), Part(solid, "acrylic", "cylinder", embedded=True)]


def _ellipsoid(foot: Foot, center: FloatArray, diameter_mm: float) -> list[Part]:
    solid = ellipsoid(center, diameter_mm / 2 * np.array([0.8, 1.0, 1.3]))
    return [*_post(foot), Part(solid, "acrylic", "ellipsoid", embedded=True)]


def _capsule(foot: Foot, center: FloatArray, diameter_mm: float) -> list[Part]:
    far = center + 0.6 * diameter_mm * foot.outward
    barrel = cylinder(center, foot.outward, 0.6 * diameter_mm, diameter_mm)
    return [
        *_post(foot),
        *(Part(s, "acrylic", "capsule", embedded=True) for s in (barrel, sphere(center, diameter_mm))),
        Part(sphere(far, diameter_mm), "acrylic", "capsule", embedded=True),
    ]


def _screw(foot: Foot, center: FloatArray, diameter_mm: float) -> list[Part]:
    return [
        Part(cylinder(foot.above(-11), foot.outward, 17, 2.0), "titanium", "bare screw", embedded=True),
        Part(cylinder(foot.above(6), foot.outward, 3, 5.0), "titanium", "screw head", embedded=True),
    ]


def _cone(foot: Foot, center: FloatArray, diameter_mm: float) -> list[Part]:
    return [
        Part(cone(foot.above(0), foot.outward, 1.5 * diameter_mm, diameter_mm), "acrylic", "cone", embedded=True)
    ]


def _box(foot: Foot, center: FloatArray, diameter_mm: float) -> list[Part]:
    return [*_post(foot), Part(box(center, (diameter_mm,) * 3), "acrylic", "box", embedded=True)]


def _bubble(foot: Foot, center: FloatArray, diameter_mm: float) -> list[Part]:
    bubble = sphere(foot.place_mm - 30 * foot.outward, diameter_mm)
    return [Part(bubble, "air", "gas bubble", embedded=True)]


DECOYS = {
    "larger sphere": _large_sphere,
    "smaller sphere": _small_sphere,
    "cylinder": _cylinder,
    "ellipsoid": _ellipsoid,
    "capsule": _capsule,
    "bare screw": _screw,
    "cone": _cone,
    "box": _box,
    "gas bubble": _bubble,
}
"""Makers of decoys by name."""
