"""What lies on, around or in a marker when it is scanned. LPS mm.

All of it is embedded and listed before post and ball, which replace it; only a bubble comes after the ball.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from phantoms.anatomy import Foot
from phantoms.errors import PhantomError
from phantoms.scene import Part
from phantoms.solids import FloatArray, box, cylinder, frame_along, sphere

COATING_MM = 0.2
"""Thickness of a retro-reflective coat of glass beads in their binder."""
FILM_MM, THIN_FILM_MM, THICK_FILM_MM, FOIL_MM = 0.5, 0.2, 1.0, 0.05
"""A film's thickness where it is thickest; opposite it has none."""
TAPE_MM, THIN_TAPE_MM, TAPE_WIDTH_MM = 0.2, 0.05, 12.0
DRAPE_MM, DRAPE_WIDTH_MM = 0.3, 16.0
"""Polyester tape and polyethylene sheet."""
CLOTH_MM, GAUZE_MM, GEL_MM = 1.5, 4.0, 2.0
"""Thickness of what is wrapped around a ball, on average."""
UNEVEN = 0.15
"""Part of its thickness by which cloth or gauze lies off the ball's center."""
LOCKS, LOCK_MM = 6, 0.8
"""Hairs lie in locks: how many touch a marker, and how thick each is."""


@dataclass(frozen=True)
class Covered:
    """The marker below a covering: where it stands, its ball, and what draws the covering's chances."""

    foot: Foot
    center_mm: FloatArray
    diameter_mm: float
    generator: np.random.Generator

    def direction(self, least_rise: float) -> FloatArray:
        """Draw a direction from the ball's center with at least this cosine to the outward normal."""
        rise = self.generator.uniform(least_rise, 1.0)
        angle = self.generator.uniform(0, 2 * np.pi)
        flat = np.sqrt(1 - rise**2) * np.array([np.cos(angle), np.sin(angle)])
        turned: FloatArray = frame_along(self.foot.outward) @ np.array([*flat, rise])
        return turned


@dataclass(frozen=True)
class Covering:
    """How a covering is drawn, and by how much it lifts a ball off the skin."""

    parts: Callable[[Covered], list[Part]]
    lift_mm: float = 0.0


def covering(name: str) -> Covering:
    """Return the covering called ``name``; raises `PhantomError` with the known names."""
    known = COVERINGS | OTHERS
    if name not in known:
        raise PhantomError(f"unknown covering {name!r}; expected one of {', '.join(known)}")
    return known[name]


def bubble(under: Covered) -> Part:
    """Return an air bubble, as moulding leaves it: a tenth to a fifth of the ball's diameter, anywhere inside."""
    size = under.diameter_mm * under.generator.uniform(0.1, 0.2)
    depth = under.generator.uniform(0.0, 0.8) * (under.diameter_mm - size) / 2
    return Part(sphere(under.center_mm + depth * under.direction(-1.0), size), "air", "bubble", embedded=True)


def _film(thickness_mm: float) -> Callable[[Covered], list[Part]]:
    """Make a film whose thickness falls to nothing: a larger ball that touches the marker from inside."""

    def make(under: Covered) -> list[Part]:
        center = under.center_mm + thickness_mm / 2 * under.direction(0.0)
        return [Part(sphere(center, under.diameter_mm + thickness_mm), "polyester", "film", embedded=True)]

    return make


def _around(material: str, thickness_mm: float, uneven: float = 0.0) -> Callable[[Covered], list[Part]]:
    def make(under: Covered) -> list[Part]:
        center = under.center_mm + uneven * thickness_mm * under.direction(-1.0)
        return [Part(sphere(center, under.diameter_mm + 2 * thickness_mm), material, material, embedded=True)]

    return make


def _strip(under: Covered, across: FloatArray, width_mm: float, thickness_mm: float, material: str) -> list[Part]:
    """A strip that runs over the top of the ball and tent-like down to the skin on both sides."""
    up, radius = under.foot.outward, under.diameter_mm / 2
    along = np.cross(across, up)
    height = float((under.center_mm - under.foot.place_mm) @ up)
    parts = []
    for angle, start, stop in (
        (0.0, -radius * np.tan(np.pi / 6), radius * np.tan(np.pi / 6)),
        (np.pi / 3, -radius * np.tan(np.pi / 6), (height + radius / 2) / np.sin(np.pi / 3)),
        (-np.pi / 3, -(height + radius / 2) / np.sin(np.pi / 3), radius * np.tan(np.pi / 6)),
    ):
        normal = np.cos(angle) * up + np.sin(angle) * along
        way = np.cos(angle) * along - np.sin(angle) * up
        middle = under.center_mm + (radius + thickness_mm / 2) * normal + (start + stop) / 2 * way
        solid = box(middle, (stop - start, width_mm, thickness_mm), np.column_stack([way, across, normal]))
        parts.append(Part(solid, material, f"{material} strip", embedded=True))
    return parts


def _across(under: Covered) -> FloatArray:
    frame = frame_along(under.foot.outward)
    angle = under.generator.uniform(0, np.pi)
    across: FloatArray = np.cos(angle) * frame[:, 0] + np.sin(angle) * frame[:, 1]
    return across


def _tape(thickness_mm: float) -> Callable[[Covered], list[Part]]:
    return lambda under: _strip(under, _across(under), TAPE_WIDTH_MM, thickness_mm, "polyester")


def _drape(under: Covered) -> list[Part]:
    across = _across(under)
    ways = (across, np.cross(under.foot.outward, across))
    return [part for way in ways for part in _strip(under, way, DRAPE_WIDTH_MM, DRAPE_MM, "polyethylene")]


def _hair(under: Covered) -> list[Part]:
    """Locks that touch the upper half of the ball, straight and in any direction."""
    parts = []
    for _ in range(LOCKS):
        contact = under.direction(0.2)
        way = np.cross(contact, under.direction(-1.0))
        way /= np.linalg.norm(way)
        middle = under.center_mm + (under.diameter_mm + LOCK_MM) / 2 * contact
        start = middle - 0.7 * under.diameter_mm * way
        solid = cylinder(start, way, 1.4 * under.diameter_mm, LOCK_MM)
        parts.append(Part(solid, "hair", "lock of hair", embedded=True))
    return parts


COVERINGS = {
    "film": Covering(_film(FILM_MM), lift_mm=FILM_MM),
    "tape": Covering(_tape(TAPE_MM)),
    "drape": Covering(_drape),
    "hair": Covering(_hair),
    "cloth": Covering(_around("cloth", CLOTH_MM, UNEVEN), lift_mm=CLOTH_MM * (1 + UNEVEN)),
    "gauze": Covering(_around("gauze", GAUZE_MM, UNEVEN), lift_mm=GAUZE_MM * (1 + UNEVEN)),
    "gel": Covering(_around("gel", GEL_MM), lift_mm=GEL_MM),
}
"""What may cover a marker, by name."""

OTHERS = {
    "foil": Covering(_film(FOIL_MM), lift_mm=FOIL_MM),
    "thin film": Covering(_film(THIN_FILM_MM), lift_mm=THIN_FILM_MM),
    "thick film": Covering(_film(THICK_FILM_MM), lift_mm=THICK_FILM_MM),
    "thin tape": Covering(_tape(THIN_TAPE_MM)),
}
"""Films and tapes of other thickness: they only come where they are asked for by name."""
