"""The 3-D view: what is in it, and its picture, drawn here (no graphics hardware, no graphics library)."""

from __future__ import annotations

import numpy as np

from ronnaplan.geometry import FloatArray
from ronnaplan.planner.cuts import JPEG_QUALITY
from ronnaplan.planner.state import PlannerState
from ronnaplan.planning import Measures, Placement, Proposals
from ronnaplan.planning.trajectory import Trajectory
from ronnaplan.scene import things
from ronnaplan.scene.camera import Camera
from ronnaplan.scene.picture import filled_in
from ronnaplan.scene.shapes import Body, ball, joined, specks
from ronnaplan.scene.things import Thing

SHAPE = (640, 640)
"""Rows and columns of the picture until the page says how large its view is."""

MOST_DRAGGED_PIXELS = 120_000
"""While an end is dragged the picture has no more, to keep up with the hand."""

TURN_DEG_PER_PIXEL = 0.4
BACKGROUND, PLACEMENT_COLOUR = "#0b0e11", "#4fc3f7"
OPACITY = {"skin": 0.55, "skull": 0.8}

SPECK_MM = 1.2
"""Half width of a place of the map of entries."""


class Scene:
    """Keeps what is shown, by name; `draw` makes the picture of it."""

    def __init__(self, state: PlannerState) -> None:
        self.state = state
        low, high = state.look.bounds_mm
        middle = (low + high) / 2
        self.camera = Camera(middle + np.array([-0.6, -1.0, 0.5]) * 1.25 * float((high - low).max()), middle)
        self.shape = SHAPE
        self._shown: dict[str, Thing] = {}

    def show_surface(self, kind: str, body: Body) -> None:
        """Show skin or skull in the place of the other."""
        for name in OPACITY:
            self._shown.pop(name, None)
        if len(body.triangles):
            self._show(getattr(things, kind)(body, OPACITY[kind]))

    def show_region(self, name: str, body: Body) -> None:
        """Show a no-go region."""
        if len(body.triangles):
            self._show(things.no_go(name, body))

    def show_markers(self) -> None:
        """Show the markers as balls of their size."""
        self._hide("marker ")
        found = self.state.case.fiducials
        for one in found.fiducials if found is not None else ():
            self._show(things.marker(one.label, np.array(one.center), one.diameter_mm))

    def show_path(self, one: Trajectory, measured: Measures | None) -> None:
        """Show a trajectory, and the tube that it keeps within with a chance of 95 %."""
        self.hide_path(one.name)
        for part in things.path(one, measured):
            self._show(part)

    def hide_path(self, name: str) -> None:
        """Take a trajectory and its tube away."""
        self._shown.pop(f"path {name}", None)
        self._shown.pop(f"tube {name}", None)

    def show_proposals(self, found: Proposals | None) -> None:
        """Colour the scalp by the score of each entry."""
        self._hide("map")
        if found is None:
            return
        from ronnaplan.planning.proposals import score_map

        places, scores, allowed = score_map(found)
        if allowed.any():
            colours = np.repeat(_viridis(scores[allowed]), 6, 0)
            self._show(Thing("map", specks(places[allowed], SPECK_MM), colours))

    def show_placement(self, placed: Placement | None) -> None:
        """Show proposed places for markers."""
        self._hide("placement")
        if placed is not None:
            balls = [ball(center, placed.diameter_mm / 2) for center in placed.centers_mm]
            self._show(Thing("placement", joined(balls), things.rgb(PLACEMENT_COLOUR), 0.8))

    def turn(self, across_pixels: float, down_pixels: float) -> None:
        """Turn the camera about the head."""
        self.camera = self.camera.turned(-TURN_DEG_PER_PIXEL * across_pixels, TURN_DEG_PER_PIXEL * down_pixels)

    def zoom(self, factor: float) -> None:
        """Come nearer (factor above 1)."""
        self.camera = self.camera.nearer(factor)

    def draw(self) -> bytes:
        """Return the picture as JPEG: what is opaque, then what is seen through, the skin or skull last."""
        import cv2

        rows, columns = self.shape
        if self.state.case.dragging:
            share = min(1.0, (MOST_DRAGGED_PIXELS / (rows * columns)) ** 0.5)
            rows, columns = max(1, round(share * rows)), max(1, round(share * columns))
        shown = sorted(self._shown.values(), key=lambda one: one.name in OPACITY)
        picture = filled_in(shown, self.camera, (rows, columns), things.rgb(BACKGROUND))
        shades = np.ascontiguousarray(picture[..., 2::-1])
        return bytes(cv2.imencode(".jpg", shades, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1])

    def _show(self, one: Thing) -> None:
        self._shown[one.name] = one

    def _hide(self, beginning: str) -> None:
        for name in [name for name in self._shown if name.startswith(beginning)]:
            del self._shown[name]


def _viridis(scores: FloatArray) -> FloatArray:
    """Return colours (N, 3) for scores from the least to the greatest."""
    import cv2

    share = (scores - scores.min()) / max(float(np.ptp(scores)), 1e-9)
    levels = (255 * share).astype(np.uint8)[:, np.newaxis]
    return np.asarray(cv2.applyColorMap(levels, cv2.COLORMAP_VIRIDIS)[:, 0, ::-1] / 255.0)
