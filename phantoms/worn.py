"""What people wear on a head in a scanner: hair, EEG caps, braces, head frames. LPS mm."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from phantoms.anatomy import SCALP_SEMI_AXES_MM, TEETH, Foot, embedded, scalp_foot, tooth_place
from phantoms.scene import Part, Scene
from phantoms.solids import FloatArray, Solid, box, cone, cylinder, ellipsoid, frame_along

HAIR_MM = 12.0
"""Thickness of loose hair on the scalp."""
LOCKS = 60
CAP_CLEARANCE_MM = 18.0
"""Electrodes and wires of a cap keep this distance from markers."""
TEN_TWENTY = ((0, (0,)), (36, (0, 90, 180, 270)), (52, (45, 135, 225, 315)), (72, tuple(range(18, 360, 36))))
"""The 19 electrodes of the 10-20 system, nearly: degrees from the vertex, and around it from the front."""
Generator = np.random.Generator


def hair(generator: Generator, size: float = 1.0) -> Scene:
    """Return hair, loose and in locks, with pins; it comes before the head and gives way to all that follows."""
    loose = ellipsoid((0, 4 * size, 4 * size), np.asarray(SCALP_SEMI_AXES_MM) * size + HAIR_MM)
    parts = [Part(loose, "loose hair", "hair", embedded=True, yields=True)]
    for _ in range(LOCKS):
        foot = scalp_foot(_upwards(generator), size)
        way = _flat(generator, foot)
        start = foot.above(generator.uniform(1, HAIR_MM - 2)) - 15 * way
        lock = cylinder(start, way, generator.uniform(15, 40), generator.uniform(0.6, 2.0))
        parts.append(Part(lock, "hair", "lock of hair", embedded=True, yields=True))
    for _ in range(int(generator.integers(0, 4))):
        foot = scalp_foot(_upwards(generator), size)
        pin = cylinder(foot.above(3), _flat(generator, foot), 45, 1.0)
        parts.append(Part(pin, "steel", "hairpin", embedded=True, yields=True))
    return Scene(tuple(parts))


def eeg_cap(feet: list[Foot], size: float = 1.0) -> Scene:
    """Return silver electrodes in gel with copper wires and a fabric cap, clear of ``feet``."""
    fabric = ellipsoid((0, 0, 0), np.asarray(SCALP_SEMI_AXES_MM) * size + 1.0)
    scene = Scene((Part(fabric, "cloth", "cap", embedded=True, yields=True),))
    for foot in _ten_twenty(size):
        if min((np.linalg.norm(foot.place_mm - f.place_mm) for f in feet), default=np.inf) < CAP_CLEARANCE_MM:
            continue
        down = np.cross(np.cross(foot.outward, (0.0, 0.3, -1.0)), foot.outward)
        wire = cylinder(foot.above(4), down + 0.4 * foot.outward, 11, 1.0)
        scene += embedded("PVC", "electrode holder", cylinder(foot.above(0), foot.outward, 6, 13))
        scene += embedded("gel", "electrode gel", cylinder(foot.above(0), foot.outward, 3, 10))
        scene += embedded("silver", "electrode", cylinder(foot.above(3), foot.outward, 0.6, 10))
        scene += embedded("copper", "electrode wire", wire)
    return scene


def _ten_twenty(size: float) -> list[Foot]:
    angles = [np.radians((down, turn)) for down, turns in TEN_TWENTY for turn in turns]
    return [
        scalp_foot((np.sin(down) * np.sin(turn), -np.sin(down) * np.cos(turn), np.cos(down)), size)
        for down, turn in angles
    ]


def braces(size: float = 1.0) -> Scene:
    """Return steel brackets on the upper teeth and the wire that joins them."""
    middles = []
    brackets: list[Solid] = []
    for number in range(TEETH):
        place = tooth_place(number, size) + size * np.array([0, 0, 7])
        outward = place - size * np.array([0, -46, -87])
        outward = outward / np.linalg.norm(outward)
        middles.append(place + 4.2 * size * outward)
        brackets.append(box(middles[-1], (3.0, 3.4, 2.0), frame_along(outward)))
    wires = [cylinder(a, b - a, float(np.linalg.norm(b - a)), 0.5) for a, b in pairwise(middles)]
    return embedded("steel", "bracket", *brackets) + embedded("steel", "wire", *wires)


def head_frame(size: float = 1.0, clearance_mm: float = 0.0) -> Scene:
    """Return a stereotactic frame: an aluminium ring on four posts with titanium pins, and plates with N-shaped rods.

    ``clearance_mm`` moves the plates outward, off tall markers.
    """
    x, y = 108 * size + clearance_mm, 134 * size + clearance_mm
    base, top = -62 * size, 100 * size
    beams = [box((0, side * 104 * size, base), (2 * x, 14, 14)) for side in (-1, 1)]
    beams += [box((side * (x - 8), 0, base), (14, 208 * size, 14)) for side in (-1, 1)]
    scene = embedded("aluminium", "frame ring", *beams)
    for u in (-1, 1):
        for v in (-1, 1):
            post = np.array([u * 74 * size, v * 104 * size, base])
            tip = _skull_towards(np.array([u * 50, v * 62, -6.0]) * size, size)
            start = np.array([post[0], post[1], tip[2]])
            way = tip - start
            length = float(np.linalg.norm(way))
            scene += embedded("aluminium", "frame post", cylinder(post, (0, 0, 1), tip[2] - base + 10, 12))
            scene += embedded("titanium", "frame pin", cylinder(start, way, length - 4, 6))
            scene += embedded("titanium", "pin tip", cone(start + way * (1 - 4 / length), way, 6, 6, 1))
    for side in (-1, 1):
        scene += _n_bar(np.array([side * x, 0, 0]), np.array([0.0, 1, 0]), 60 * size, base + 20, top)
    return scene + _n_bar(np.array([0, -y, 0]), np.array([1.0, 0, 0]), 60 * size, base + 20, top)


def _n_bar(middle: FloatArray, along: FloatArray, half_mm: float, low: float, high: float) -> Scene:
    """Return an acrylic plate with three aluminium rods in the shape of an N."""
    up = np.array([0.0, 0.0, 1.0])
    turn = np.column_stack([along, np.cross(up, along), up])
    plate = box(middle + up * (low + high) / 2, (2 * half_mm + 20, 6, high - low), turn)
    ends = [middle + side * half_mm * along + height * up for side in (-1, 1) for height in (low, high)]
    rods = [cylinder(a, b - a, float(np.linalg.norm(b - a)), 3) for a, b in pairwise(ends)]
    return embedded("acrylic", "N plate", plate) + embedded("aluminium", "N rod", *rods)


def _skull_towards(direction: FloatArray, size: float) -> FloatArray:
    """Return a place 2 mm inside the skull's surface."""
    return scalp_foot(direction, size).above(-8.0 * size)


def _upwards(generator: Generator) -> FloatArray:
    direction = generator.standard_normal(3)
    direction[2] = abs(direction[2])
    return direction


def _flat(generator: Generator, foot: Foot) -> FloatArray:
    """Draw a unit direction along the scalp."""
    way: FloatArray = np.cross(foot.outward, generator.standard_normal(3))
    way /= np.linalg.norm(way)
    return way
