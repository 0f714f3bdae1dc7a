"""A head of more than ellipsoids: layered skull, air cells, eyes, jaws, ears with canals, calcifications. LPS mm."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from phantoms.anatomy import SCALP_SEMI_AXES_MM, TEETH, embedded, head, pair, tooth_place
from phantoms.scene import Decoy, Part, Scene
from phantoms.solids import FloatArray, Solid, Vector, cone, cylinder, ellipsoid, sphere

SCALP_MM, TABLE_MM, SKULL_MM = 6.0, 1.6, 7.0
"""Thickness of scalp, of each of the skull's two dense tables, and of the whole skull."""
VARIATION = 0.15
"""Size and place of what differs between people change by this part of the size."""
Generator = np.random.Generator


def lifelike_head(generator: Generator, size: float = 1.0) -> Scene:
    """Return `head` with what it lacks; its scalp, on which markers stand, is the same."""
    parts: list[Part] = []
    for part in head(size).parts:
        parts += _layers(part, size) if part.name == "skull" else [part]
    scene = _face(size) + Scene(tuple(parts)) + _jaws(size) + _eyes(size) + _ears(size)
    return replace(scene + _sinuses(generator, size) + _calcifications(generator, size), name="lifelike head")


def _layers(skull: Part, size: float) -> list[Part]:
    """Return the skull as outer table, diploe and inner table."""
    inner = np.asarray(SCALP_SEMI_AXES_MM) * size - SCALP_MM * size
    depths = (TABLE_MM * size, (SKULL_MM - TABLE_MM) * size)
    return [
        replace(skull, material="cortical bone"),
        Part(ellipsoid((0, 0, 0), inner - depths[0]), "diploe", "diploe", embedded=True),
        Part(ellipsoid((0, 0, 0), inner - depths[1]), "cortical bone", "inner table", embedded=True),
    ]


def _strut(start: Vector, end: Vector, diameter_mm: float) -> Solid:
    """Return a cylinder from one place to another."""
    way = np.asarray(end, dtype=np.float64) - np.asarray(start, dtype=np.float64)
    return cylinder(start, way, float(np.linalg.norm(way)), diameter_mm)


def _mirrored(x: float, y: float, z: float, size: float) -> list[FloatArray]:
    return [size * np.array([side * x, y, z]) for side in (-1, 1)]


def _face(size: float) -> Scene:
    """Return brow, nose, chin and the muscles of the neck."""
    return (
        embedded("skin", "brow", ellipsoid(size * np.array([0, -86, 2]), size * np.array([44, 14, 9])))
        + embedded(
            "skin", "nose", cone(size * np.array([0, -84, -52]), (0, -1, -0.3), 32 * size, 32 * size, 9 * size)
        )
        + embedded("skin", "chin", ellipsoid(size * np.array([0, -72, -112]), size * np.array([28, 24, 18])))
        + embedded("soft tissue", "nape", *pair((22, 62, -62), (26, 30, 44), size))
    )


def _jaws(size: float) -> Scene:
    """Return lower jaw and teeth, cheekbones and their arches."""
    body, ramus, arch = [], [], []
    for chin, angle, joint, cheek, temple in zip(
        _mirrored(8, -84, -114, size),
        _mirrored(48, -30, -106, size),
        _mirrored(54, -6, -46, size),
        _mirrored(42, -66, -46, size),
        _mirrored(66, -14, -42, size),
        strict=True,
    ):
        body.append(_strut(chin, angle, 13 * size))
        ramus.append(_strut(angle, joint, 9 * size))
        arch.append(_strut(cheek, temple, 5.5 * size))
    lower = [
        cylinder(tooth_place(number, size) + np.array([0, 2, -17]) * size, (0, 0, 1), 14 * size, 5.5 * size)
        for number in range(TEETH)
    ]
    return (
        embedded("cortical bone", "jaw", *body, *ramus)
        + embedded("cortical bone", "cheekbone", *arch)
        + embedded("tooth", "lower tooth", *lower)
    )


def _eyes(size: float) -> Scene:
    """Return orbits of fat with eyes; an eye is a ball and no marker."""
    places = _mirrored(31, -75, -32, size)
    eyes = [sphere(place, 24 * size) for place in places]
    nerves = [_strut(place, place * np.array([0.35, 0.35, 1.0]), 4 * size) for place in places]
    scene = (
        embedded("fat", "orbit", *pair((31, -66, -32), (18, 24, 17), size))
        + embedded("brain", "optic nerve", *nerves)
        + embedded("water", "eye", *eyes)
        + embedded("soft tissue", "lens", *pair((31, -84, -32), (4.6, 2.0, 4.6), size))
    )
    return scene + Scene((), (), tuple(Decoy("eye", place) for place in places))


def _ears(size: float) -> Scene:
    """Return ear canals, conchae and rims; the auricles themselves are part of `head`."""
    canals, rims = [], []
    for side in (-1, 1):
        canals.append(cylinder(size * np.array([side * 84, 12, -30]), (-side, 0.1, 0.1), 30 * size, 6 * size))
        for angle in np.radians(np.arange(-60, 241, 30)):
            middle = np.array([side * 82, 12 + 14 * np.cos(angle), -28 + 25 * np.sin(angle)])
            rims.append(sphere(size * middle, 6 * size))
    return (
        embedded("skin", "ear rim", *rims)
        + embedded("air", "concha", *pair((82, 12, -30), (4, 8, 12), size))
        + embedded("air", "ear canal", *canals)
    )


def _sinuses(generator: Generator, size: float) -> Scene:
    """Return lobes of the frontal sinus, ethmoid, sphenoid and mastoid cells, of sizes that are drawn."""

    def cells(name: str, center: Vector, spread: Vector, sizes_mm: tuple[float, float], count: int) -> Scene:
        places = np.asarray(center) + generator.uniform(-1, 1, (count, 3)) * np.asarray(spread)
        return embedded("air", name, *(sphere(size * p, size * generator.uniform(*sizes_mm)) for p in places))

    scene = Scene()
    for side in (-1, 1):
        scene += cells("mastoid cell", (side * 56, 22, -48), (6, 9, 10), (3.0, 6.5), 14)
        scene += cells("ethmoid cell", (side * 11, -58, -40), (4, 12, 6), (4.0, 7.0), 7)
        lobe = size * np.array([side * 9, -85.5, 12 + generator.uniform(-3, 6)])
        reach = size * np.array([9, 2.6, 8]) * (1 + VARIATION * generator.uniform(-1, 1, 3))
        scene += embedded("air", "frontal sinus", ellipsoid(lobe, reach))
        sphenoid = ellipsoid(size * np.array([side * 8, -26, -42]), size * np.array([7, 11, 9]))
        scene += embedded("air", "sphenoid sinus", sphenoid)
    return scene


def _calcifications(generator: Generator, size: float) -> Scene:
    """Return a calcified pineal gland and choroid plexuses: small dense balls inside the head."""
    places = [np.array([0.0, 18, 2]), *_mirrored(22, 30, 8, 1.0)]
    scene = Scene()
    for place in places:
        center = size * (place + generator.uniform(-2, 2, 3))
        scene += embedded("cortical bone", "calcification", sphere(center, generator.uniform(3, 7)))
        scene += Scene((), (), (Decoy("calcification", center),))
    return scene
