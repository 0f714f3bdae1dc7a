"""The planner without a browser: what a person does, what is written, and what is found again."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ronnaplan.documents.fiducials import to_json
from ronnaplan.documents.plan import read_plan, write_plan
from ronnaplan.errors import FrameMismatchError, InputError, RefusedError, UsageError
from ronnaplan.geometry import Points
from ronnaplan.planner.state import PlannerState
from ronnaplan.planner.storage import Storage
from ronnaplan.planning import Limits
from tests import cases

E, T = cases.ENTRY_MM, cases.TARGET_MM


@pytest.fixture
def storage(tmp_path: Path) -> Storage:
    cases.write_case(tmp_path)
    (tmp_path / "registration.json").unlink()
    return Storage.of(str(tmp_path / "plan.json"), None, None)


@pytest.fixture
def state(storage: Storage) -> PlannerState:
    return PlannerState(cases.volume(), storage)


def reopened(state: PlannerState) -> PlannerState:
    """The same case as a new process finds it, without any farewell of the old one."""
    return PlannerState(cases.volume(), state.storage)


def test_a_drag_is_one_step_and_is_found_in_the_file_to_the_last_digit(state: PlannerState) -> None:
    place = T + np.array([3.21, -4.56, 7.89])
    for share in (0.2, 0.7, 1.0):
        state.drag("left", "target", T + share * (place - T))
    state.end_drag()
    assert state.plan.trajectory("left").target_mm == pytest.approx(place, abs=0)
    assert read_plan(state.storage.plan).trajectory("left").target_mm == pytest.approx(place, abs=0)
    state.undo()
    assert reopened(state).plan.trajectory("left").target_mm == pytest.approx(T, abs=0)
    state.redo()
    assert reopened(state).plan.trajectory("left").target_mm == pytest.approx(place, abs=0)


def test_everything_is_found_again_after_a_crash(state: PlannerState) -> None:
    name = state.add_trajectory(E + np.array([5, 0, 0]), T)
    state.jump([1.0, 2.0, 3.0])
    state.choose_window("brain")
    state.zoom("axial", 2.0, T)
    state.save_look()
    state.reject_marker("F2")
    state.rename_marker("F1", "nose")
    again = reopened(state)
    assert again.selected == name == "T1"
    assert again.crosshair_mm == pytest.approx([1.0, 2.0, 3.0])
    assert (again.window, again.field_mm) == ("brain", state.field_mm)
    assert to_json(again.fiducials) == to_json(state.fiducials)  # type: ignore[arg-type]
    assert [one.label for one in again.fiducials.fiducials] == ["nose", "F3", "F4", "F5", "F6"]  # type: ignore[union-attr]


def test_a_damaged_look_is_forgotten_but_a_damaged_plan_is_refused(state: PlannerState) -> None:
    state.storage.look.write_text('{"half": ')
    assert reopened(state).window == "bone"
    state.storage.plan.write_text('{"half": ')
    with pytest.raises(InputError, match="not a JSON document"):
        reopened(state)


def test_a_locked_trajectory_cannot_be_moved(state: PlannerState) -> None:
    state.lock("left", True)
    with pytest.raises(InputError, match="locked"):
        state.drag("left", "target", T + 1)
    with pytest.raises(InputError, match="locked"):
        state.edit("left", target_mm=T + 1)
    state.lock("left", False)
    state.edit("left", target_mm=T + 1)
    assert read_plan(state.storage.plan).trajectory("left").target_mm == pytest.approx(T + 1)


def test_the_view_does_not_jump_when_an_end_is_dragged(state: PlannerState) -> None:
    before = {view: state.cut(view).centre_mm for view in ("axial", "coronal", "sagittal")}
    state.drag("left", "target", T + 9)
    state.end_drag()
    for view, centre in before.items():
        assert state.cut(view).centre_mm == pytest.approx(centre, abs=0)


def test_the_place_under_the_pointer_stays_there_when_zooming(state: PlannerState) -> None:
    state.jump(T)
    before = state.cut("coronal").on_screen_mm(T) / state.field_mm
    state.zoom("coronal", 1.7, T)
    after = state.cut("coronal").on_screen_mm(T) / state.field_mm
    assert after == pytest.approx(before)
    for _ in range(50):
        state.zoom("axial", 1.7, T)
    assert state.field_mm == 10.0
    state.fit()
    assert state.field_mm == pytest.approx(256 * 250 / 256, rel=0.01)


def test_the_cuts_are_linked_by_the_crosshair(state: PlannerState) -> None:
    state.jump([10.0, 20.0, 30.0])
    for view in ("axial", "coronal", "sagittal"):
        assert state.cut(view).on_screen_mm(state.crosshair_mm)[2] == pytest.approx(0.0, abs=1e-9)
    state.scroll("axial", 2)
    assert abs(state.crosshair_mm[2] - 30.0) == pytest.approx(2 * 1.5)
    for _ in range(500):
        state.scroll("axial", 1)
    low, high = state.bounds_mm
    assert low[2] <= state.crosshair_mm[2] <= high[2]


def test_the_measures_follow_the_trajectory_and_limits_are_held_against_it(storage: Storage) -> None:
    state = PlannerState(cases.volume(), storage, Limits(longest_path_mm=75.0))
    path = state.plan.trajectory("left")
    judged = state.judge(path)
    assert judged.measures is not None
    assert judged.measures.length_mm == pytest.approx(np.linalg.norm(E - T))
    assert judged.measures.error is not None
    assert not judged.broken
    state.drag("left", "target", T + (T - E) / 10)
    assert [verdict.measure for verdict in state.judge(state.plan.trajectory("left")).broken] == ["path length"]
    state.drag("left", "entry", E + np.array([0, 0, 20]))
    assert "lies in air" in state.judge(state.plan.trajectory("left")).problem


def test_a_no_go_region_on_the_path_is_a_broken_limit(storage: Storage) -> None:
    volume = cases.volume()
    mask = np.zeros(volume.voxels_hu.shape, dtype=np.bool_)
    k, j, i = np.rint(volume.grid.indices((E + T) / 2)).astype(int)
    mask[k - 2 : k + 3, j - 2 : j + 3, i - 2 : i + 3] = True
    state = PlannerState(volume, storage, no_go={"vessel": mask})
    assert [one.measure for one in state.judge(state.plan.trajectory("left")).broken] == ["distance to vessel"]


def test_rejecting_markers_changes_the_expected_error(state: PlannerState) -> None:
    def error_mm() -> float:
        measures = state.judge(state.plan.trajectory("left")).measures
        assert measures is not None
        assert measures.error is not None
        return measures.error.target_rms_mm

    before = error_mm()
    state.reject_marker("F2")
    assert error_mm() > before


def test_readings_are_registered_and_the_error_at_the_target_follows_the_plan(
    state: PlannerState, tmp_path: Path
) -> None:
    cases.write_readings(tmp_path / "readings.csv")
    assert state.storage.readings() == ["readings.csv"]
    state.load_readings("readings.csv")
    assert state.registration is not None
    assert state.registration.status == "unique"
    assert json.loads((tmp_path / "registration.json").read_text())["status"] == "unique"
    before = state.expected_errors_mm()
    state.edit("left", target_mm=T - [0, 0, 60])
    assert state.expected_errors_mm()["left target"] > before["left target"]
    assert state.expected_errors_mm()["left entry"] == before["left entry"]


def test_a_registration_of_markers_since_rejected_predicts_nothing(state: PlannerState, tmp_path: Path) -> None:
    cases.write_readings(tmp_path / "readings.csv")
    state.load_readings("readings.csv")
    assert state.outdated is None
    state.reject_marker("F2")
    assert "F2" in (state.outdated or "")
    assert reopened(state).expected_errors_mm() == state.expected_errors_mm() == {}
    state.load_readings("readings.csv")
    assert state.outdated is None
    assert set(state.expected_errors_mm()) == {"left entry", "left target"}


def test_an_ambiguous_reading_is_settled_by_pointing_at_one_marker(state: PlannerState) -> None:
    found = state.fiducials
    assert found is not None
    rectangle = [(60.0, 40.0, 0.0), (-60.0, 40.0, 0.0), (-60.0, -40.0, 0.0), (60.0, -40.0, 0.0)]
    few = tuple(
        one.model_copy(update={"center": place}) for one, place in zip(found.fiducials, rectangle, strict=False)
    )
    state.fiducials = found.model_copy(update={"fiducials": few})
    seen = cases.TURN.apply(np.array(rectangle)) + cases.SHIFT_MM
    state.register(Points(seen, np.tile(0.01 * np.eye(3), (4, 1, 1)), tuple("abcd"), cases.readings().frame))
    assert state.registration is not None
    assert state.registration.status == "ambiguous"
    assert state.registration.rivals
    assert state.expected_errors_mm() == {}
    state.point_at("F1", "a")
    assert state.registration.status == "unique"
    assert {pair.ct: pair.ots for pair in state.registration.pairs} == {"F1": "a", "F2": "b", "F3": "c", "F4": "d"}


def test_no_file_outside_the_case_is_read(state: PlannerState, tmp_path: Path) -> None:
    outside = tmp_path / "case"
    outside.mkdir()
    cases.write_readings(outside / "readings.csv")
    (tmp_path / "link.csv").symlink_to(outside / "readings.csv")
    for name in ("case/readings.csv", "../readings.csv", str(outside / "readings.csv"), "link.csv"):
        with pytest.raises(UsageError, match="no readings file of this case"):
            state.load_readings(name)


def test_a_plan_of_another_scan_is_refused(storage: Storage) -> None:
    plan = cases.plan()
    write_plan(storage.plan, replace(plan, source=replace(plan.source, frame_of_reference_uid="9.9")))
    with pytest.raises(FrameMismatchError):
        PlannerState(cases.volume(), storage)


def test_what_cannot_be_done_is_told_in_a_sentence(state: PlannerState) -> None:
    for act in (
        lambda: state.select("nobody"),
        lambda: state.drag("left", "middle", T),
        lambda: state.choose_window("rainbow"),
        lambda: state.scroll("front", 1),
        lambda: state.point_at("F1", "1"),
        lambda: state.edit("left", target_mm=E),
    ):
        with pytest.raises((InputError, UsageError, RefusedError), match=";"):
            act()
    assert read_plan(state.storage.plan).trajectory("left").target_mm == pytest.approx(T, abs=0)


def test_without_a_trajectory_there_is_nothing_to_look_along(state: PlannerState) -> None:
    state.remove("left")
    assert state.selected is None
    with pytest.raises(UsageError, match="select one"):
        state.cut("inline")
    state.undo()
    assert state.selected == "left"
    assert state.cut("probe").away == pytest.approx(state.plan.trajectory("left").inward)


def test_another_diameter_takes_the_place_of_the_markers(state: PlannerState) -> None:
    state.replace_markers(state.find_markers(11.5))
    truth = cases.fiducials().points.positions_mm
    found = state.fiducials
    assert found is not None
    distances = np.linalg.norm(found.points.positions_mm[:, np.newaxis] - truth, axis=-1)
    assert distances.min(axis=1).max() < 0.05
    assert to_json(reopened(state).fiducials) == to_json(found)  # type: ignore[arg-type]
