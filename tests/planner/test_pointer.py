"""Presses and drags mean the same millimetres in every view, at every size of the window."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ronnaplan.errors import InputError, UsageError
from ronnaplan.planner.actions import key_actions
from ronnaplan.planner.pixels import Pixel
from ronnaplan.planner.pointer import Pointer
from ronnaplan.planner.state import PlannerState
from tests import cases
from tests.planner.conftest import reopened


def pixel(state: PlannerState, view: str, place: np.ndarray, width: float = 700.0, height: float = 500.0) -> Pixel:
    """The pixel that shows a place, worked out the other way round."""
    cut = state.look.cut(view)
    across, down, _ = cut.on_screen_mm(place)
    pixels_a_mm = min(width, height) / cut.field_mm
    return Pixel(width / 2 + across * pixels_a_mm, height / 2 + down * pixels_a_mm, width, height)


@pytest.mark.parametrize("size", [(700.0, 500.0), (300.0, 900.0)])
@pytest.mark.parametrize("view", ["axial", "coronal", "sagittal"])
def test_a_press_puts_the_crosshair_under_the_pointer(
    state: PlannerState, view: str, size: tuple[float, float]
) -> None:
    place = state.look.crosshair_mm + np.array([11.0, -7.0, 5.0])
    Pointer(state).press(view, pixel(state, view, place, *size))
    away = state.look.cut(view).away
    expected = place - place @ away * away
    assert state.look.crosshair_mm - state.look.crosshair_mm @ away * away == pytest.approx(expected)


@pytest.mark.parametrize("view", ["axial", "coronal", "sagittal", "inline", "probe"])
def test_an_end_is_dragged_within_the_plane_of_the_screen(state: PlannerState, view: str) -> None:
    path = state.case.plan.trajectory("left")
    pointer, cut = Pointer(state), state.look.cut(view)
    pointer.press(view, pixel(state, view, path.target_mm))
    to = path.target_mm + 6.0 * cut.right + 2.0 * cut.down
    for share in (0.3, 1.0):
        pointer.move(view, pixel(state, view, path.target_mm + share * (to - path.target_mm)))
        assert state.look.cut(view).center_mm == pytest.approx(cut.center_mm, abs=0)
    pointer.release()
    moved = state.case.plan.trajectory("left")
    if view != "probe":
        assert moved.target_mm == pytest.approx(to)
        assert moved.entry_mm == pytest.approx(path.entry_mm, abs=0)
    else:  # seen along the path both ends lie on each other; whichever is held moves sideways only
        assert moved.inward @ path.inward > 0.99
    assert np.linalg.norm(moved.target_mm - path.target_mm) + np.linalg.norm(
        moved.entry_mm - path.entry_mm
    ) == pytest.approx(np.hypot(6.0, 2.0))
    assert len(state.case.plan.history) == 2


@pytest.mark.parametrize(("finger", "beside", "slip"), [(False, 8.0, 2.5), (True, 21.0, 7.0)])
def test_a_click_on_an_end_that_slips_a_little_selects_it_and_moves_nothing(
    state: PlannerState, finger: bool, beside: float, slip: float
) -> None:
    """A pixel of a narrow view is a millimetre: a tap on a target would move it by some, and nobody would notice."""
    pointer, plan, before = Pointer(state), state.case.plan, state.look.crosshair_mm
    at = pixel(state, "axial", plan.trajectory("left").target_mm)
    state.look.select(None)
    pointer.press("axial", replace(at, x=at.x + beside), finger=finger)
    assert pointer.holding
    for share in (0.5, 1.0):
        pointer.move("axial", replace(at, x=at.x + beside, y=at.y + share * slip))
    pointer.release()
    assert state.case.plan is plan
    assert state.look.crosshair_mm == pytest.approx(before, abs=0)
    assert state.look.selected == "left"
    pointer.press("axial", replace(at, x=at.x + beside), finger=finger)
    pointer.move("axial", replace(at, x=at.x + beside, y=at.y + 2 * slip))
    pointer.release()
    assert state.case.plan is not plan


def test_a_trajectory_is_made_without_a_pointer(state: PlannerState) -> None:
    pointer, entry = Pointer(state), cases.ENTRY_MM - np.array([0.0, 0.0, 6.0])
    pointer.add()
    for view, place in (("axial", entry), ("coronal", cases.TARGET_MM)):
        state.look.jump(place)
        pointer.click(view, free=True)
    made = state.look.chosen
    assert made is not None
    assert made.entry_mm == pytest.approx(entry)
    assert made.target_mm == pytest.approx(cases.TARGET_MM)
    assert not pointer.holding


def test_two_presses_make_a_trajectory_and_escape_makes_none(state: PlannerState) -> None:
    pointer = Pointer(state)
    pointer.add()
    entry, target = (
        state.look.crosshair_mm + np.array([30.0, 0, 0]),
        state.look.crosshair_mm - np.array([0, 20.0, 0]),
    )
    pointer.press("axial", pixel(state, "axial", entry))
    pointer.release()
    state.look.scroll("axial", 10)
    pointer.press("axial", pixel(state, "axial", target))
    pointer.release()
    made = state.case.plan.trajectory("T1")
    assert made.entry_mm == pytest.approx(entry)
    assert made.target_mm[:2] == pytest.approx(target[:2])
    assert abs(made.target_mm[2] - entry[2]) == pytest.approx(15.0)
    assert not pointer.adding
    pointer.add()
    pointer.add()
    pointer.press("axial", pixel(state, "axial", entry + 40))
    assert len(state.case.plan.trajectories) == 2


def test_a_locked_end_is_not_taken_hold_of(state: PlannerState) -> None:
    state.case.lock("left", True)
    pointer = Pointer(state)
    pointer.press("axial", pixel(state, "axial", cases.TARGET_MM))
    pointer.move("axial", pixel(state, "axial", cases.TARGET_MM + 5))
    pointer.release()
    assert state.case.plan.trajectory("left").target_mm == pytest.approx(cases.TARGET_MM, abs=0)


def test_what_is_panned_stays_under_the_pointer(state: PlannerState) -> None:
    pointer, cut = Pointer(state), state.look.cut("coronal")
    place = cut.place_mm(10.0, 20.0)
    pointer.press("coronal", pixel(state, "coronal", place), pan=True)
    to = Pixel(333.0, 222.0, 700.0, 500.0)
    pointer.move("coronal", to)
    pointer.move("coronal", to)
    assert to.place_mm(state.look.cut("coronal")) == pytest.approx(place)
    assert state.look.crosshair_mm == pytest.approx(cut.center_mm, abs=20.0)


def test_the_wheel_scrolls_or_zooms_about_the_pointer(state: PlannerState) -> None:
    pointer = Pointer(state)
    at = pixel(state, "sagittal", state.look.crosshair_mm + 15.0)
    before = at.place_mm(state.look.cut("sagittal"))
    pointer.wheel("sagittal", -3, at, zoom=True)
    assert at.place_mm(state.look.cut("sagittal")) == pytest.approx(before)
    assert state.look.field_mm < 250.0
    x = state.look.crosshair_mm[0]
    pointer.wheel("sagittal", 2, at)
    assert abs(state.look.crosshair_mm[0] - x) == pytest.approx(3.0)


def test_an_entry_goes_onto_the_scalp_beside_it_unless_it_is_free(state: PlannerState) -> None:
    pointer = Pointer(state)
    pointer.add()
    cut = state.look.cut("axial")
    scalp = np.array([4.0, -95.0, 28.0])
    while state.look.scan.values_hu(scalp[np.newaxis])[0] < -400:  # from in front, until the skin is met
        scalp[1] += 0.1
    beside = scalp + np.array([2.0, -6.0, 0.0])
    pointer.press("axial", pixel(state, "axial", beside))
    found = state.look.begun_mm
    assert found is not None
    assert state.look.scan.values_hu(found[np.newaxis])[0] == pytest.approx(-400, abs=60)
    assert np.linalg.norm(found - beside) <= np.linalg.norm(scalp - beside)
    assert (found - beside) @ cut.away == pytest.approx(0.0)
    pointer.add()
    pointer.add()
    with pytest.raises(UsageError, match="in air"):
        pointer.press("axial", pixel(state, "axial", beside), free=True)
    with pytest.raises(UsageError, match="in air"):
        pointer.press("axial", pixel(state, "axial", scalp + np.array([0.0, -30.0, 0.0])))
    pointer.press("axial", pixel(state, "axial", scalp + np.array([0.0, 40.0, 0.0])))
    assert state.look.begun_mm == pytest.approx(scalp + np.array([0.0, 40.0, 0.0]), abs=0.01)


def test_a_refused_target_leaves_the_entry(state: PlannerState) -> None:
    pointer = Pointer(state)
    pointer.add()
    pointer.press("axial", pixel(state, "axial", np.array([10.0, 5.0, 28.0])))
    with pytest.raises(InputError, match=r"air|outside"):
        pointer.press("axial", pixel(state, "axial", np.array([4.0, -110.0, 28.0])))
    assert pointer.adding
    assert state.look.begun_mm is not None


def test_undo_takes_back_the_click_of_what_is_begun_before_any_change_of_the_plan(state: PlannerState) -> None:
    """Else who clicked an entry wrongly would lose the change made before, and by the next click the way back to it."""
    pointer = Pointer(state)
    undo = key_actions(state, pointer)["ctrl+z"][1]
    state.case.edit("left", notes="mine")
    pointer.add()
    pointer.press("axial", pixel(state, "axial", np.array([10.0, 5.0, 28.0])))
    assert pointer.begun
    undo()
    assert (pointer.adding, pointer.begun, state.look.begun_mm) == (True, False, None)
    pointer.measure(3)
    for place in ([10.0, 5.0, 28.0], [20.0, 5.0, 28.0]):
        pointer.press("axial", pixel(state, "axial", np.array(place)))
    undo()
    assert pointer.measuring.asks == "click the second point"
    undo()
    assert state.case.plan.trajectory("left").notes == "mine"
    undo()
    assert state.case.plan.trajectory("left").notes == ""


def test_moving_the_picture_clicks_no_point_and_a_finger_clicks_as_it_is_lifted(state: PlannerState) -> None:
    pointer, place = Pointer(state), np.array([10.0, 5.0, 28.0])
    at, center = pixel(state, "axial", place), state.look.center_mm.copy()
    aside = replace(at, x=at.x + 40)
    for begin in (pointer.add, lambda: pointer.measure(2)):
        begin()
        pointer.press("axial", at, pan=True)
        pointer.move("axial", aside)
        pointer.release()
        assert not pointer.begun
        assert not np.allclose(state.look.center_mm, center)
        at = pixel(state, "axial", place)
        pointer.press("axial", at, finger=True)
        pointer.release(whole=False)  # a second finger came down
        assert not pointer.begun
        pointer.press("axial", at, finger=True)
        pointer.move("axial", replace(at, x=at.x + 40))
        pointer.release()
        assert not pointer.begun
        pointer.press("axial", at, finger=True)
        assert not pointer.begun
        pointer.release()
        assert pointer.begun
        pointer.take_back()
        pointer.press("axial", at, finger=True)
        begin()  # once more leaves it
        pointer.release()
        assert not pointer.begun


def test_a_finger_goes_somewhere_as_it_is_lifted_or_slides_and_two_fingers_go_nowhere(state: PlannerState) -> None:
    marker = state.case.found.fiducials[2]
    state.look.jump(marker.center)
    before = state.look.crosshair_mm.copy()
    pointer, at = Pointer(state), pixel(state, "axial", np.array(marker.center))
    at = replace(at, x=at.x + 4)
    pointer.press("axial", at, finger=True)
    pointer.move("axial", replace(at, x=at.x + 2))
    pointer.release(whole=False)  # a second finger came down
    assert (state.look.marker, state.look.crosshair_mm.tolist()) == (None, before.tolist())
    pointer.press("axial", at, finger=True)
    pointer.release()
    assert state.look.marker == marker.label
    assert state.look.crosshair_mm == pytest.approx(at.place_mm(state.look.cut("axial")))
    pointer.press("axial", at, finger=True)
    pointer.move("axial", aside := replace(at, x=at.x + 30))
    assert state.look.crosshair_mm == pytest.approx(aside.place_mm(state.look.cut("axial")))


@pytest.mark.parametrize(("finger", "meant"), [(False, None), (True, "F3")])
def test_a_finger_may_come_down_beside_a_marker_in_a_cut(
    state: PlannerState, finger: bool, meant: str | None
) -> None:
    center = np.array(state.case.found.fiducials[2].center)
    state.look.jump(center)
    at = pixel(state, "axial", center, 200.0, 200.0)  # a phone's: the ball has a radius of 5 pixels
    pointer = Pointer(state)
    pointer.press("axial", replace(at, x=at.x + 8), finger=finger)
    pointer.release()
    assert state.look.marker == meant


def test_clicks_measure_a_distance_and_an_angle_that_are_kept_and_undone(state: PlannerState) -> None:
    pointer, middle = Pointer(state), state.look.crosshair_mm.copy()
    corner, one, other = (middle + np.array(off) for off in ([0.0, 0, 0], [0.0, 0, 30.0], [40.0, 0, 0]))
    pointer.measure(2)
    for place in (one, other):
        pointer.press("coronal", pixel(state, "coronal", place))
        pointer.release()
    assert [(ruler.name, ruler.told) for ruler in state.case.plan.rulers] == [("D1", "50.0 mm")]
    assert np.array_equal(state.look.crosshair_mm, middle)  # nothing else was done by these clicks
    pointer.measure(3)
    for place in (one, corner):
        pointer.press("coronal", pixel(state, "coronal", place))
    assert pointer.measuring.asks == "click the third point"
    pointer.add()  # something else is wanted: what was begun is left
    assert not state.look.measured_mm
    pointer.measure(3)
    assert not pointer.adding
    for place in (one, corner, other):
        pointer.press("coronal", pixel(state, "coronal", place))
    assert reopened(state).case.plan.rulers[1].told == "90.0 deg"
    state.remove_ruler("D1")
    state.case.undo()
    assert [ruler.name for ruler in state.case.plan.rulers] == ["D1", "A1"]
    with pytest.raises(UsageError, match="two make a distance"):
        pointer.measure(4)
