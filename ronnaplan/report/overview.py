"""Page one of the report: the head with all trajectories in 3-D, and each trajectory in a line."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ronnaplan.case.folder import Case
from ronnaplan.case.judgement import Judgement
from ronnaplan.planning import Measures, Trajectory
from ronnaplan.planning.rows import errors_by_basis, frame_sentence, number
from ronnaplan.report.html import Part, element, picture, table
from ronnaplan.scene.camera import Camera
from ronnaplan.scene.files import view, viewer
from ronnaplan.scene.names import Names, Room
from ronnaplan.scene.picture import Shades
from ronnaplan.scene.things import REJECTED, Thing
from ronnaplan.scene.vtk import Workshop
from ronnaplan.text import isolated, told_apart

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TITLE = "Overview"
SHAPE = (700, 1000)
"""Rows and columns of the picture."""

NAME_POINTS, NAME_LETTER_EM = 15, 0.7
"""Size of the names in the picture, and how wide their bold letters are on average, in heights."""

MOST_TRIANGLES = 40_000
"""Of skin and skull: a report is mailed."""

HEADER = ("trajectory", "length", "arc, ring", "AC-PC sag., cor.", "planned", "registered", "limits")
UNITS = ("", "mm", "deg", "deg", "mm at target", "mm at target", "")

STYLE = """
.scene { position: relative; height: 30rem; background: #0b0e11; color: #e6edf3 }
.scene canvas, .scene #still { position: absolute; width: 100%; height: 100%; object-fit: contain }
.scene canvas { touch-action: pan-y }
.scene #names { position: absolute; inset: 0; overflow: hidden; pointer-events: none }
.scene #names span { position: absolute; white-space: nowrap; font-size: 13px; line-height: 15px;
  text-shadow: 0 0 3px #000, 0 0 3px #000 } .scene #names .side { font-weight: 700; color: #4fc3f7 }
.scene details { position: absolute; right: .5rem; top: .5rem; max-height: 90%; overflow: auto; padding: .2rem .6rem;
  font-size: 12px; background: rgb(17 22 27 / 75%) } .scene summary { cursor: pointer } .scene label { display: block }
.scene label i { display: inline-block; width: 11px; height: 11px; border-radius: 3px; margin: 0 6px 0 2px }
.scene input[type=range] { width: 70px; vertical-align: middle; margin-left: 8px }
@media print {
  .scene { height: 100mm; background: none } .head img { display: block; margin: auto; max-height: 100mm }
  .scene #still { display: block !important } .scene canvas, .scene details { display: none }
}
"""


@dataclass(frozen=True, eq=False)
class View:
    """What there is to see of a case: its things, and a picture of them with the trajectories' names (PNG).

    ``robot_png`` is a picture of the robot beside them, empty where it has no place.
    """

    things: Sequence[Thing]
    still_png: bytes
    robot_png: bytes = b""


def view_of(case: Case) -> View:
    """Return what there is to see of a case with its scan; raises `InputError` where it cannot be made."""
    from ronnaplan.scene import robot
    from ronnaplan.scene.contents import things_of

    with Workshop() as workshop:
        things = things_of(workshop, case, MOST_TRIANGLES)
        beside = robot.still_png(workshop, case.placement, things) if case.placement else b""
        return View(things, _named(workshop, case, things), beside)


def overview_part(case: Case, seen: View | None, *, turns: bool) -> Part:
    """Show the head with all trajectories (to be turned, where the page ``turns`` it) and each one in a line."""
    body = [] if seen is None else [_head(seen, turns=turns)]
    if case.plan is not None and case.volume is not None and case.plan.trajectories:
        shown = told_apart(one.name for one in case.plan.trajectories)
        rows = [
            _row(judged, shown[one.name], one.length_mm)
            for one, judged in zip(case.plan.trajectories, case.judgements, strict=True)
        ]
        body.append(table(HEADER, [UNITS, *rows]))
        if case.plan.landmarks is not None:
            body.append(element("p", frame_sentence(case.plan.landmarks), "note"))
    return Part(TITLE, body)


def script(seen: View | None) -> str:
    """Return the script that turns a view."""
    return "" if seen is None else viewer()


def _head(seen: View, *, turns: bool) -> str:
    caption = "the head from the front, its left on the right; each trajectory is named at its entry"
    if any(one.name == REJECTED for one in seen.things):
        caption += "; red: candidates that were rejected as markers"
    if not turns:
        return f'<div class="head">{picture(seen.still_png, caption)}</div>'
    shown = f'<div class="scene">{view(seen.things, caption, seen.still_png)}</div>'
    return f'<figure>{shown}<figcaption><span id="how"></span>{caption}</figcaption></figure>'


def _row(judged: Judgement, name: str, length_mm: float) -> list[str]:
    return [
        isolated(name),
        number(length_mm, 1),
        *_angles(judged.measures),
        *_errors(judged.measures),
        _verdict(judged),
    ]


def _verdict(judged: Judgement) -> str:
    if judged.problem:
        return "not judged"
    broken, count = len(judged.broken), len(judged.verdicts)
    kept = f"FAIL: {broken} of {count}" if broken else f"{count} kept"
    return f"{kept}, doubted" if judged.doubts else kept


def _angles(one: Measures | None) -> tuple[str, str]:
    if one is None:
        return "-", "-"
    acpc = "-" if one.acpc is None else f"{one.acpc.sagittal_deg:.1f}, {one.acpc.coronal_deg:.1f}"
    return f"{one.arc.arc_deg:.1f}, {one.arc.ring_deg:.1f}", acpc


def _errors(one: Measures | None) -> list[str]:
    found = (None, None) if one is None else errors_by_basis(one)
    return [number(error.target_rms_mm if error else None) for error in found]


def _named(workshop: Workshop, case: Case, things: Sequence[Thing]) -> bytes:
    """Return a picture of things with the names of the trajectories at their entries, as a PNG."""
    from ronnaplan.report.picture import png
    from ronnaplan.scene.picture import picture as drawn
    from ronnaplan.scene.portrait import filling

    camera = filling(things)
    return png(named_figure(drawn(workshop, things, camera, SHAPE), camera, tuple(case.plan or ())))


def named_figure(shades: Shades, camera: Camera, paths: Sequence[Trajectory]) -> Figure:
    """Return a picture of `SHAPE` that a camera took, with the names of trajectories at their entries."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.patheffects import withStroke

    from ronnaplan.report.picture import BACKGROUND

    wide = SHAPE[1] / SHAPE[0]
    figure = Figure(figsize=(SHAPE[1] / 100, SHAPE[0] / 100), dpi=100, facecolor="none")
    FigureCanvasAgg(figure)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.imshow(shades, extent=(-wide, wide, -1.0, 1.0), interpolation="antialiased")
    axes.set_axis_off()
    room = Room(wide, 1.0, 2 * NAME_POINTS * figure.dpi / 72 / SHAPE[0], NAME_LETTER_EM)
    at = camera.on_screen(np.array([one.entry_mm for one in paths]).reshape(-1, 3))[:, :2].tolist()
    named = [
        {"name": one.name, "entry": place, "colour": one.colour}
        for one, place in zip(paths, at, strict=True)
        if abs(place[0]) < wide and abs(place[1]) < 1.0
    ]
    for one in Names(room).of_paths(named):
        written = one["written"]
        axes.text(
            written["x"],
            -written["y"],
            written["text"],
            ha="left" if written["anchor"] == "start" else "right",
            fontsize=NAME_POINTS,
            weight="bold",
            color=one["colour"],
            path_effects=[withStroke(linewidth=3, foreground=BACKGROUND)],
        )
    return figure
