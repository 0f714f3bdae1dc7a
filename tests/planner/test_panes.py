"""A picture has the pane's own shape and the screen's pixels; its window follows the pointer and the fields."""

from __future__ import annotations

import numpy as np
import pytest

from ronnaplan.errors import UsageError
from ronnaplan.planner.actions import Actions
from ronnaplan.planner.over_cut import over_cut
from ronnaplan.planner.panels import place_line
from ronnaplan.planner.panes import Pane
from ronnaplan.planner.pixels import Pixel
from ronnaplan.planner.pointer import Pointer
from ronnaplan.planner.state import PlannerState
from ronnaplan.planning.electrodes import ELECTRODES
from tests import cases
from tests.planner.conftest import reopened


def test_a_picture_has_the_screens_pixels_and_fewer_of_the_same_shape_where_they_are_too_many() -> None:
    pane = Pane(500.0, 300.0, 2.0)
    assert pane.shape(10**7) == (600, 1000)
    rows, columns = pane.shape(60_000)
    assert rows * columns == pytest.approx(60_000, rel=0.02)
    assert columns / rows == pytest.approx(5 / 3, rel=0.01)
    assert list(pane.halves) == pytest.approx([5 / 3, 1.0])
    assert min(Pane(1.0, 2000.0).shape(100)) >= 16


TITLE = "8.3 mm to target, 63.3 deep: probe's eye"


@pytest.mark.parametrize(
    ("width", "height", "lines"),
    [(340.0, 350.0, 1), (200.0, 240.0, 2), (110.0, 107.0, 2), (110.0, 161.0, 3), (200.0, 40.0, 1)],
)
def test_a_title_has_the_lines_that_it_needs_and_no_name_stands_on_them(
    width: float, height: float, lines: int
) -> None:
    """It was cut where a page was enlarged: where the target is could not be read."""
    pane = Pane(width, height)
    assert pane.title_lines(TITLE) == lines
    assert pane.title_lines("") == pane.title_lines("axial") == 1
    pixel = pane.pixel(1.0)
    assert pane.room(1.0, TITLE).title == pytest.approx((24.0 + 18.0 * (lines - 1)) * pixel)
    highest = pane.names(1.0, TITLE).of_places([{"label": "F1", "x": 0.3, "y": -5.0, "r": 0.0}])
    assert highest[0]["written"]["text"] == ""  # outside the view
    high = pane.halves[1]
    (top,) = pane.names(1.0, TITLE).of_places([{"label": "F1", "x": 0.3, "y": 0.001 - high, "r": 0.0}])
    assert top["written"]["y"] + high >= (24.0 + 18.0 * (lines - 1) + 12.0) * pixel - 1e-9


def test_names_have_the_room_that_the_pages_letters_leave() -> None:
    usual, large = (Pane(900.0, 900.0, em=em).room(100.0) for em in (12.0, 17.0))
    assert large.em / usual.em == pytest.approx(17 / 12)
    assert len(large.shortened("n" * 99)) < len(usual.shortened("n" * 99))


@pytest.mark.parametrize("view", ["axial", "coronal", "sagittal"])
def test_edges_scale_and_reach_are_those_of_the_pane(state: PlannerState, view: str) -> None:
    state.look.field_mm = 200.0
    drawn = over_cut(state, view, False, Pane(900.0, 450.0))
    assert (drawn["wide"], drawn["high"]) == (200.0, 100.0)
    assert drawn["scale"] == 50.0
    cut = state.look.cut(view)
    expected = {"axial": "RLAP", "coronal": "RLSI", "sagittal": "APSI"}
    assert "".join(drawn["letters"]) == expected[view]
    marker = cases.fiducials().fiducials[0]
    place = np.array(marker.center)
    state.look.jump(place)
    state.look.center_mm = place - 150.0 * cut.right  # beyond a square, within the pane
    assert [one["label"] for one in over_cut(state, view, False, Pane(900.0, 450.0))["markers"]] == [marker.label]
    assert over_cut(state, view, False, Pane(450.0, 450.0))["markers"] == []


@pytest.mark.parametrize(
    ("view", "place", "title"),
    [
        ("axial", [0.0, 0.0, 28.0], "axial  S 28.0 mm"),
        ("axial", [0.0, 0.0, 0.04], "axial  0.0 mm"),
        ("coronal", [0.0, -3.0, 28.0], "coronal  A 3.0 mm"),
        ("sagittal", [4.0, 0.0, 28.0], "sagittal  L 4.0 mm"),
        ("sagittal", [-4.0, 0.0, 28.0], "sagittal  R 4.0 mm"),
    ],
)
def test_a_cut_tells_on_which_side_it_lies_without_a_sign(
    state: PlannerState, view: str, place: list[float], title: str
) -> None:
    """A sagittal cut at 4.0 mm would lie on the left by LPS, and on the right by RAS."""
    state.look.jump(place)
    assert over_cut(state, view, False, Pane())["title"] == title


@pytest.mark.parametrize(("share", "told"), [(0.0, "71.6"), (0.75, "17.9"), (1.0, "0.0"), (2.0, "0.0")])
def test_the_probe_s_eye_tells_how_far_the_target_is_as_the_marks_along_the_path_do(
    state: PlannerState, share: float, told: str
) -> None:
    path = state.case.plan.trajectory("left")
    state.look.jump(path.at_depth(share * path.length_mm))
    title = over_cut(state, "probe", False, Pane())["title"]
    assert title == f"{told} mm to target, {min(share, 1.0) * path.length_mm:.1f} deep: probe's eye"


def test_a_cut_that_a_dragged_end_has_passed_tells_so(state: PlannerState) -> None:
    """The cuts stay where they were while an end is dragged: this one was at the target."""
    path = state.case.plan.trajectory("left")
    state.look.jump(path.target_mm)
    state.case.drag("left", "target", path.at_depth(path.length_mm - 5.0))
    title = over_cut(state, "probe", False, Pane())["title"]
    assert title == f"5.0 mm past target, {path.length_mm:.1f} deep: probe's eye"


def test_a_drag_to_the_right_widens_the_window_and_one_up_raises_it(state: PlannerState) -> None:
    pointer = Pointer(state)
    low, high = state.look.window_hu
    before = state.look.crosshair_mm
    pointer.press("axial", Pixel(100.0, 100.0, 500.0, 500.0), window=True)
    pointer.move("axial", Pixel(250.0, 100.0, 500.0, 500.0))
    assert np.subtract(*state.look.window_hu[::-1]) == pytest.approx(1.5 * (high - low), abs=1)
    assert sum(state.look.window_hu) == pytest.approx(low + high, abs=2)
    pointer.move("axial", Pixel(100.0, 40.0, 500.0, 500.0))
    assert sum(state.look.window_hu) / 2 == pytest.approx((low + high) / 2 + 0.2 * (high - low), abs=2)
    assert state.look.window == "own"
    pointer.move("axial", Pixel(-9e4, 9e4, 500.0, 500.0))
    assert state.look.window_hu[0] < state.look.window_hu[1]
    pointer.release()
    assert state.look.crosshair_mm == pytest.approx(before)
    state.look.keep()
    assert reopened(state).look.window_hu == state.look.window_hu


def test_level_and_width_are_typed_and_a_preset_is_known_again(state: PlannerState) -> None:
    set_window = Actions(state, Pointer(state)).by_name()["window_hu"]
    set_window("50", 400)
    assert state.look.window_hu == (-150.0, 250.0)
    set_window(40.0, 80.0)
    assert state.look.window == "brain"
    for level, width in (("x", 1), (40, 0), (1e9, 10)):
        with pytest.raises(UsageError):
            set_window(level, width)
    assert state.look.window == "brain"


def test_what_is_under_the_pointer_is_told_in_both_systems(state: PlannerState) -> None:
    marker = np.array(cases.fiducials().fiducials[2].center)
    state.look.jump(marker)
    state.look.center_mm = marker
    cut = state.look.cut("axial")
    told = place_line(state, Pixel(250.0, 150.0, 500.0, 300.0).place_mm(cut))
    x, y, z = marker
    assert f"LPS {x:.1f}, {y:.1f}, {z:.1f}   RAS {-x:.1f}, {-y:.1f}, {z:.1f}" in told
    assert 50 < float(told.split(" HU")[0]) < 180  # acrylic
    assert place_line(state, np.array([0.0, -0.04, 28.0])).endswith("LPS 0.0, 0.0, 28.0   RAS 0.0, 0.0, 28.0")
    assert place_line(state, Pixel(9000.0, 150.0, 500.0, 300.0).place_mm(cut)).startswith("outside the scan")


def test_only_what_lies_near_the_plane_of_a_trajectory_is_drawn_in_full(state: PlannerState) -> None:
    path = state.case.plan.trajectory("left")
    state.look.jump(path.at_depth(np.array(path.length_mm / 2)))
    (drawn,) = over_cut(state, "axial", False, Pane())["paths"]
    assert drawn["near"] == [False, False]
    cut = state.look.cut("axial")
    share = np.linalg.norm(np.subtract(*drawn["part"])) / np.linalg.norm(
        np.subtract(drawn["entry"], drawn["target"])
    )
    assert share == pytest.approx(6.0 / abs((path.target_mm - path.entry_mm) @ cut.away))
    state.look.jump(path.target_mm - [0.0, 0.0, 20.0])
    (drawn,) = over_cut(state, "axial", False, Pane())["paths"]
    assert drawn["part"] == []
    (drawn,) = over_cut(state, "inline", False, Pane())["paths"]
    assert drawn["part"] == [drawn["entry"], drawn["target"]]


def test_the_first_click_of_a_new_trajectory_shows_until_the_second(state: PlannerState) -> None:
    def points() -> list[str]:
        return [one["label"] for one in over_cut(state, "coronal", False, Pane())["points"]]

    pointer = Pointer(state)
    pointer.add()
    pointer.press("axial", Pixel(200.0, 220.0, 448.0, 448.0))
    assert points() == ["entry"]
    pointer.add()
    assert points() == []


def test_contacts_are_drawn_where_they_lie_near_the_plane(state: PlannerState) -> None:
    state.case.edit("left", electrode=ELECTRODES["DIXI D08-10AM"])
    state.show_path("left")
    (inline,) = over_cut(state, "inline", False, Pane())["paths"]
    assert [one["number"] for one in inline["contacts"]] == list(range(1, 11))
    lower, upper = (np.array(inline["contacts"][n]["ends"]).mean(axis=0) for n in (0, 1))
    assert np.linalg.norm(upper - lower) == pytest.approx(3.5)
    assert inline["contact"] == 0.8
    (axial,) = over_cut(state, "axial", False, Pane())["paths"]
    assert [one["number"] for one in axial["contacts"]] == [1]  # the plane through the target


def test_what_is_jumped_to_is_in_view(state: PlannerState) -> None:
    state.look.field_mm, state.look.center_mm = 40.0, np.array([-60.0, -60.0, 0.0])
    state.jump_to_marker("F2")
    for view in ("axial", "coronal", "sagittal"):
        labels = [one["label"] for one in over_cut(state, view, False, Pane())["markers"]]
        assert labels == ["F2"], view
    state.show_path("left")
    assert state.look.crosshair_mm == pytest.approx(cases.TARGET_MM)
    assert np.abs(state.look.center_mm - cases.TARGET_MM).max() < 18.0
