"""The template as a solid: pads joined by bars, holes for screws, labels engraved, flat or bent (manifold3d)."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np

from ronnaplan.errors import InputError
from ronnaplan.geometry import FloatArray
from ronnaplan.planning.template_layout import ENGRAVED_MM, TemplateLayout

if TYPE_CHECKING:
    from numpy.typing import NDArray

BAR_WIDTH_MM = 10.0
"""Of what joins two pads."""
LETTER_MM = 5.0
LETTER_FROM_HOLE_MM = 5.2
"""Height of a label, and the least distance of its middle from that of its hole."""
CORNERS = 64
"""Of a pad."""
GAP_MM = 6.0
"""Narrower gaps between bars are filled: a printer closes them badly."""
LONGEST_EDGE_MM = 4.0
"""Edges are no longer where the plate is bent, so that it bends evenly."""
CAPITAL_HEIGHT = 0.73
"""Of the letters' face, as a share of its size."""


@dataclass(frozen=True, eq=False)
class Solid:
    """A closed surface: ``vertices_mm`` (V, 3) and ``triangles`` (T, 3), turning left as seen from outside."""

    vertices_mm: FloatArray
    triangles: NDArray[np.int64]


def outline(found: TemplateLayout) -> list[FloatArray]:
    """Return the closed polygons (N, 2) of the flat plate's outline, screw holes included, mm."""
    section, operation = _manifold3d().CrossSection, _manifold3d().OpType
    screw = section.circle(found.bridge.hole_diameter_mm / 2, CORNERS)
    holes = [screw.translate(hole) for hole in found.holes_mm.tolist()]
    drilled = section.batch_boolean([_plate(found), *holes], operation.Subtract)
    return [np.asarray(one, dtype=np.float64) for one in drilled.to_polygons()]


def template_solid(found: TemplateLayout) -> Solid:
    """Return the template, its lower surface at z = 0 in the middle; raises `InputError` without manifold3d."""
    manifold, bridge = _manifold3d(), found.bridge
    body = manifold.Manifold.extrude(_plate(found), bridge.thickness_mm)
    for label, hole in zip(found.labels, found.holes_mm, strict=True):
        section = manifold.CrossSection(_letters(label), manifold.FillRule.EvenOdd)
        place = label_place(found, hole)
        letters = manifold.Manifold.extrude(section, 2 * ENGRAVED_MM)
        body = body - letters.translate((*place.tolist(), bridge.thickness_mm - ENGRAVED_MM))
    if bridge.radius_mm is not None:
        body = body.refine_to_length(LONGEST_EDGE_MM)
        body = body.warp_batch(lambda points: bridge.bent(np.asarray(points)))
    # last, as bending would widen them towards the upper surface
    body = manifold.Manifold.batch_boolean([body, *_bores(found)], manifold.OpType.Subtract)
    mesh = body.to_mesh64()
    vertices = np.asarray(mesh.vert_properties, dtype=np.float64)[:, :3]
    return Solid(vertices, np.asarray(mesh.tri_verts, dtype=np.int64))


def label_place(found: TemplateLayout, hole_mm: FloatArray) -> FloatArray:
    """Return where (2,) a hole's label is engraved: towards the middle of all holes, where the bars leave room.

    A wide hole keeps off the middle of its letter: an E without its foot is an F.
    """
    from_hole_mm = max(LETTER_FROM_HOLE_MM, found.bridge.hole_diameter_mm / 2 + LETTER_MM / 2)
    way = found.holes_mm.mean(axis=0) - hole_mm
    length = float(np.linalg.norm(way))
    inward = way / length if length > 1 else np.array([0.0, 1.0])
    return np.asarray(hole_mm + inward * from_hole_mm)


def _bores(found: TemplateLayout) -> list[Any]:
    """Return what is drilled out of the plate for the screws: straight, square to it where each hole is."""
    bridge, cylinder = found.bridge, _manifold3d().Manifold.cylinder
    beyond, radius = bridge.hole_diameter_mm, bridge.hole_diameter_mm / 2
    drill = cylinder(bridge.thickness_mm + 2 * beyond, radius, radius, CORNERS).translate((0.0, 0.0, -beyond))
    bores = []
    for x, y in found.holes_mm.tolist():
        tilt_deg = 0.0 if bridge.radius_mm is None else float(np.degrees(x / bridge.radius_mm))
        place = bridge.bent(np.array([x, y, 0.0])).tolist()
        bores.append(drill.rotate((0.0, tilt_deg, 0.0)).translate(place))
    return bores


def _plate(found: TemplateLayout) -> Any:
    """Return the flat plate's cross-section, without the screws' holes."""
    section, operation = _manifold3d().CrossSection, _manifold3d().OpType
    holes = found.holes_mm.tolist()
    disc = section.circle(found.bridge.pad_radius_mm, CORNERS)
    thin = section.circle(BAR_WIDTH_MM / 2, CORNERS)
    pads = [disc.translate(hole) for hole in holes]
    bars = [
        section.batch_hull([thin.translate(one), thin.translate(other)]) for one, other in combinations(holes, 2)
    ]
    return section.batch_boolean(pads + bars, operation.Add).offset(GAP_MM / 2).offset(-GAP_MM / 2)


def _letters(label: str) -> list[FloatArray]:
    """Return the outlines (N, 2) of a label about the origin, `LETTER_MM` high."""
    from matplotlib.font_manager import FontProperties
    from matplotlib.textpath import TextPath

    face = FontProperties(family="DejaVu Sans", weight="bold")
    path = TextPath((0, 0), label, size=LETTER_MM / CAPITAL_HEIGHT, prop=face)
    polygons = [np.asarray(one, dtype=np.float64)[:-1] for one in path.to_polygons()]
    corners = np.concatenate(polygons)
    middle = (corners.min(axis=0) + corners.max(axis=0)) / 2
    return [one - middle for one in polygons]


def _manifold3d() -> Any:
    try:
        import manifold3d
    except ImportError as error:
        raise InputError(
            "the package manifold3d, which makes the template's body, is missing; install ronnaplan[template]"
        ) from error
    return manifold3d
