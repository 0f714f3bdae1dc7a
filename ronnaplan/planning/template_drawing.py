"""The drawing of a template with its dimensions: a page of A4 as SVG and PDF; imports matplotlib."""

from __future__ import annotations

import io
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from ronnaplan.geometry import FloatArray, mutual_distances
from ronnaplan.letters import written_out
from ronnaplan.planning.template_layout import TemplateLayout, refusal_text
from ronnaplan.planning.template_solid import label_place, outline

PAGE_MM = (210.0, 297.0)
VIEW_MM, FRONT_MM = (150.0, 100.0), (170.0, 52.0)
"""The room on the page for the plate, and for what is seen from the front."""
MM_PER_INCH = 25.4
SCALES = (1, 2, 5, 10, 20, 50)
LEAST_TEXT_APART_MM = 4.0
LINE: dict[str, Any] = {"color": "black", "linewidth": 0.8}
THIN: dict[str, Any] = {"color": "0.45", "linewidth": 0.4}
SMALL = 7.0
"""Size of the lettering, in points."""


def template_drawing(found: TemplateLayout, title: str) -> Figure:
    """Return the page: flat pattern, view from the front, holes, distances, tolerances."""
    figure = Figure(figsize=(PAGE_MM[0] / MM_PER_INCH, PAGE_MM[1] / MM_PER_INCH))
    FigureCanvasAgg(figure)
    scale = _scale(found)
    figure.text(0.06, 0.965, title, fontsize=13)
    figure.text(0.06, 0.95, f"scale 1:{scale} on A4; all lengths in mm", fontsize=SMALL)
    _draw_pattern(_pane(figure, (15, 145, 180, 130)), found, scale)
    _draw_front(_pane(figure, (15, 85, 180, 60)), found, scale)
    _write_tables(figure, found)
    return figure


def drawing_file(figure: Figure, kind: str) -> bytes:
    """Return the page as ``"svg"`` or ``"pdf"``; the same page gives the same bytes."""
    dates = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}
    written_out(figure)
    stream = io.BytesIO()
    with mpl.rc_context({"svg.hashsalt": "ronnaplan", "svg.fonttype": "path"}):
        figure.savefig(stream, format=kind, metadata=dates[kind])
    return stream.getvalue()


def _pane(figure: Figure, box_mm: tuple[float, float, float, float]) -> Any:
    """Return axes over a box of the page (left, bottom, width, height) in mm, their origin in its middle."""
    left, bottom, width, height = box_mm
    (across, up) = PAGE_MM
    axes = figure.add_axes((left / across, bottom / up, width / across, height / up))
    axes.set_xlim(-width / 2, width / 2)
    axes.set_ylim(-height / 2, height / 2)
    axes.set_aspect("equal")
    axes.axis("off")
    return axes


def _scale(found: TemplateLayout) -> int:
    """Return one to how many both views are drawn, so that they have room."""
    sizes = np.array([np.ptp(np.concatenate(outline(found)), axis=0), np.ptp(_front_ends(found), axis=0)])
    return next(one for one in SCALES if (sizes / one <= np.array([VIEW_MM, FRONT_MM])).all())


def _front_plate(found: TemplateLayout) -> FloatArray:
    """Return the plate's outline (N, 2) as seen from the front."""
    places = np.concatenate(outline(found))
    across = np.linspace(places[:, 0].min(), places[:, 0].max(), 181)
    rows = [np.stack([across, 0 * across, 0 * across + z], axis=1) for z in (0.0, found.bridge.thickness_mm)]
    lower, upper = (found.bridge.bent(row)[:, [0, 2]] for row in rows)
    return np.vstack([lower, upper[::-1], lower[:1]])


def _front_ends(found: TemplateLayout) -> FloatArray:
    """Return the least and the greatest (2, 2) of what is seen from the front, markers included."""
    plate, centers, radius = _front_plate(found), found.centers_mm[:, [0, 2]], found.bridge.marker_diameter_mm / 2
    ends = np.vstack([plate, centers - radius, centers + radius])
    return np.stack([ends.min(axis=0), ends.max(axis=0)])


def _draw_pattern(axes: Any, found: TemplateLayout, scale: int) -> None:
    """Draw the flat plate with its holes, and how far each is from the left and the front edge."""
    places = np.concatenate(outline(found))
    low, high = places.min(axis=0), places.max(axis=0)
    middle = (low + high) / 2
    for polygon in outline(found):
        closed = (np.vstack([polygon, polygon[:1]]) - middle) / scale
        axes.plot(closed[:, 0], closed[:, 1], **LINE)
    (left, front), (right, back) = (low - middle) / scale, (high - middle) / scale
    width, depth = high - low
    _dimension(axes, (left, back + 8), (right, back + 8), f"{width:.1f}")
    _dimension(axes, (right + 8, front), (right + 8, back), f"{depth:.1f}")
    for label, place in zip(found.labels, found.holes_mm, strict=True):
        hole, letter = (place - middle) / scale, (label_place(found, place) - middle) / scale
        axes.plot(hole[0] + np.array([-3, 3]), [hole[1]] * 2, **THIN)
        axes.plot([hole[0]] * 2, hole[1] + np.array([-3, 3]), **THIN)
        axes.text(*letter, label, ha="center", va="center", fontsize=9 / scale, weight="bold")
    holes = (found.holes_mm - middle) / scale
    for axis, edge in ((0, front), (1, left)):
        _ordinates(axes, holes, axis, edge, found.holes_mm[:, axis] - low[axis])
    text = "flat pattern from above: lengths along the lower surface, from its left and front edge; the front is below"
    axes.text(0, front - 17, text, fontsize=SMALL, ha="center", va="top")


def _ordinates(axes: Any, holes: FloatArray, axis: int, edge: float, lengths: FloatArray) -> None:
    """Write each hole's length (N,) along ``axis`` beyond the plate's ``edge``, texts kept apart."""
    written = -np.inf
    for n in np.argsort(holes[:, axis]):
        hole = holes[n]
        at = max(float(hole[axis]), written + LEAST_TEXT_APART_MM)
        written = at
        line = np.array([[hole[axis], hole[1 - axis]], [hole[axis], edge - 2], [at, edge - 6]])
        xs, ys = (line[:, 0], line[:, 1]) if axis == 0 else (line[:, 1], line[:, 0])
        axes.plot(xs, ys, **THIN)
        where = (at, edge - 6.5) if axis == 0 else (edge - 6.5, at)
        style = {"rotation": 90, "ha": "center", "va": "top"} if axis == 0 else {"ha": "right", "va": "center"}
        axes.text(*where, f"{lengths[n]:.1f}", fontsize=SMALL, **style)


def _draw_front(axes: Any, found: TemplateLayout, scale: int) -> None:
    """Draw the plate and its markers as seen from the front."""
    bridge = found.bridge
    ends = _front_ends(found)
    shift = -ends.mean(axis=0)
    ring = (_front_plate(found) + shift) / scale
    axes.plot(ring[:, 0], ring[:, 1], **LINE)
    turn = np.linspace(0, 2 * np.pi, 73)
    circle = np.stack([np.cos(turn), np.sin(turn)], axis=1) * bridge.marker_diameter_mm / 2 / scale
    for label, hole, center in zip(found.labels, found.holes_mm, found.centers_mm, strict=True):
        foot, middle = ((one[[0, 2]] + shift) / scale for one in (bridge.bent(np.array([*hole, 0.0])), center))
        axes.plot(*np.stack([foot, middle], axis=1), **THIN)
        axes.plot(*(circle + middle).T, **LINE)
        axes.text(*middle, label, ha="center", va="center", fontsize=SMALL)
    shape = "flat" if bridge.radius_mm is None else f"lower surface R {bridge.radius_mm:.1f}"
    text = (
        f"from the front: {shape}, thickness {bridge.thickness_mm:g}, marker centers {bridge.marker_height_mm:g} "
        "above the upper surface"
    )
    axes.text(0, (ends[0, 1] + shift[1]) / scale - 4, text, fontsize=SMALL, ha="center", va="top")


def _dimension(axes: Any, start: tuple[float, float], end: tuple[float, float], text: str) -> None:
    """Draw a dimension line with its length."""
    axes.annotate("", start, end, arrowprops={"arrowstyle": "<->", "linewidth": 0.5, "shrinkA": 0, "shrinkB": 0})
    upright = start[0] == end[0]
    axes.text(
        (start[0] + end[0]) / 2 + (2 if upright else 0),
        (start[1] + end[1]) / 2 + (0 if upright else 1),
        text,
        fontsize=8,
        ha="left" if upright else "center",
        va="center" if upright else "bottom",
    )


def _write_tables(figure: Figure, found: TemplateLayout) -> None:
    bridge = found.bridge
    apart = mutual_distances(found.centers_mm)
    holes = ["hole     x       y    marker center x, y, z"]
    for label, hole, center in zip(found.labels, found.holes_mm, found.centers_mm, strict=True):
        numbers = " ".join(f"{value:8.2f}" for value in center)
        holes.append(f"{label}   {hole[0]:7.2f} {hole[1]:7.2f}  {numbers}")
    distances = ["centers  " + "".join(f"{label:>9}" for label in found.labels)]
    for label, row in zip(found.labels, apart, strict=True):
        distances.append(f"{label:<9}" + "".join(f"{value:9.2f}" for value in row))
    notes = [
        f"holes {bridge.hole_diameter_mm:g} through, square to the surface; pads R {bridge.pad_radius_mm:g}; "
        f"markers {bridge.marker_diameter_mm:g}",
        f"x and y from the middle of the plate before it is bent; printed within +-{bridge.print_tolerance_mm:g}, "
        f"markers within +-{bridge.screw_play_mm:g} of their holes' axes and heights",
        f"distances in a scan within +-{bridge.distance_tolerance_mm:.2f}; nearest rival "
        f"{found.rival_distance_mm:.1f}, refused for it in {refusal_text(found.refusal_probability)}",
        "research use only; measure the print before it is used",
    ]
    figure.text(0.06, 0.27, "\n".join([*holes, "", *distances]), fontsize=SMALL, family="monospace", va="top")
    figure.text(0.06, 0.08, "\n".join(notes), fontsize=SMALL, va="top")
