"""What stands before the scanner: parts of named materials, and which of them are markers."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import reduce

import numpy as np

from phantoms.errors import PhantomError
from phantoms.materials import material
from phantoms.solids import FloatArray, Shape, Solid, Vector

TOUCHING = 1e-3
"""Fraction of its size by which a part may enter its neighbour and still only touch it (written coordinates)."""


@dataclass(frozen=True)
class Part:
    """A solid of one material. Later parts of a scene replace earlier ones where they overlap.

    That is allowed when the later part lies wholly inside the earlier one, is made of the same material, or is
    declared ``embedded`` (a screw through skin and bone), or when the earlier one ``yields`` (hair); anything else is
    refused by `Scene.check`.
    """

    solid: Solid
    material: str
    name: str = ""
    embedded: bool = False
    yields: bool = False


@dataclass(frozen=True)
class Marker:
    """A sphere whose center is to be found."""

    label: str
    center_mm: FloatArray
    diameter_mm: float
    """The true one (of an ellipsoid: the mean); a covering does not count."""
    material: str
    stated_diameter_mm: float | None = None
    """What its maker promises; None: the true one."""
    wall_mm: float = 0.0
    """Thickness of a hollow marker's shell; 0 is a solid ball."""
    out_of_round: float = 0.0
    """Longest over shortest diameter minus one."""
    covering: str = ""
    """What lies on, around or in it."""
    path: FloatArray | None = None
    """Time (part of the scan) and place (N, 4) while it was in the beam, if it moved; the center is their mean."""


@dataclass(frozen=True)
class Decoy:
    """Something that could be taken for a marker and must not be."""

    kind: str
    center_mm: FloatArray


@dataclass(frozen=True)
class Scene:
    """Parts in ascending priority with the truth about them; scenes are joined with ``+``."""

    parts: tuple[Part, ...] = ()
    markers: tuple[Marker, ...] = ()
    decoys: tuple[Decoy, ...] = ()
    name: str = ""

    def __add__(self, other: Scene) -> Scene:
        return Scene(
            self.parts + other.parts,
            self.markers + other.markers,
            self.decoys + other.decoys,
            self.name or other.name,
        )

    def moved(self, rotation: FloatArray, translation_mm: Vector = (0.0, 0.0, 0.0)) -> Scene:
        """Return the scene, truth included, after ``p -> rotation @ p + translation_mm`` (LPS mm)."""
        shift = np.asarray(translation_mm, dtype=np.float64)
        return replace(
            self,
            parts=tuple(replace(p, solid=p.solid.moved(rotation, shift)) for p in self.parts),
            markers=tuple(replace(m, center_mm=rotation @ m.center_mm + shift) for m in self.markers),
            decoys=tuple(replace(d, center_mm=rotation @ d.center_mm + shift) for d in self.decoys),
        )

    def check(self) -> Scene:
        """Return the scene itself; raise `PhantomError` for an unknown material or a forbidden overlap."""
        if not self.parts:
            raise PhantomError("the scene is empty; expected at least one part")
        for part in self.parts:
            material(part.material)
        _check_markers_apart(self.markers)
        surfaces = [surface(part.solid) for part in self.parts]
        for late, inner in enumerate(self.parts):
            for early, outer in enumerate(self.parts[:late]):
                if not (inner.embedded or outer.yields or inner.material == outer.material):
                    _check_pair(outer, surfaces[early], inner, surfaces[late])
        return self


def join(scenes: Iterable[Scene], name: str) -> Scene:
    """Return one scene of many, in ascending priority."""
    return replace(reduce(Scene.__add__, scenes, Scene()), name=name)


def _check_markers_apart(markers: tuple[Marker, ...]) -> None:
    """Raise `PhantomError` when two markers share a label or space."""
    for n, one in enumerate(markers):
        for other in markers[:n]:
            if one.label == other.label:
                raise PhantomError(f"two markers are called {one.label!r}; give each marker its own label")
            gap = float(np.linalg.norm(one.center_mm - other.center_mm))
            if gap < (one.diameter_mm + other.diameter_mm) / 2:
                raise PhantomError(
                    f"markers {other.label} and {one.label} overlap: their centers are {gap:.2f} mm apart; "
                    "move them apart"
                )


def _check_pair(outer: Part, outer_surface: FloatArray, inner: Part, inner_surface: FloatArray) -> None:
    """Raise `PhantomError` unless the two parts are apart or ``inner`` lies wholly in ``outer``."""
    gap = float(np.linalg.norm(outer.solid.center_mm - inner.solid.center_mm))
    if gap >= outer.solid.radius_mm + inner.solid.radius_mm:
        return
    if len(inner_surface) and outer.solid.contains(inner_surface, margin=TOUCHING).all():
        return
    if not (
        outer.solid.contains(inner_surface, margin=-TOUCHING).any()
        or inner.solid.contains(outer_surface, margin=-TOUCHING).any()
    ):
        return
    raise PhantomError(
        f"{_title(inner)} overlaps {_title(outer)} without lying inside it; "
        "list the outer part first, move them apart, or declare the part embedded"
    )


def _title(part: Part) -> str:
    return f"{part.name or part.solid.shape.name.lower()} ({part.material})"


def surface(solid: Solid) -> FloatArray:
    """Return points (N, 3) spread over the surface, edges and corners of a solid (a half-space: none)."""
    if solid.shape is Shape.HALF_SPACE:
        return np.empty((0, 3))
    count = 400
    z = 1 - (2 * np.arange(count) + 1) / count
    angle = np.pi * (1 + 5**0.5) * np.arange(count)
    ball = np.column_stack([np.sqrt(1 - z**2) * np.cos(angle), np.sqrt(1 - z**2) * np.sin(angle), z])
    if solid.shape is Shape.BALL:
        unit = ball
    elif solid.shape is Shape.BOX:
        unit = ball / np.abs(ball).max(axis=1, keepdims=True)
        unit = np.vstack([unit, np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T])
    else:
        unit = _round_surface(1.0 if solid.shape is Shape.CYLINDER else solid.top_ratio)
    return unit @ solid.half_axes_mm.T + solid.center_mm


def _round_surface(top_ratio: float) -> FloatArray:
    angles, heights, radii = (
        np.linspace(0, 2 * np.pi, 24, endpoint=False),
        np.linspace(-1, 1, 15),
        (0.0, 0.35, 0.7),
    )
    rings = [
        *[((1 - z) / 2 + top_ratio * (1 + z) / 2, z) for z in heights],
        *[(r, -1.0) for r in radii],
        *[(r * top_ratio, 1.0) for r in radii],
    ]
    return np.array([(r * np.cos(a), r * np.sin(a), z) for r, z in rings for a in angles])
