"""What surgery leaves in a head: burr holes and their covers, plated bone flaps, shunts. LPS mm."""

from __future__ import annotations

import numpy as np

from phantoms.anatomy import Foot, embedded
from phantoms.scene import Decoy, Scene
from phantoms.solids import FloatArray, Vector, box, cylinder, frame_along, sphere

SKULL_DEPTHS_MM = (6.0, 13.0)
"""How deep below the scalp the skull's outer and inner surfaces lie."""
FLAP_MM = 50.0


def burr_hole(foot: Foot, *, covered: bool = True) -> Scene:
    """Return a 14 mm hole in the skull, filled with fluid, under a titanium cover with three screws."""
    outer, inner = SKULL_DEPTHS_MM
    hole = cylinder(foot.above(-inner - 1), foot.outward, inner - outer + 1.5, 14)
    scene = embedded("cerebrospinal fluid", "burr hole", hole)
    if covered:
        scene += embedded("titanium", "hole cover", cylinder(foot.above(-outer), foot.outward, 0.6, 20))
        frame = frame_along(foot.outward)
        for angle in np.radians((90, 210, 330)):
            aside = 8.5 * (np.cos(angle) * frame[:, 0] + np.sin(angle) * frame[:, 1])
            screw = cylinder(foot.above(-outer + 0.6) + aside, -foot.outward, 4.6, 1.6)
            scene += embedded("titanium", "cover screw", screw)
    return scene


def bone_flap(foot: Foot) -> Scene:
    """Return a square flap of bone, sawn out with gaps of 1.5 mm and held by four two-hole titanium plates."""
    outer, inner = SKULL_DEPTHS_MM
    frame = frame_along(foot.outward)
    middle, depth = foot.above(-(outer + inner) / 2 - 1), inner - outer + 4
    scene = Scene()
    for way, across in ((frame[:, 0], frame[:, 1]), (frame[:, 1], frame[:, 0])):
        for side in (-1, 1):
            edge = middle + side * FLAP_MM / 2 * way
            turn = np.column_stack([way, across, np.cross(way, across)])
            scene += embedded("soft tissue", "saw cut", box(edge, (1.5, FLAP_MM, depth), turn))
            scene += _plate(
                foot.above(-outer - _sagitta(FLAP_MM / 2)) + side * FLAP_MM / 2 * way, way, foot.outward
            )
    return scene


def _sagitta(aside_mm: float) -> float:
    """Return by how much a scalp of 85 mm radius falls away at some distance from its foot."""
    return float(85 - np.sqrt(85**2 - aside_mm**2))


def _plate(center: FloatArray, way: Vector, outward: FloatArray) -> Scene:
    along = np.asarray(way)
    turn = np.column_stack([along, np.cross(outward, along), outward])
    scene = embedded("titanium", "bone plate", box(center, (14, 3.5, 0.6), turn))
    for side in (-1, 1):
        screw = cylinder(center + side * 5 * along, -outward, 4, 1.6)
        scene += embedded("titanium", "plate screw", screw)
    return scene


def shunt(foot: Foot, size: float = 1.0) -> Scene:
    """Return a ventricular shunt: a catheter, a valve with a steel ball below the scalp, and a tube downwards."""
    target = size * np.array([6.0, 0, 10])
    way = target - foot.place_mm
    down = np.cross(np.cross(foot.outward, (0.0, 0.4, -1.0)), foot.outward)
    down /= np.linalg.norm(down)
    valve = foot.above(-3.5) + 16 * down
    scene = burr_hole(foot, covered=False)
    scene += embedded("silicone", "catheter", cylinder(foot.above(-3), way, float(np.linalg.norm(way)), 2.5))
    scene += embedded("water", "catheter's bore", cylinder(foot.above(-3), way, float(np.linalg.norm(way)), 1.3))
    scene += embedded("silicone", "tube", cylinder(foot.above(-3.5), down, 16, 2.5))
    scene += embedded("PEEK", "valve", cylinder(valve - 3 * foot.outward, foot.outward, 6, 14))
    scene += embedded("water", "valve chamber", cylinder(valve - 2 * foot.outward, foot.outward, 4, 8))
    scene += embedded("steel", "valve ball", sphere(valve, 2.5))
    scene += embedded("silicone", "tube", cylinder(valve + 7 * down, down - 0.25 * foot.outward, 60, 2.5))
    return scene + Scene((), (), (Decoy("shunt valve", valve),))
