"""What a press, a drag and a turn of the wheel mean in a cut. Places come as pixels of the view."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ronnaplan.geometry import FloatArray
from ronnaplan.planner.cuts import PATH_VIEWS, Cut
from ronnaplan.planner.state import ENDS, PlannerState

GRAB_PIXELS = 9.0
"""A press this near to an end of a trajectory takes hold of it."""

ZOOM_STEP = 1.15


@dataclass(frozen=True)
class Pixel:
    """A place ``x``, ``y`` in a view of ``width`` x ``height`` pixels, whose square picture is fitted into it."""

    x: float
    y: float
    width: float
    height: float

    def scale_mm(self, cut: Cut) -> float:
        """Millimetres a pixel."""
        return cut.field_mm / max(min(self.width, self.height), 1.0)

    def place_mm(self, cut: Cut) -> FloatArray:
        """Return the place (3,) in LPS under the pixel, in the plane of the cut."""
        scale = self.scale_mm(cut)
        return cut.place_mm((self.x - self.width / 2) * scale, (self.y - self.height / 2) * scale)


class Pointer:
    """Follows one pointer from press to release."""

    def __init__(self, state: PlannerState) -> None:
        self.state = state
        self.adding = False
        self.entry_mm: FloatArray | None = None
        self._held: tuple[str, str] | None = None
        self._depth_mm: FloatArray = np.zeros(3)
        self._cut: Cut | None = None
        self._panned_from: FloatArray | None = None

    def add(self) -> None:
        """Begin to add a trajectory by two presses, or leave it."""
        self.adding, self.entry_mm = not self.adding, None

    def press(self, view: str, at: Pixel, *, pan: bool = False) -> None:
        """Take hold of what is under the pointer: an end of a trajectory, the picture, or the crosshair."""
        cut = self.state.cut(view)
        place = at.place_mm(cut)
        self._cut, self._held, self._panned_from = cut, None, None
        if self.adding:
            self._add(place)
        elif pan and view not in PATH_VIEWS:
            self._panned_from = place
        elif (held := self._end_near(cut, at)) is not None:
            self.state.select(held[0])
            self.state.begin_drag(held[0])
            self._held = held
            end = getattr(self.state.plan.trajectory(held[0]), f"{held[1]}_mm")
            self._depth_mm = float(cut.on_screen_mm(end)[2]) * cut.away
        else:
            self.state.jump(place)

    def move(self, view: str, at: Pixel) -> None:
        """Move what is held. The plane stays that of the press, so that the view does not slip from under it."""
        if self._cut is None or self.adding:
            return
        place = at.place_mm(self._cut)
        if self._held is not None:
            self.state.drag(*self._held, place + self._depth_mm)
        elif self._panned_from is not None:
            self.state.centre_mm = self._cut.centre_mm + self._panned_from - place
        else:
            self.state.jump(place)

    def release(self) -> None:
        """Let go and keep what was done."""
        self.state.end_drag()
        self._cut = self._held = self._panned_from = None
        self.state.save_look()

    def wheel(self, view: str, steps: float, at: Pixel, *, zoom: bool = False) -> None:
        """Scroll through the slices, or zoom about the pointer."""
        if view in PATH_VIEWS:
            return
        if zoom:
            self.state.zoom(view, ZOOM_STEP**-steps, at.place_mm(self.state.cut(view)))
        else:
            self.state.scroll(view, steps)

    def _add(self, place_mm: FloatArray) -> None:
        if self.entry_mm is None:
            self.entry_mm = place_mm
            return
        entry, self.entry_mm, self.adding = self.entry_mm, None, False
        self.state.add_trajectory(entry, place_mm)

    def _end_near(self, cut: Cut, at: Pixel) -> tuple[str, str] | None:
        """Return name and end of the trajectory whose end is drawn nearest to the pointer, if it is near."""
        reach = GRAB_PIXELS * at.scale_mm(cut)
        pointer = cut.on_screen_mm(at.place_mm(cut))[:2]
        found: list[tuple[float, str, str]] = []
        for one in self.state.plan.trajectories:
            if one.locked:
                continue
            for end in ENDS:
                drawn = cut.on_screen_mm(getattr(one, f"{end}_mm"))[:2]
                found.append((float(np.linalg.norm(drawn - pointer)), one.name, end))
        nearest = min(found, default=None)
        return None if nearest is None or nearest[0] > reach else (nearest[1], nearest[2])
