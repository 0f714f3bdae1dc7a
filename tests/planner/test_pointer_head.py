"""What the mouse does in the 3-D view: it picks what is drawn there, and drags without the view moving."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pytest

from ronnaplan.errors import UsageError
from ronnaplan.geometry import FloatArray
from ronnaplan.planner.cuts import HEAD
from ronnaplan.planner.pixels import Pixel
from ronnaplan.planner.pointer import Pointer
from ronnaplan.planner.state import PlannerState
from ronnaplan.scene.camera import Camera
from ronnaplan.scene.surfaces import SURFACES
from tests import cases


@dataclass
class Head:
    """A 3-D view that remembers what was asked of it."""

    camera: Camera
    turned: list[tuple[float, float]] = field(default_factory=list)
    zoomed: float = 1.0

    def turn(self, across_pixels: float, down_pixels: float) -> None:
        self.turned.append((across_pixels, down_pixels))

    def zoom(self, factor: float) -> None:
        self.zoomed *= factor

    def look_from(self, direction: FloatArray) -> None:
        """Not asked for here."""


@pytest.fixture
def head() -> Head:
    middle = np.array([4.0, -3.0, 28.0])
    return Head(Camera(middle + np.array([-240.0, -400.0, 200.0]), middle))


@pytest.fixture
def pointer(state: PlannerState, head: Head) -> Pointer:
    return Pointer(state, head)


def pixel(head: Head, place: np.ndarray, size: tuple[float, float] = (700.0, 500.0)) -> Pixel:
    across, down, _ = head.camera.on_screen(np.asarray(place))
    half = min(size) / 2
    return Pixel(size[0] / 2 + across * half, size[1] / 2 + down * half, *size)


def click(pointer: Pointer, at: Pixel) -> None:
    pointer.press(HEAD, at)
    pointer.move(HEAD, Pixel(at.x + 1, at.y, at.width, at.height))  # hands are not steady
    pointer.release()


@pytest.mark.parametrize("size", [(700.0, 500.0), (300.0, 900.0)])
@pytest.mark.parametrize("end", ["entry", "target"])
def test_an_end_is_dragged_at_its_own_depth(
    state: PlannerState, head: Head, pointer: Pointer, end: str, size: tuple[float, float]
) -> None:
    before, other = cases.ENTRY_MM, cases.TARGET_MM
    if end == "target":
        before, other = other, before
    to = before + head.camera.axes.T @ [12.0, -5.0, 0.0]
    at = pixel(head, before, size)
    pointer.press(HEAD, at)
    for share in (0.5, 1.0):
        pointer.move(HEAD, pixel(head, before + share * (to - before), size))
    pointer.release()
    moved = state.case.plan.trajectory("left")
    assert getattr(moved, f"{end}_mm") == pytest.approx(to)
    assert getattr(moved, "target_mm" if end == "entry" else "entry_mm") == pytest.approx(other, abs=0)
    assert head.turned == []
    assert len(state.case.plan.history) == 2
    state.case.undo()
    assert getattr(state.case.plan.trajectory("left"), f"{end}_mm") == pytest.approx(before, abs=0)


def test_an_end_taken_beside_its_middle_does_not_jump(state: PlannerState, head: Head, pointer: Pointer) -> None:
    at = pixel(head, cases.TARGET_MM)
    pointer.press(HEAD, Pixel(at.x + 4, at.y - 3, at.width, at.height))
    pointer.move(HEAD, Pixel(at.x + 14, at.y - 3, at.width, at.height))
    pointer.release()
    plane = head.camera.plane_at(cases.TARGET_MM)
    moved = state.case.plan.trajectory("left").target_mm - cases.TARGET_MM
    assert moved == pytest.approx(10 * plane.field_mm / 500 * plane.right)


def test_a_click_on_a_marker_selects_it_and_goes_there(state: PlannerState, head: Head, pointer: Pointer) -> None:
    marker = state.case.found.fiducials[2]
    at = pixel(head, np.array(marker.center))
    click(pointer, Pixel(at.x + 2, at.y + 2, at.width, at.height))
    assert state.look.marker == marker.label
    assert state.look.crosshair_mm == pytest.approx(marker.center)
    assert head.turned == []


@pytest.mark.parametrize("finger", [False, True])
def test_a_finger_may_come_down_beside_what_it_means(
    state: PlannerState, head: Head, pointer: Pointer, finger: bool
) -> None:
    marker = state.case.found.fiducials[2]
    at = pixel(head, np.array(marker.center), (200.0, 200.0))  # a phone's: the ball has a radius of 3 pixels
    pointer.press(HEAD, Pixel(at.x + 9, at.y, at.width, at.height), finger=finger)
    pointer.release()
    assert (state.look.marker == marker.label) is finger


def test_of_two_markers_behind_each_other_the_nearer_is_meant(
    state: PlannerState, head: Head, pointer: Pointer
) -> None:
    first, second = state.case.found.fiducials[:2]
    behind = tuple(np.array(first.center) + 40.0 * head.camera.ray(*pixel(head, np.array(first.center)).halves)[1])
    hidden = second.model_copy(update={"center": behind})
    for order in ((first, hidden), (hidden, first)):
        state.case.fiducials = state.case.found.model_copy(update={"fiducials": order})
        click(pointer, pixel(head, np.array(first.center)))
        assert state.look.marker == first.label


def test_a_click_on_a_trajectory_selects_it_and_goes_to_that_place(
    state: PlannerState, head: Head, pointer: Pointer
) -> None:
    state.add_trajectory(cases.ENTRY_MM + np.array([-50, 0, 0]), cases.TARGET_MM + np.array([-50, 0, 0]))
    assert state.look.selected == "T1"
    half_way = (cases.ENTRY_MM + cases.TARGET_MM) / 2
    click(pointer, pixel(head, half_way))
    assert state.look.selected == "left"
    assert state.look.crosshair_mm == pytest.approx(half_way)
    click(pointer, pixel(head, cases.TARGET_MM))
    assert state.look.crosshair_mm == pytest.approx(cases.TARGET_MM)
    assert len(state.case.plan.history) == 2


@pytest.mark.parametrize("surface", ["skin", "skull"])
def test_a_click_on_the_head_goes_to_its_surface(
    state: PlannerState, head: Head, pointer: Pointer, surface: str
) -> None:
    state.look.surface = surface
    eye, ray = head.camera.ray(-0.2, 0.25)
    place = state.look.surface_along(eye, ray)
    assert place is not None
    click(pointer, pixel(head, place))
    assert state.look.crosshair_mm == pytest.approx(place, abs=1e-6)
    values = state.look.scan.values_hu(np.stack([place - 1.0 * ray, place + 1.0 * ray]))
    assert values[0] < SURFACES[surface].value < values[1]
    assert state.look.scan.values_hu(place[np.newaxis])[0] == pytest.approx(SURFACES[surface].value, abs=60.0)
    before = state.look.scan.values_hu(place - np.arange(1.0, 80.0)[:, np.newaxis] * ray)
    assert np.nanmax(before) < SURFACES[surface].value


def test_a_click_beside_the_head_does_nothing(state: PlannerState, head: Head, pointer: Pointer) -> None:
    before = state.look.crosshair_mm
    click(pointer, Pixel(101.0, 1.0, 700.0, 500.0))
    assert state.look.crosshair_mm == pytest.approx(before, abs=0)
    assert head.turned == []


def test_a_drag_beside_the_ends_turns_the_head(state: PlannerState, head: Head, pointer: Pointer) -> None:
    before = state.look.crosshair_mm
    pointer.press(HEAD, Pixel(200.0, 300.0, 700.0, 500.0))
    for x in (201.0, 220.0, 240.0):
        pointer.move(HEAD, Pixel(x, 300.0, 700.0, 500.0))
    pointer.release()
    assert sum(across for across, _ in head.turned) == pytest.approx(39.0)
    assert state.look.crosshair_mm == pytest.approx(before, abs=0)
    pointer.wheel(HEAD, -2, Pixel(200.0, 300.0, 700.0, 500.0))
    assert head.zoomed == pytest.approx(1.15**2)


def test_a_locked_end_is_not_taken_hold_of(state: PlannerState, head: Head, pointer: Pointer) -> None:
    state.case.lock("left", True)
    pointer.press(HEAD, pixel(head, cases.TARGET_MM))
    pointer.move(HEAD, pixel(head, cases.TARGET_MM + 20))
    pointer.release()
    assert state.case.plan.trajectory("left").target_mm == pytest.approx(cases.TARGET_MM, abs=0)
    assert head.turned


def test_an_entry_is_set_on_the_skin_and_the_target_in_a_cut(
    state: PlannerState, head: Head, pointer: Pointer
) -> None:
    pointer.add()
    with pytest.raises(UsageError, match="no skin under the pointer"):
        pointer.press(HEAD, Pixel(101.0, 1.0, 700.0, 500.0))
    entry = state.look.surface_along(*head.camera.ray(0.1, 0.1))
    assert entry is not None
    click(pointer, pixel(head, entry))
    with pytest.raises(UsageError, match="inside the head"):
        pointer.press(HEAD, pixel(head, entry))
    cut = state.look.cut("axial")
    pointer.press("axial", Pixel(350.0, 250.0, 700.0, 500.0))
    pointer.release()
    made = state.case.plan.trajectory("T1")
    assert made.entry_mm == pytest.approx(entry)
    assert made.target_mm == pytest.approx(cut.place_mm(0.0, 0.0))


def test_before_the_head_is_there_the_mouse_does_nothing_in_it(state: PlannerState) -> None:
    pointer, before = Pointer(state), state.look.crosshair_mm
    click(pointer, Pixel(300.0, 300.0, 700.0, 500.0))
    pointer.wheel(HEAD, 1, Pixel(300.0, 300.0, 700.0, 500.0))
    assert state.look.crosshair_mm == pytest.approx(before, abs=0)
