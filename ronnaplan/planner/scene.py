"""The 3-D view: what is in it, and its picture, drawn here (no graphics hardware, no graphics library)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ronnaplan.geometry import FloatArray
from ronnaplan.planner.cuts import JPEG_QUALITY
from ronnaplan.planner.drawing import MARKER_COLOUR
from ronnaplan.planner.state import PlannerState
from ronnaplan.planning import Measures, Placement, Proposals
from ronnaplan.planning.trajectory import Trajectory
from ronnaplan.scene.camera import Camera
from ronnaplan.scene.shapes import Body, ball, joined, specks, tube

PIXELS, DRAGGED_PIXELS = 640, 320
"""Width and height of the picture, which the browser shrinks; and while an end is dragged, to keep up with the hand."""

TURN_DEG_PER_PIXEL = 0.4
COLOURS = {"skin": "#d9b8a0", "skull": "#e8e0cf"}
BACKGROUND, NO_GO_COLOUR, PLACEMENT_COLOUR = "#0b0e11", "#e53935", "#4fc3f7"
OPACITY = {"skin": 0.55, "skull": 0.8}

THINNEST_MM = 0.5
"""A trajectory is drawn with at least this radius, to be seen."""

SPECK_MM = 1.2
"""Half width of a place of the map of entries."""


@dataclass(frozen=True, eq=False)
class _Shown:
    body: Body
    colour: FloatArray
    opacity: float = 1.0


class Scene:
    """Keeps what is shown, by name; `draw` makes the picture of it."""

    def __init__(self, state: PlannerState) -> None:
        self.state = state
        low, high = state.look.bounds_mm
        middle = (low + high) / 2
        self.camera = Camera(middle + np.array([-0.6, -1.0, 0.5]) * 1.25 * float((high - low).max()), middle)
        self._shown: dict[str, _Shown] = {}

    def show_surface(self, kind: str, vertices_mm: FloatArray, triangles: NDArray[np.int64]) -> None:
        """Show skin or skull in the place of the other."""
        self._shown.pop("surface", None)
        if len(triangles):
            self._show("surface", Body.of(vertices_mm, triangles), COLOURS[kind], OPACITY[kind])

    def show_region(self, name: str, vertices_mm: FloatArray, triangles: NDArray[np.int64]) -> None:
        """Show a no-go region."""
        if len(triangles):
            self._show(f"no-go {name}", Body.of(vertices_mm, triangles), NO_GO_COLOUR, 0.7)

    def show_markers(self) -> None:
        """Show the markers as balls of their size."""
        self._shown.pop("markers", None)
        found = self.state.case.fiducials
        if found is not None and found.fiducials:
            balls = [ball(one.center, one.diameter_mm / 2) for one in found.fiducials]
            self._show("markers", joined(balls), MARKER_COLOUR)

    def show_path(self, one: Trajectory, measured: Measures | None) -> None:
        """Show a trajectory, and the tube that it keeps within with a chance of 95 %."""
        line = tube(np.stack([one.entry_mm, one.target_mm]), max(one.instrument.radius_mm, THINNEST_MM))
        self._show(f"path {one.name}", joined([line, ball(one.target_mm, 2.0)]), one.colour)
        self._shown.pop(f"tube {one.name}", None)
        if measured is not None and measured.error is not None:
            around = tube(one.at_depth(measured.error.depths_mm), measured.error.tube_mm)
            self._show(f"tube {one.name}", around, one.colour, 0.3)

    def hide_path(self, name: str) -> None:
        """Take a trajectory and its tube away."""
        self._shown.pop(f"path {name}", None)
        self._shown.pop(f"tube {name}", None)

    def show_proposals(self, found: Proposals | None) -> None:
        """Colour the scalp by the score of each entry."""
        self._shown.pop("map", None)
        if found is None:
            return
        from ronnaplan.planning.proposals import score_map

        places, scores, allowed = score_map(found)
        if allowed.any():
            self._shown["map"] = _Shown(
                specks(places[allowed], SPECK_MM), np.repeat(_viridis(scores[allowed]), 6, 0)
            )

    def show_placement(self, placed: Placement | None) -> None:
        """Show proposed places for markers."""
        self._shown.pop("placement", None)
        if placed is not None:
            balls = [ball(center, placed.diameter_mm / 2) for center in placed.centers_mm]
            self._show("placement", joined(balls), PLACEMENT_COLOUR, 0.8)

    def turn(self, across_pixels: float, down_pixels: float) -> None:
        """Turn the camera about the head."""
        self.camera = self.camera.turned(-TURN_DEG_PER_PIXEL * across_pixels, TURN_DEG_PER_PIXEL * down_pixels)

    def zoom(self, factor: float) -> None:
        """Come nearer (factor above 1)."""
        self.camera = self.camera.nearer(factor)

    def draw(self) -> bytes:
        """Return the picture as JPEG: what is opaque, then what is seen through, the skin or skull last."""
        import cv2

        pixels = DRAGGED_PIXELS if self.state.case.dragging else PIXELS
        picture = np.broadcast_to(_colour(BACKGROUND).astype(np.float32), (pixels, pixels, 3)).copy()
        depths = self.camera.depths(pixels)
        veils = sorted(
            (one for one in self._shown.items() if one[1].opacity < 1.0), key=lambda one: one[0] == "surface"
        )
        for one in self._shown.values():
            if one.opacity == 1.0:
                self.camera.draw(one.body, one.colour, picture, depths)
        for _, one in veils:
            veiled = picture.copy()
            self.camera.draw(one.body, one.colour, veiled, depths.copy())
            cv2.addWeighted(veiled, one.opacity, picture, 1.0 - one.opacity, 0.0, dst=picture)
        shades = cv2.convertScaleAbs(picture, alpha=255.0)
        return bytes(cv2.imencode(".jpg", shades, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1])

    def _show(self, name: str, body: Body, colour: str, opacity: float = 1.0) -> None:
        self._shown[name] = _Shown(body, _colour(colour), opacity)


def _colour(name: str) -> FloatArray:
    """Return #rrggbb as blue, green, red (3,) from 0 to 1, in OpenCV's order."""
    return np.array([int(name[n : n + 2], 16) for n in (5, 3, 1)]) / 255.0


def _viridis(scores: FloatArray) -> FloatArray:
    """Return colours (N, 3) for scores from the least to the greatest."""
    import cv2

    share = (scores - scores.min()) / max(float(np.ptp(scores)), 1e-9)
    levels = (255 * share).astype(np.uint8)[:, np.newaxis]
    return np.asarray(cv2.applyColorMap(levels, cv2.COLORMAP_VIRIDIS)[:, 0] / 255.0)
