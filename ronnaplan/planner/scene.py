"""The 3-D view: what is in it, and its picture, drawn here (no graphics hardware, no graphics library)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import count
from typing import TYPE_CHECKING

import numpy as np

from ronnaplan.geometry import FloatArray
from ronnaplan.planner.cuts import jpeg
from ronnaplan.planner.following import SeenTool
from ronnaplan.planner.regions import Regions
from ronnaplan.planner.state import PlannerState
from ronnaplan.planning import Measures, Placement, Proposals
from ronnaplan.planning.trajectory import Trajectory
from ronnaplan.scene import things
from ronnaplan.scene.camera import Camera
from ronnaplan.scene.picture import filled_in
from ronnaplan.scene.portrait import filling
from ronnaplan.scene.robot import robot_things
from ronnaplan.scene.shapes import Body, ball, joined, specks
from ronnaplan.scene.things import Thing

if TYPE_CHECKING:
    from ronnaplan.documents.placement import PlacementDocument

TURN_DEG_PER_PIXEL = 0.4
BACKGROUND = "#0b0e11"
OPACITY = {"skin": 0.55, "skull": 0.8}

SEEN_THROUGH = 0.4
"""Opacity of the selected marker."""

SPECK_MM = 1.2
"""Half width of a place of the map of entries."""

_NUMBERS = count(1)
"""Every thing that is shown on any page gets a number of its own."""


class Scene:
    """Keeps what is shown, by name; `draw` makes the picture of it."""

    def __init__(self, state: PlannerState) -> None:
        self.state = state
        low, high = state.look.bounds_mm
        middle = (low + high) / 2
        self.camera = Camera(middle + np.array([-0.6, -1.0, 0.5]) * 1.25 * float((high - low).max()), middle)
        self._shown: dict[str, Thing] = {}
        self._keys: dict[str, str] = {}
        self._corners_mm: dict[str, FloatArray] = {}

    def show_surface(self, kind: str, body: Body) -> None:
        """Show skin or skull in the place of the other."""
        self.hide_surface()
        if len(body.triangles):
            self._show(getattr(things, kind)(body, OPACITY[kind]))

    def hide_surface(self) -> None:
        """Show neither skin nor skull."""
        for name in OPACITY:
            self._shown.pop(name, None)

    def show_regions(self, regions: Regions, bodies: Mapping[str, Body]) -> None:
        """Show the regions that are not hidden."""
        self._hide("no-go ")
        self._hide("region ")
        for name, body in bodies.items():
            one = regions[name]
            if len(body.triangles) and one.opacity:
                made = things.no_go if one.no_go else things.label_map
                self._show(made(name, body, colour=one.colour, opacity=one.opacity))

    def show_markers(self) -> None:
        """Show the markers as balls of their size; through the selected one the ellipsoid of its error is seen."""
        self._hide("marker ")
        self._hide("95 % of ")
        found = self.state.case.fiducials
        for one in found.fiducials if found is not None else ():
            center, selected = np.array(one.center), one.label == self.state.look.marker
            self._show(things.marker(one.label, center, one.diameter_mm, SEEN_THROUGH if selected else 1.0))
            if selected:
                covariance = np.array(one.covariance)
                factor = things.spread_factor(covariance[np.newaxis], one.diameter_mm)
                self._show(things.spread(one.label, center, covariance, factor))

    def show_tools(self, tools: Sequence[SeenTool]) -> None:
        """Show the tools that are followed."""
        self._hide("tool ")
        for one in tools:
            self._show(things.tool(one.name, one.tip_mm, one.back))

    def show_tracker(self, ct_from_ots: FloatArray | None) -> None:
        """Show the tracker where it stood when the markers were registered, by ``ct_from_ots`` (4, 4), or hide it."""
        self._hide("tracker")
        if ct_from_ots is not None:
            self._show(things.tracker(ct_from_ots))

    def show_path(self, one: Trajectory, measured: Measures | None) -> None:
        """Show a trajectory, and the tube that it keeps within with a chance of 95 %."""
        self.hide_path(one.name)
        for part in things.path(one, measured):
            self._show(part)

    def hide_path(self, name: str) -> None:
        """Take a trajectory, its contacts and its tube away."""
        self._shown.pop(f"path {name}", None)
        self._shown.pop(f"contacts {name}", None)
        self._shown.pop(f"tube {name}", None)

    def show_proposals(self, found: Proposals | None) -> None:
        """Colour the scalp by the score of each entry."""
        self._hide("map")
        if found is None:
            return
        from ronnaplan.planning.proposals import score_map

        places, scores, allowed = score_map(found)
        if allowed.any():
            colours = np.repeat(_graded(scores[allowed]), 6, 0)
            self._show(Thing("map", specks(places[allowed], SPECK_MM), colours))

    def show_placement(self, placed: Placement | None) -> None:
        """Show proposed places for markers."""
        self._hide("placement")
        if placed is not None:
            balls = [ball(center, placed.diameter_mm / 2) for center in placed.centers_mm]
            self._show(Thing("placement", joined(balls), things.rgb(things.PROPOSAL_COLOURS[1]), 0.8))

    def show_robot(self, placement: PlacementDocument | None) -> None:
        """Show the robot at its place, and what stands in the room."""
        self._hide("robot")
        for one in robot_things(placement) if placement is not None else ():
            self._show(one)

    def fill(self) -> None:
        """Come as near as all that is shown can be seen whole."""
        if self._shown:
            self.camera = filling(list(self._shown.values()), self.camera.axes[2])

    def turn(self, across_pixels: float, down_pixels: float) -> None:
        """Turn the camera about the head."""
        self.camera = self.camera.turned(-TURN_DEG_PER_PIXEL * across_pixels, TURN_DEG_PER_PIXEL * down_pixels)

    def look_from(self, direction: FloatArray) -> None:
        """Look at the same place from a direction (3,), from as far."""
        away = float(np.linalg.norm(self.camera.position_mm - self.camera.focus_mm))
        self.camera = Camera(
            self.camera.focus_mm + away * direction / np.linalg.norm(direction), self.camera.focus_mm
        )

    def zoom(self, factor: float) -> None:
        """Come nearer (factor above 1)."""
        self.camera = self.camera.nearer(factor)

    def draw(self, shape: tuple[int, int]) -> bytes:
        """Return the picture (rows, columns) as JPEG: what is seen through last, skin or skull at the end."""
        picture = filled_in(self._in_order, self.camera, shape, things.rgb(BACKGROUND))
        return jpeg(np.ascontiguousarray(picture[..., 2::-1]))

    @property
    def reach_mm(self) -> float:
        """How far from what is looked at the farthest of what is shown lies, at most."""
        corners = np.array([self._corners_mm[name] for name in self._shown]).reshape(-1, 3)
        return float(np.linalg.norm(np.abs(corners - self.camera.focus_mm).max(axis=0, initial=0.0)))

    @property
    def listed(self) -> list[dict[str, str]]:
        """What is shown, last what is seen through: names, and under which key `thing` has each."""
        return [{"name": one.name, "key": self._keys[one.name]} for one in self._in_order]

    def thing(self, key: str) -> Thing | None:
        """Return what is shown under a key, None where it no longer is."""
        return next((one for name, one in self._shown.items() if self._keys[name] == key), None)

    @property
    def _in_order(self) -> list[Thing]:
        return sorted(self._shown.values(), key=lambda one: (one.name in OPACITY, one.opacity < 1.0))

    def _show(self, one: Thing) -> None:
        self._shown[one.name] = one
        places = one.body.vertices_mm
        self._corners_mm[one.name] = np.stack([places.min(axis=0), places.max(axis=0)])
        self._keys[one.name] = str(next(_NUMBERS))

    def _hide(self, beginning: str) -> None:
        for name in [name for name in self._shown if name.startswith(beginning)]:
            del self._shown[name]


def _graded(scores: FloatArray) -> FloatArray:
    """Return colours (N, 3) for scores from the least to the greatest."""
    share = (scores - scores.min()) / max(float(np.ptp(scores)), 1e-9)
    worst, best = (things.rgb(colour) for colour in things.PROPOSAL_COLOURS)
    colours: FloatArray = worst + share[:, np.newaxis] * (best - worst)
    return colours
