"""A head and what surrounds it on a CT table. LPS mm; the head's center is the origin, it looks along -y."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from phantoms.scene import Part, Scene
from phantoms.solids import FloatArray, Solid, Vector, box, cylinder, ellipsoid

SCALP_SEMI_AXES_MM = (76.0, 96.0, 92.0)
"""Half width, half length and height above the center of the head of a large adult."""
TEETH = 12
"""Teeth of the upper jaw that `head` draws."""


@dataclass(frozen=True)
class Foot:
    """A place on a surface with the outward unit normal there."""

    place_mm: FloatArray
    outward: FloatArray

    def above(self, height_mm: float) -> FloatArray:
        """Return the point ``height_mm`` over the surface (below it when negative)."""
        return self.place_mm + height_mm * self.outward


def scalp_foot(direction: Vector, size: float = 1.0) -> Foot:
    """Return where a ray from the head's center along ``direction`` leaves the scalp of `head`."""
    axes = np.asarray(SCALP_SEMI_AXES_MM) * size
    ray = np.asarray(direction, dtype=np.float64)
    place = ray / np.linalg.norm(ray / axes)
    outward = place / axes**2
    return Foot(place, outward / np.linalg.norm(outward))


def embedded(material: str, name: str, *solids: Solid) -> Scene:
    """Return solids of one material that cut through whatever was there before."""
    return Scene(tuple(Part(solid, material, name, embedded=True) for solid in solids))


def pair(center: tuple[float, float, float], semi_axes: tuple[float, float, float], size: float) -> list[Solid]:
    """Return an ellipsoid and its mirror image across the midline."""
    x, y, z = center
    return [ellipsoid((side * x * size, y * size, z * size), size * np.array(semi_axes)) for side in (-1, 1)]


def head(size: float = 1.0) -> Scene:
    """Return a head of skin, skull, brain, ventricles, air sinuses, petrous bones, ears, neck and teeth."""
    scalp = np.asarray(SCALP_SEMI_AXES_MM) * size
    scene = (
        embedded("skin", "neck", cylinder(size * np.array([0, 18, -50]), (0, 0.1, -1), 120 * size, 112 * size))
        + embedded("skin", "face", ellipsoid(size * np.array([0, -40, -66]), size * np.array([56, 52, 58])))
        + embedded("skin", "ear", *pair((77, 12, -28), (5, 15, 27), size))
        + embedded("skin", "scalp", ellipsoid((0, 0, 0), scalp))
        + embedded("skull", "skull", ellipsoid((0, 0, 0), scalp - 6 * size))
        + embedded("brain", "brain", ellipsoid((0, size, -size), scalp - 13 * size))
        + embedded("skull", "spine", cylinder(size * np.array([0, 26, -80]), (0, 0.1, -1), 90 * size, 28 * size))
        + embedded("skull", "maxilla", ellipsoid(size * np.array([0, -54, -78]), size * np.array([34, 28, 14])))
        + embedded("air", "nasal cavity", ellipsoid(size * np.array([0, -66, -58]), size * np.array([10, 22, 16])))
        + embedded("air", "frontal sinus", ellipsoid(size * np.array([0, -85, 12]), size * np.array([13, 2.4, 7])))
        + embedded("cerebrospinal fluid", "ventricle", *pair((9, 0, 12), (6, 30, 9), size))
        + embedded("cortical bone", "petrous bone", *pair((36, 14, -40), (18, 9, 9), size))
        + embedded("air", "maxillary sinus", *pair((27, -58, -62), (10, 13, 12), size))
        + embedded("tooth", "tooth", *(_tooth(n, size) for n in range(TEETH)))
    )
    return Scene(scene.parts, name="head")


def tooth_place(number: int, size: float) -> FloatArray:
    """Return the root's end of an upper tooth (0 to 11, from the right to the left)."""
    angle = np.radians(-66 + 132 * number / (TEETH - 1))
    return size * np.array([26 * np.sin(angle), -46 - 30 * np.cos(angle), -94])


def _tooth(number: int, size: float) -> Solid:
    return cylinder(tooth_place(number, size), (0, 0, 1), 16 * size, 6.5 * size)


def dental_metal(teeth: tuple[int, ...], material: str = "amalgam", size: float = 1.0) -> Scene:
    """Return fillings in the biting surfaces of the given ``teeth`` (0 to 11, from the right to the left)."""
    fillings = [cylinder(tooth_place(number, size), (0, 0, 1), 4 * size, 4.4 * size) for number in teeth]
    return embedded(material, "dental filling", *fillings)


def headrest(size: float) -> Scene:
    """Return a padded carbon-fibre headrest: a bottom plate, two wings and foam under the back of the head."""
    back = SCALP_SEMI_AXES_MM[1] * size
    parts = [
        Part(box((0, back + 6, 0), (90, 11, 170)), "foam", "headrest pad"),
        Part(box((0, back + 15, 0), (110, 5, 190)), "carbon fibre", "headrest"),
    ]
    for side in (-1, 1):
        angle = np.radians(-side * 38)
        turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
        parts.append(Part(box((side * 82, back - 6, -10), (64, 4, 120), turn), "carbon fibre", "headrest wing"))
    return Scene(tuple(parts))


def table(size: float = 1.0) -> Scene:
    """Return the end of a patient table, a foam core in a carbon-fibre skin, below neck and headrest."""
    place = np.array([0, SCALP_SEMI_AXES_MM[1] * size + 50, -160])
    return Scene(
        (
            Part(box(place, (420, 32, 240)), "carbon fibre", "table"),
            Part(box(place, (414, 27, 236)), "foam", "table core"),
        )
    )


def surroundings(size: float = 1.0) -> Scene:
    """Return table and headrest; they come before the head in priority."""
    return table(size) + headrest(size)


def infusion_tube(size: float = 1.0, farther_mm: float = 0.0) -> Scene:
    """Return a water-filled PVC tube along the right side of the head; ``farther_mm`` keeps it off tall markers."""
    start, direction = size * np.array([-104, -10, -110]), (0.02, -0.15, 1)
    start = start - np.array([farther_mm, 0, 0])
    return Scene(
        (
            Part(cylinder(start, direction, 190 * size, 4.1), "PVC", "infusion tube"),
            Part(cylinder(start, direction, 190 * size, 3.0), "water", "infusion"),
        )
    )


def electrode(foot: Foot) -> Scene:
    """Return an ECG (or EEG) electrode on the skin: a gel pad, a silver disc and a steel snap."""
    return (
        embedded("water", "electrode gel", cylinder(foot.above(0), foot.outward, 1.5, 14))
        + embedded("silver", "electrode", cylinder(foot.above(1.5), foot.outward, 0.6, 10))
        + embedded("steel", "electrode snap", cylinder(foot.above(2.1), foot.outward, 3, 4))
    )


def ear_rings(size: float = 1.0) -> Scene:
    """Return a gold stud in each ear lobe: a disc and a pin."""
    scene = Scene()
    for side in (-1, 1):
        lobe = size * np.array([side * 79, 10, -48])
        scene += embedded("gold", "ear stud", cylinder(lobe, (side, 0, 0), 8, 1.0))
        scene += embedded("gold", "ear-ring", cylinder(lobe + np.array([side * 6, 0, 0]), (side, 0, 0), 1.6, 5))
    return scene
