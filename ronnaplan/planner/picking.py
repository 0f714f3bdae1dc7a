"""What lies under the pointer: a marker in a cut; a marker, a trajectory or the surface in the 3-D view."""

from __future__ import annotations

import numpy as np

from ronnaplan.errors import UsageError
from ronnaplan.geometry import FloatArray
from ronnaplan.planner.pixels import Pixel
from ronnaplan.planner.state import PlannerState
from ronnaplan.scene.camera import Camera
from ronnaplan.scene.cut import Cut
from ronnaplan.scene.surfaces import SURFACES

GRAB_PIXELS = 9.0
"""A press this near to an end or line of a trajectory takes hold of it."""

FINGER = 2.5
"""A finger is so many times less exact than a mouse."""

ON_SKIN_HU = 250.0
"""A place on the skin's surface has its value but for this, which rounding and steep edges take."""


class Picking:
    """Selects what is clicked in an open case."""

    def __init__(self, state: PlannerState) -> None:
        self.state = state

    def in_cut(self, cut: Cut, at: Pixel, coarse: float) -> None:
        """Go to what is under the pointer, and select the marker that the plane cuts there, if there is one.

        ``coarse`` tells how many times less exact than a mouse the pointer is.
        """
        place = at.place_mm(cut)
        across, down, _ = cut.on_screen_mm(place)
        under: list[tuple[float, str]] = []
        for one in self.state.case.fiducials.fiducials if self.state.case.fiducials else ():
            x, y, away = cut.on_screen_mm(np.array(one.center))
            beside_mm, radius_mm = np.hypot(x - across, y - down), one.diameter_mm / 2
            least_mm = GRAB_PIXELS / 2 * coarse * cut.field_mm / at.side
            if abs(away) < radius_mm and beside_mm <= max(np.sqrt(radius_mm**2 - away**2), least_mm):
                under.append((float(beside_mm), one.label))
        if under:
            self.state.pick_marker(min(under)[1])
        self.state.look.jump(place)

    def in_head(self, camera: Camera, at: Pixel, coarse: float) -> None:
        """Go to what is under the pointer: a marker, a trajectory, or else the surface that is shown.

        ``coarse`` is that of `in_cut`.
        """
        if (label := self._marker_under(camera, at, coarse)) is not None:
            self.state.jump_to_marker(label)
        elif (path := self._path_under(camera, at, coarse)) is not None:
            self.state.look.select(path[0])
            self.state.look.jump(path[1])
        elif (place := self._surface_under(camera, at)) is not None:
            self.state.look.jump(place)

    def on_surface(self, camera: Camera, at: Pixel) -> FloatArray:
        """Return the place (3,) on the surface shown that is under the pointer; raises `UsageError` without one."""
        place = self._surface_under(camera, at)
        if place is None:
            raise UsageError(f"there is no {self.state.look.surface} under the pointer; click on the head")
        return place

    def require_head(self, entry_mm: FloatArray) -> None:
        """Refuse an entry (3,) in the air or outside the scan before a target is asked for."""
        value = float(self.state.look.scan.values_hu(entry_mm[np.newaxis])[0])
        if not value >= SURFACES["skin"].value - ON_SKIN_HU:
            raise UsageError("the entry lies in air or outside the scan; click on the scalp, or near to it")

    def _marker_under(self, camera: Camera, at: Pixel, coarse: float) -> str | None:
        """Return the marker whose ball, or a few pixels about its middle, is under the pointer.

        Of several it is the nearest to the eye among those whose balls are least far beside it.
        """
        under: list[tuple[float, float, str]] = []
        for one in self.state.case.fiducials.fiducials if self.state.case.fiducials else ():
            across, down, depth = camera.on_screen(np.array(one.center))
            radius = one.diameter_mm / camera.plane_at(np.array(one.center)).field_mm * at.side / 2
            away = float(at.pixels_to(np.array([across, down])))
            if depth > 0 and away <= max(radius, GRAB_PIXELS / 2 * coarse):
                under.append((max(away - radius, 0.0), float(depth), one.label))
        return min(under)[2] if under else None

    def _path_under(self, camera: Camera, at: Pixel, coarse: float) -> tuple[str, FloatArray] | None:
        """Return the trajectory drawn under the pointer, and the place on it."""
        (eye_mm, ray), found = camera.ray(*at.halves), []
        for one in self.state.case.plan.trajectories:
            place = one.at_depth(np.array(_depth_beside(eye_mm, ray, one.entry_mm, one.inward, one.length_mm)))
            distance = float(at.pixels_to(camera.on_screen(place)[:2]))
            found.append((distance, one.name, place))
        nearest = min(found, key=lambda one: one[0], default=None)
        return None if nearest is None or nearest[0] > GRAB_PIXELS * coarse else (nearest[1], nearest[2])

    def _surface_under(self, camera: Camera, at: Pixel) -> FloatArray | None:
        return self.state.look.surface_along(*camera.ray(*at.halves))


def _depth_beside(
    eye_mm: FloatArray, ray: FloatArray, start_mm: FloatArray, along: FloatArray, length_mm: float
) -> float:
    """Return how far from ``start_mm`` along the unit vector ``along`` a line comes nearest to a ray."""
    cosine = float(ray @ along)
    if abs(cosine) > 1.0 - 1e-9:  # seen end on: every depth is under the pointer, the first is nearest to the eye
        return 0.0
    between = start_mm - eye_mm
    depth = (cosine * float(between @ ray) - float(between @ along)) / (1.0 - cosine**2)
    return float(np.clip(depth, 0.0, length_mm))
