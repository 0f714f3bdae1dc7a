"""What the page may ask for, by name: each action turns the page's values into one call on the state."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, Literal

import numpy as np

from ronnaplan.errors import UsageError
from ronnaplan.geometry import FloatArray
from ronnaplan.planner.arguments import Index, Pixels, Share, Steps, Typed
from ronnaplan.planner.following import LONGEST_S, MOMENT_S
from ronnaplan.planner.opening import SIDES
from ronnaplan.planner.pixels import Pixel
from ronnaplan.planner.pointer import Pointer
from ronnaplan.planner.second import Blend
from ronnaplan.planner.state import PlannerState
from ronnaplan.planning.angles import acpc_from_lps, lps_from_acpc
from ronnaplan.text import LONGEST_NUMBER, plain_number, printable, whole_number

MIDDLE, RIGHT = 1, 2
"""Buttons of a mouse, as browsers number them."""


def key_actions(state: PlannerState, pointer: Pointer) -> dict[str, tuple[str, Callable[[], None]]]:
    """Return what each key does: in words, and the call."""

    def leave() -> None:
        state.registering.leave_pointing()
        pointer.measuring.leave()
        if pointer.adding:
            pointer.add()

    def undo() -> None:
        if pointer.begun:
            pointer.take_back()
        else:
            state.case.undo()

    def remove() -> None:
        if state.look.selected:
            state.case.remove(state.look.selected)

    return {
        "a": ("add a trajectory: click entry, then target", pointer.add),
        "d": ("measure a distance: click two points", lambda: pointer.measure(2)),
        "g": ("measure an angle: click three points", lambda: pointer.measure(3)),
        "escape": ("leave adding, measuring or pointing", leave),
        "ctrl+z": ("undo; first what was clicked last of what takes several clicks", undo),
        "ctrl+y": ("redo", state.case.redo),
        "ctrl+shift+z": ("redo", state.case.redo),
        "delete": ("remove the selected trajectory", remove),
        "f": ("show the whole scan", state.look.fit),
        "s": ("skin or skull in the 3-D view", state.look.other_surface),
        "1": ("bone window", lambda: state.look.choose_window("bone")),
        "2": ("brain window", lambda: state.look.choose_window("brain")),
        "3": ("wide window", lambda: state.look.choose_window("wide")),
        "4": ("markers window", lambda: state.look.choose_window("markers")),
        "pageup": ("axial cut up", lambda: state.look.scroll("axial", -1)),
        "pagedown": ("axial cut down", lambda: state.look.scroll("axial", 1)),
    }


class Actions:
    """The page's actions on one state and one pointer."""

    def __init__(self, state: PlannerState, pointer: Pointer, tracker: tuple[str, int] | None = None) -> None:
        self.state, self.pointer, self.tracker = state, pointer, tracker

    def by_name(self) -> dict[str, Callable[..., Any]]:
        """Return the actions; those that take long only begin."""
        state = self.state
        return {
            "press": self._press,
            "release": self._release,
            "wheel": self._wheel,
            "nudge": self.pointer.nudge,
            "click": self._click,
            "window": state.look.choose_window,
            "window_hu": self._window_hu,
            "layout": state.look.choose_layout,
            "surface": state.look.other_surface,
            "look_from": self._look_from,
            "select": state.show_path,
            "lock": state.case.lock,
            "remove": state.case.remove,
            "rename_path": state.case.rename,
            "place": self._place,
            "place_acpc": self._place_acpc,
            "show_end": self._show_end,
            "colour": self._colour,
            "notes": self._notes,
            "instrument": state.case.choose_instrument,
            "electrode": state.case.choose_electrode,
            "size": self._size,
            "take": self._take,
            "second": self._second,
            "region": self._region,
            "align": lambda: state.other.register(),
            "remove_ruler": state.remove_ruler,
            "show_ruler": state.show_ruler,
            "landmark": self._landmark,
            "jump_landmark": state.jump_to_landmark,
            "jump": state.jump_to_marker,
            "jump_rejected": state.jump_to_rejected,
            "reject": state.case.reject_marker,
            "accept": state.case.accept_marker,
            "rename": state.case.rename_marker,
            "localize": self._localize,
            "propose": state.offers.propose,
            "placement": self._placement,
            "readings": state.registering.load_readings,
            "listen": self._listen,
            "follow": self._follow,
            "pick_reading": state.registering.pick_reading,
        }

    def move(self, view: str, x: Pixels, y: Pixels, width: Pixels, height: Pixels) -> None:
        """Follow the pointer to a pixel of a view."""
        self.pointer.move(view, Pixel(x, y, width, height))

    def _press(
        self,
        view: str,
        x: Pixels,
        y: Pixels,
        width: Pixels,
        height: Pixels,
        button: int,
        shift: bool,
        control: bool = False,
        alt: bool = False,
        finger: bool = False,
    ) -> None:
        at, window = Pixel(x, y, width, height), button == RIGHT or control
        self.pointer.press(view, at, pan=button == MIDDLE or shift, window=window, free=alt, finger=finger)

    def _click(self, view: str, alt: bool) -> None:
        self.pointer.click(view, free=alt)

    def _look_from(self, side: str) -> None:
        """Turn the head so that one looks from a side."""
        if side not in SIDES:
            raise UsageError(f"there is no side {side}; there are {', '.join(SIDES)}")
        if self.pointer.head is not None:
            self.pointer.head.look_from(np.array(SIDES[side]))

    def _window_hu(self, level: Typed, width: Typed) -> None:
        """Take level and width of the window from their fields."""
        half = _number(width) / 2
        self.state.look.set_window(_number(level) - half, _number(level) + half)

    def _release(self, view: str, whole: bool = True) -> None:
        self.pointer.release(whole=whole)

    def _wheel(
        self, view: str, steps: Steps, zoom: bool, x: Pixels, y: Pixels, width: Pixels, height: Pixels
    ) -> None:
        self.pointer.wheel(view, steps, Pixel(x, y, width, height), zoom=zoom)

    def _place(self, name: str, end: Literal["entry", "target"], axis: Literal[0, 1, 2], value: Typed) -> None:
        """Take one coordinate of an end from its field, or all three where they are typed into it."""
        place = _entered(getattr(self.state.case.plan.trajectory(name), f"{end}_mm"), axis, value)
        self.state.case.edit(name, **{f"{end}_mm": place})

    def _place_acpc(self, name: str, axis: Literal[0, 1, 2], value: Typed) -> None:
        """Take the target's way right, anterior or superior of the mid-commissural point from its field, or all."""
        plan = self.state.case.plan
        landmarks = plan.acpc
        place = _entered(acpc_from_lps(landmarks, plan.trajectory(name).target_mm), axis, value)
        self.state.case.edit(name, target_mm=lps_from_acpc(landmarks, place))

    def _show_end(self, name: str, end: Literal["entry", "target"]) -> None:
        """Put the crosshair at an end of a trajectory."""
        self.state.look.show(getattr(self.state.case.plan.trajectory(name), f"{end}_mm"))

    def _colour(self, name: str, colour: str) -> None:
        self.state.case.edit(name, colour=colour.lower())

    def _notes(self, name: str, notes: str) -> None:
        self.state.case.edit(name, notes=notes)

    def _size(self, name: str, size: str, value: Typed) -> None:
        self.state.case.size_instrument(name, size, _number(value))

    def _take(self, index: Index) -> None:
        self.state.offers.take_proposal(index)

    def _landmark(self, which: str, typed: str | None = None) -> None:
        """Set a point of the AC-PC frame: at the crosshair, or where it is typed."""
        self.state.set_landmark(which, self.state.look.crosshair_mm if typed is None else _numbers(typed))

    def _localize(self, diameter: Typed) -> None:
        self.state.localize(_number(diameter))

    def _second(self, share: Share, mode: str) -> None:
        """Show so much of the second image, as its mode says."""
        self.state.look.blend = Blend(share, mode)

    def _region(self, name: str, colour: str, opacity: Share) -> None:
        """Show a region in another colour, with another opacity."""
        self.state.look.show_region(name, colour.lower(), opacity)

    def _placement(self, count: Typed) -> None:
        number = whole_number(str(count))
        if number is None:
            raise UsageError(
                f"'{printable(count, LONGEST_NUMBER)}' is no number of markers; write a whole one such as 6"
            )
        self.state.offers.propose_markers(number)

    def _listen(self) -> None:
        """Listen to the tracker."""
        self.state.registering.listen(*self._tracker)

    def _follow(self) -> None:
        """Follow the tools that the tracker sees, or no longer."""
        from ronnaplan.tracking.openigtlink import moments

        following = self.state.following
        if following.active:
            following.stop()
        else:
            following.start(partial(moments, *self._tracker, every_s=MOMENT_S, seconds=LONGEST_S))

    @property
    def _tracker(self) -> tuple[str, int]:
        if self.tracker is None:
            raise UsageError("no tracker was named; start the planner with --tracker HOST:PORT")
        return self.tracker


def _number(value: Typed) -> float:
    number = plain_number(str(value))
    if number is None:
        raise UsageError(
            f"'{printable(value, LONGEST_NUMBER)}' is not a number; write one such as 12.5, with a point"
        )
    return number


def _entered(place_mm: FloatArray, axis: int, value: Typed) -> FloatArray:
    """Return a place (3,) with one coordinate as it was typed, or all three where they were typed together."""
    parts = _parts(value)
    if len(parts) == len(place_mm):
        return np.array([_number(part) for part in parts])
    place = place_mm.copy()
    place[axis] = _number(value)
    return place


def _numbers(typed: str) -> FloatArray:
    parts = _parts(typed)
    if len(parts) != 3:
        raise UsageError(
            f"'{printable(typed, LONGEST_NUMBER)}' is no place; give x, y, z in LPS mm, such as 12.5, 0, -6"
        )
    return np.array([_number(part) for part in parts])


def _parts(typed: Typed) -> list[str]:
    """Return what stands between semicolons, else between commas, else between blanks.

    Of several kinds only one parts numbers, so that no comma within a number is taken for one between two.
    """
    text = str(typed).strip(" ()[]")
    separator = next((one for one in ";," if one in text), None)
    return [part.strip() for part in text.split(separator)]
