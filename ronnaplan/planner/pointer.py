"""What a press, a drag, a click and a turn of the wheel mean in a view. Places come as pixels of the view."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from ronnaplan.case.edits import ENDS
from ronnaplan.errors import UsageError
from ronnaplan.geometry import FloatArray
from ronnaplan.planner.arguments import Steps
from ronnaplan.planner.cuts import ACROSS, HEAD, PATH_VIEWS
from ronnaplan.planner.measuring import Measuring
from ronnaplan.planner.picking import FINGER, GRAB_PIXELS, Picking
from ronnaplan.planner.pixels import Pixel
from ronnaplan.planner.state import PlannerState
from ronnaplan.scene.camera import Camera
from ronnaplan.scene.cut import Cut

CLICK_PIXELS = 3.0
"""A pointer that moved less between press and release has clicked: an end under it stays where it is."""

ZOOM_STEP = 1.15

ALONG_MM = 1.0
"""A notch of the wheel goes so far along a trajectory."""

NUDGE_PIXELS = 12.0
"""An arrow key turns the head as a drag over so many pixels."""

WINDOW_PIXELS = 300.0
"""A drag over so many pixels changes a window by its own width."""

LEAST_WINDOW_STEP_HU = 0.5
"""A pixel changes even a narrow window by so much."""

NARROWEST_HU, WIDEST_HU, LEVELS_HU = 4.0, 8000.0, (-2000.0, 5000.0)
"""How far a drag can go."""

UNSEEN_PIXELS = 600.0
"""How large a view counts that is clicked without a pointer."""


class Head(Protocol):
    """What shows the head in 3-D."""

    camera: Camera

    def turn(self, across_pixels: float, down_pixels: float) -> None:
        """Turn about the head."""

    def zoom(self, factor: float) -> None:
        """Come nearer (factor above 1)."""

    def look_from(self, direction: FloatArray) -> None:
        """Look at the same place from a direction (3,)."""


class Pointer:
    """Follows one pointer from press to release, in the cuts and, once there is a ``head``, in the 3-D view."""

    def __init__(self, state: PlannerState, head: Head | None = None) -> None:
        self.state, self.head = state, head
        self.picking, self.measuring = Picking(state), Measuring(state)
        self.adding = False
        self._free = False
        self._coarse = 1.0
        self._held: tuple[str, str] | None = None
        self._offset_mm: FloatArray = np.zeros(3)
        self._plane: Cut | None = None
        self._panned_from: FloatArray | None = None
        self._windowed_from: tuple[Pixel, tuple[float, float]] | None = None
        self._turned: list[Pixel] = []
        """Where the pointer was since it took hold of an end, or of the head."""
        self._in_cut = False
        self._tapped: tuple[str, Pixel] | None = None
        """Where a finger went down to click, until it is lifted or moves: it may be the first of two."""

    @property
    def holding(self) -> bool:
        """Whether an end of a trajectory is held."""
        return self._held is not None

    def add(self) -> None:
        """Begin to add a trajectory by two presses, or leave it."""
        self.adding, self.state.look.begun_mm = not self.adding, None
        self.measuring.leave()

    def measure(self, points: int) -> None:
        """Begin to measure between two points, or the angle at the second of three; or leave it."""
        self.adding, self.state.look.begun_mm = False, None
        self.measuring.begin(points)

    @property
    def begun(self) -> bool:
        """Whether points were clicked of what takes more."""
        return self.state.look.begun_mm is not None or bool(self.state.look.measured_mm)

    def take_back(self) -> None:
        """Do without the last point that was clicked of what takes more."""
        self.state.look.begun_mm = None
        self.state.look.measured_mm = self.state.look.measured_mm[:-1]

    def press(
        self,
        view: str,
        at: Pixel,
        *,
        pan: bool = False,
        window: bool = False,
        free: bool = False,
        finger: bool = False,
    ) -> None:
        """Take hold of what is under the pointer: an end of a trajectory, the picture, the crosshair or the head.

        ``pan`` takes hold of the picture whatever is under the pointer, ``window`` of its brightness. An entry goes
        onto the scalp where that is near, unless it is ``free``.
        """
        self._free, self._coarse = free, FINGER if finger else 1.0
        self._plane = self._held = self._panned_from = self._windowed_from = self._tapped = None
        if window and view != HEAD:
            self._windowed_from = at, self.state.look.window_hu
            return
        clicking = (self.adding or self.measuring.wanted > 0) and not (pan or window)
        self._turned = [at] if view == HEAD and not clicking else []
        if view == HEAD and self.head is None:
            return
        if clicking and finger:
            self._tapped = view, at
        elif clicking:
            self._click_point(view, at)
        elif pan and view not in (*PATH_VIEWS, HEAD):
            self._plane = self.state.look.cut(view)
            self._panned_from = at.place_mm(self._plane)
        elif (held := self._end_near(view, at)) is not None:
            self._take(view, at, *held)
        elif view != HEAD:
            self._plane = self.state.look.cut(view)
            if finger:
                self._tapped = view, at
            else:
                self.picking.in_cut(self._plane, at, self._coarse)

    def move(self, view: str, at: Pixel) -> None:
        """Move what is held. The plane stays that of the press, so that the view does not slip from under it."""
        if self._turned:
            last = self._turned[-1]
            self._turned.append(at)
            if self._clicked:
                return
            if self._held is None and self.head is not None:
                self.head.turn(at.x - last.x, at.y - last.y)
        if self._windowed_from is not None:
            self._change_window(at)
        if self._tapped is not None and self._slipped(self._tapped[1], at):
            self._tapped = None
        if self._plane is None or self._tapped is not None:
            return
        place = at.place_mm(self._plane)
        if self._held is not None:
            place = place + self._offset_mm
            if self._held[1] == "entry" and view not in (HEAD, ACROSS) and not self._free:
                place = self.state.look.onto_scalp(place, self._plane)
            self.state.case.drag(*self._held, place)
        elif self._panned_from is not None:
            self.state.look.center_mm = self._plane.center_mm + self._panned_from - place
        else:
            self.state.look.jump(place)

    def release(self, *, whole: bool = True) -> None:
        """Let go and keep what was dragged; a click in the 3-D view picks what is under it, a tap clicks.

        It is not ``whole`` where a second finger came down, which is neither.
        """
        if self._tapped is not None and whole:
            self._click_point(*self._tapped)
        self._tapped = None
        at = self._turned[0] if whole and self._turned and self._clicked else None
        held, in_cut = self._held, self._in_cut
        self._plane = self._held = self._panned_from = self._windowed_from = None
        self._turned = []
        if held is not None:
            self.state.case.end_drag()
        if at is not None and held is not None and not in_cut:
            self.state.look.jump(getattr(self.state.case.plan.trajectory(held[0]), f"{held[1]}_mm"))
        elif at is not None and held is None and self.head is not None:
            self.picking.in_head(self.head.camera, at, self._coarse)

    def wheel(self, view: str, steps: float, at: Pixel, *, zoom: bool = False) -> None:
        """Scroll through the slices, zoom about the pointer, or come nearer to the head."""
        if view == HEAD and self.head is not None:
            self.head.zoom(ZOOM_STEP**-steps)
        if view in PATH_VIEWS:
            self.state.look.along(steps * ALONG_MM)
        if view in (*PATH_VIEWS, HEAD):
            return
        if zoom:
            self.state.look.zoom(view, ZOOM_STEP**-steps, at.place_mm(self.state.look.cut(view)))
        else:
            self.state.look.scroll(view, steps)

    def click(self, view: str, *, free: bool = False) -> None:
        """Press and let go without a pointer: at the crosshair in a cut, in the middle of the 3-D view."""
        across, down = (0.0, 0.0) if view == HEAD else self._on_screen(view, self.state.look.crosshair_mm).tolist()
        half = UNSEEN_PIXELS / 2
        self.press(view, Pixel(half * (1 + across), half * (1 + down), 2 * half, 2 * half), free=free)
        self.release()

    def nudge(self, view: str, across: Steps, down: Steps) -> None:
        """Move the crosshair in a cut by so many millimetres, or turn the head by so many steps."""
        if view == HEAD and self.head is not None:
            self.head.turn(NUDGE_PIXELS * across, NUDGE_PIXELS * down)
        elif view in PATH_VIEWS:
            self.state.look.along(down * ALONG_MM)
        elif view != HEAD:
            self.state.look.nudge(view, across, down)

    def _change_window(self, at: Pixel) -> None:
        """Widen the window as the pointer goes to the right, and raise it as it goes up."""
        assert self._windowed_from is not None
        start, (low, high) = self._windowed_from
        width, level = high - low, (low + high) / 2
        step = max(width, LEAST_WINDOW_STEP_HU * WINDOW_PIXELS) / WINDOW_PIXELS
        width = float(np.clip(width + step * (at.x - start.x), NARROWEST_HU, WIDEST_HU))
        level = float(np.clip(level - step * (at.y - start.y), *LEVELS_HU))
        self.state.look.set_window(round(level - width / 2), round(level + width / 2))

    @property
    def _clicked(self) -> bool:
        return not any(self._slipped(self._turned[0], one) for one in self._turned)

    def _slipped(self, first: Pixel, at: Pixel) -> bool:
        return bool(np.hypot(at.x - first.x, at.y - first.y) > CLICK_PIXELS * self._coarse)

    def _click_point(self, view: str, at: Pixel) -> None:
        if self.measuring.wanted:
            self.measuring.take(self._clicked_place(view, at))
        elif self.adding:  # Escape may have left both since the finger came down
            self._add(view, at)
        elif self._plane is not None:
            self.picking.in_cut(self._plane, at, self._coarse)

    def _add(self, view: str, at: Pixel) -> None:
        if view == HEAD and self.state.look.begun_mm is not None:
            raise UsageError("the target lies inside the head; click it in one of the cuts")
        place = self._clicked_place(view, at)
        if self.state.look.begun_mm is not None:
            self.state.add_trajectory(self.state.look.begun_mm, place)
            self.state.look.begun_mm, self.adding = None, False
            return
        if view != HEAD:
            if not self._free:
                place = self.state.look.onto_scalp(place, self.state.look.cut(view))
            self.picking.require_head(place)
        self.state.look.begun_mm = place

    def _clicked_place(self, view: str, at: Pixel) -> FloatArray:
        """Return the place (3,) under the pointer: in the plane of a cut, or on the surface of the head."""
        if view != HEAD:
            return at.place_mm(self.state.look.cut(view))
        assert self.head is not None
        return self.picking.on_surface(self.head.camera, at)

    def _take(self, view: str, at: Pixel, name: str, end: str) -> None:
        """Hold an end: it keeps its depth behind the screen, and its distance from the pointer."""
        self.state.look.select(name)
        self.state.case.begin_drag(name)
        place = getattr(self.state.case.plan.trajectory(name), f"{end}_mm")
        self._held, self._plane = (name, end), self._plane_of(view, place)
        self._turned, self._in_cut = [at], view != HEAD
        self._offset_mm = place - at.place_mm(self._plane)

    def _plane_of(self, view: str, place_mm: FloatArray) -> Cut:
        if view != HEAD:
            return self.state.look.cut(view)
        assert self.head is not None
        return self.head.camera.plane_at(place_mm)

    def _on_screen(self, view: str, places_mm: FloatArray) -> FloatArray:
        """Return places (..., 3) as (..., 2) on the screen of a view, in halves of its picture."""
        if view == HEAD:
            assert self.head is not None
            return self.head.camera.on_screen(places_mm)[..., :2]
        cut = self.state.look.cut(view)
        halves: FloatArray = cut.on_screen_mm(places_mm)[..., :2] / (cut.field_mm / 2)
        return halves

    def _end_near(self, view: str, at: Pixel) -> tuple[str, str] | None:
        """Return name and end of the trajectory whose end is drawn nearest to the pointer, if it is near."""
        found: list[tuple[float, str, str]] = []
        for one in self.state.case.plan.trajectories:
            if one.locked or (view in PATH_VIEWS and one.name != self.state.look.selected):
                continue  # to select another would turn these views from under the pointer
            away = at.pixels_to(self._on_screen(view, np.stack([one.entry_mm, one.target_mm])))
            found += [(float(distance), one.name, end) for distance, end in zip(away, ENDS, strict=True)]
        nearest = min(found, default=None)
        return None if nearest is None or nearest[0] > GRAB_PIXELS * self._coarse else (nearest[1], nearest[2])
