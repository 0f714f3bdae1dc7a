"""The planner without a browser: what a person does, what is written, and what is found again."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from ronnaplan.case.judgement import Judgement
from ronnaplan.case.surroundings import Rules
from ronnaplan.documents.plan import read_plan, write_plan
from ronnaplan.documents.reading import to_json
from ronnaplan.errors import FrameMismatchError, InputError, RefusedError, UsageError
from ronnaplan.planner.panels import chosen_path, landmark_rows, path_rows
from ronnaplan.planner.state import PlannerState
from ronnaplan.planner.storage import Storage
from ronnaplan.planning import Limits
from ronnaplan.planning.electrodes import ELECTRODES
from tests import cases
from tests.planner.conftest import reopened

E, T = cases.ENTRY_MM, cases.TARGET_MM


def test_a_drag_is_one_step_and_is_found_in_the_file_to_the_last_digit(state: PlannerState) -> None:
    place = T + np.array([3.21, -4.56, 7.89])
    for share in (0.2, 0.7, 1.0):
        state.case.drag("left", "target", T + share * (place - T))
    state.case.end_drag()
    assert state.case.plan.trajectory("left").target_mm == pytest.approx(place, abs=0)
    assert read_plan(state.storage.plan).trajectory("left").target_mm == pytest.approx(place, abs=0)
    state.case.undo()
    assert reopened(state).case.plan.trajectory("left").target_mm == pytest.approx(T, abs=0)
    state.case.redo()
    assert reopened(state).case.plan.trajectory("left").target_mm == pytest.approx(place, abs=0)


def test_everything_is_found_again_after_a_crash(state: PlannerState) -> None:
    name = state.add_trajectory(E + np.array([5, 0, 0]), T)
    assert state.look.crosshair_mm == pytest.approx(T)  # what was added is looked at
    state.look.jump([1.0, 2.0, 3.0])
    state.look.choose_window("brain")
    state.look.choose_layout("four")
    state.look.show_as("bone")
    state.look.zoom("axial", 2.0, T)
    state.look.save()
    state.case.reject_marker("F2")
    state.case.rename_marker("F1", "nose")
    again = reopened(state)
    assert again.look.selected == name == "T1"
    assert (again.look.layout, again.look.preset) == ("four", "bone")
    assert again.look.crosshair_mm == pytest.approx([1.0, 2.0, 3.0])
    assert (again.look.window, again.look.field_mm) == ("brain", state.look.field_mm)
    assert to_json(again.case.fiducials) == to_json(state.case.fiducials)  # type: ignore[arg-type]
    assert [one.label for one in again.case.fiducials.fiducials] == ["nose", "F3", "F4", "F5", "F6"]  # type: ignore[union-attr]


def test_a_damaged_look_is_forgotten_but_a_damaged_plan_is_refused(state: PlannerState) -> None:
    state.storage.look.write_text('{"half": ')
    assert reopened(state).look.window == "bone"
    state.storage.plan.write_text('{"half": ')
    with pytest.raises(InputError, match="not a JSON document"):
        reopened(state)


def test_a_locked_trajectory_cannot_be_moved(state: PlannerState) -> None:
    state.case.lock("left", True)
    with pytest.raises(InputError, match="locked"):
        state.case.drag("left", "target", T + 1)
    with pytest.raises(InputError, match="locked"):
        state.case.edit("left", target_mm=T + 1)
    state.case.lock("left", False)
    state.case.edit("left", target_mm=T + 1)
    assert read_plan(state.storage.plan).trajectory("left").target_mm == pytest.approx(T + 1)


def test_the_measures_follow_the_trajectory_and_limits_are_held_against_it(storage: Storage) -> None:
    state = PlannerState(cases.volume(), storage, Rules(Limits(longest_path_mm=75.0)))
    path = state.case.plan.trajectory("left")
    judged = state.case.judge(path)
    assert judged.measures is not None
    assert judged.measures.length_mm == pytest.approx(np.linalg.norm(E - T))
    assert judged.measures.error is not None
    assert not judged.broken
    state.case.drag("left", "target", T + (T - E) / 10)
    assert [verdict.measure for verdict in state.case.judge(state.case.plan.trajectory("left")).broken] == [
        "path length"
    ]
    state.case.drag("left", "entry", E + np.array([0, 0, 20]))
    assert "lies in air" in state.case.judge(state.case.plan.trajectory("left")).problem


def test_the_list_of_trajectories_says_how_each_was_judged_once_it_is(storage: Storage) -> None:
    limits = Limits(longest_path_mm=100.0, least_trajectory_distance_mm=5.0)
    state = PlannerState(cases.volume(), storage, Rules(limits))
    across, up = np.eye(3)[[0, 2]]

    def told() -> list[str]:
        return [row["verdict"][0] for row in path_rows(state)]

    assert told() == [""]
    state.case.surroundings.judge_all(state.case.plan)
    assert told() == ["kept"]
    state.add_trajectory(E + (T - E) * 0.4, T)
    assert told() == ["breaks 1", ""]  # they meet at the target
    state.case.surroundings.judge_all(state.case.plan)
    assert told() == ["breaks 1", "breaks 1"]
    state.case.edit("T1", target_mm=T - 20.0 * across, entry_mm=T - 20.0 * across + 30.0 * up)
    state.case.surroundings.judge_all(state.case.plan)
    assert told() == ["kept", "doubted"]  # deep beneath the scalp
    state.case.drag("left", "target", T + (T - E) / 10)
    assert told()[0] == ""


def test_a_no_go_region_on_the_path_is_a_broken_limit(storage: Storage) -> None:
    volume = cases.volume()
    mask = np.zeros(volume.voxels_hu.shape, dtype=np.bool_)
    k, j, i = np.rint(volume.grid.indices((E + T) / 2)).astype(int)
    mask[k - 2 : k + 3, j - 2 : j + 3, i - 2 : i + 3] = True
    state = PlannerState(volume, storage, no_go={"vessel": mask})
    assert [one.measure for one in state.case.judge(state.case.plan.trajectory("left")).broken] == [
        "distance to vessel"
    ]


def test_rejecting_markers_changes_the_expected_error(state: PlannerState) -> None:
    def error_mm() -> float:
        measures = state.case.judge(state.case.plan.trajectory("left")).measures
        assert measures is not None
        assert measures.error is not None
        return measures.error.target_rms_mm

    before = error_mm()
    state.case.reject_marker("F2")
    assert error_mm() > before


def test_a_plan_of_another_scan_is_refused(storage: Storage) -> None:
    plan = cases.plan()
    write_plan(storage.plan, replace(plan, source=replace(plan.source, frame_of_reference_uid="9.9")))
    with pytest.raises(FrameMismatchError):
        PlannerState(cases.volume(), storage)


def test_what_cannot_be_done_is_told_in_a_sentence(state: PlannerState) -> None:
    acts: list[Callable[[], object]] = [
        lambda: state.look.select("nobody"),
        lambda: state.case.drag("left", "middle", T),
        lambda: state.look.choose_window("rainbow"),
        lambda: state.look.scroll("front", 1),
        lambda: state.registering.point_at("F1", "1"),
        lambda: state.case.edit("left", target_mm=E),
    ]
    for act in acts:
        with pytest.raises((InputError, UsageError, RefusedError), match=";"):
            act()
    assert read_plan(state.storage.plan).trajectory("left").target_mm == pytest.approx(T, abs=0)


def test_another_diameter_takes_the_place_of_the_markers(state: PlannerState) -> None:
    state.localize(11.5)
    truth = cases.fiducials().points.positions_mm
    found = state.case.fiducials
    assert found is not None
    distances = np.linalg.norm(found.points.positions_mm[:, np.newaxis] - truth, axis=-1)
    assert distances.min(axis=1).max() < 0.05
    assert to_json(reopened(state).case.fiducials) == to_json(found)  # type: ignore[arg-type]


def test_a_trajectory_is_renamed_sized_and_noted(state: PlannerState) -> None:
    state.add_trajectory(E + np.array([0, 40, 0]), T + np.array([0, 40, 0]))
    state.look.select("left")
    state.case.rename("left", " lead A ")
    assert state.look.selected == "lead A"
    state.case.choose_instrument("lead A", "DBS lead")
    state.case.size_instrument("lead A", "diameter", 1.5)
    state.case.size_instrument("lead A", "length", 60.0)
    state.case.choose_electrode("lead A", "Medtronic 3387")
    state.case.edit("lead A", notes="avoid the sulcus", colour="#112233")
    written = read_plan(state.storage.plan).trajectory("lead A")
    assert (written.instrument.name, written.instrument.diameter_mm, written.instrument.length_mm) == (
        ("DBS lead", 1.5, 60.0)
    )
    assert (written.notes, written.colour) == ("avoid the sulcus", "#112233")
    assert written.electrode == ELECTRODES["Medtronic 3387"]
    broken = [one.measure for one in state.case.judge(written).broken]
    assert broken == ["path within the instrument"]
    state.case.choose_electrode("lead A", "none")
    assert read_plan(state.storage.plan).trajectory("lead A").electrode is None
    for _ in range(7):
        state.case.undo()
    assert state.look.selected == "left"
    assert (
        read_plan(state.storage.plan).trajectory("left").instrument == cases.plan().trajectory("left").instrument
    )


def test_a_wrong_name_or_size_changes_nothing(state: PlannerState) -> None:
    state.add_trajectory(E + np.array([5, 0, 0]), T, name="right")
    before = state.storage.plan.read_text()
    acts: list[Callable[[], object]] = [
        lambda: state.case.rename("left", "right"),
        lambda: state.case.rename("left", "  "),
        lambda: state.case.choose_instrument("left", "spoon"),
        lambda: state.case.choose_electrode("left", "D08"),
        lambda: state.case.size_instrument("left", "diameter", 0.0),
        lambda: state.case.size_instrument("left", "length", float("nan")),
        lambda: state.case.size_instrument("left", "weight", 1.0),
        lambda: state.case.edit("left", colour="red"),
    ]
    for act in acts:
        with pytest.raises((InputError, UsageError)):
            act()
    state.case.lock("left", True)
    with pytest.raises(InputError, match="locked"):
        state.case.rename("left", "other")
    state.case.undo()
    assert [one.name for one in read_plan(state.storage.plan).trajectories] == ["left", "right"]
    assert read_plan(state.storage.plan).trajectories[0].instrument.diameter_mm == 1.0
    assert json.loads(before)["trajectories"] == json.loads(state.storage.plan.read_text())["trajectories"]


def test_three_points_make_the_ac_pc_frame_and_its_angles(state: PlannerState) -> None:
    state.set_landmark("PC", np.array([0.0, 24.0, 10.0]))
    state.set_landmark("AC", np.array([0.0, 0.0, 10.0]))
    assert state.case.plan.landmarks is None
    again = reopened(state)
    assert again.landmarks_mm["AC"] == pytest.approx([0.0, 0.0, 10.0])
    again.set_landmark("midline", np.array([0.0, 10.0, 60.0]))
    written = read_plan(state.storage.plan).landmarks
    assert written is not None
    assert written.pc_mm == pytest.approx([0.0, 24.0, 10.0])
    measures = again.case.judge(again.case.plan.trajectory("left")).measures
    assert measures is not None
    assert measures.acpc is not None
    out = E - T  # the frame is square to the scan: right is -x, anterior -y, superior z
    assert measures.acpc.sagittal_deg == pytest.approx(np.degrees(np.arctan2(out[2], -out[1])))
    assert measures.acpc.coronal_deg == pytest.approx(np.degrees(np.arctan2(-out[0], out[2])))
    assert measures.acpc.target_mm == pytest.approx((-T[0], -(T[1] - 12.0), T[2] - 10.0))
    shown = dict(chosen_path(again, again.case.judge(again.case.plan.trajectory("left")))["measures"])
    assert shown["AC-PC sagittal, coronal angle"].startswith(f"{measures.acpc.sagittal_deg:.1f}, ")
    assert shown["arc, ring of the frame"].endswith(" deg")
    heads, *rows = chosen_path(again, again.case.judge(again.case.plan.trajectory("left")))["errors"]
    assert heads == ("expected error", "as planned")
    assert measures.error is not None
    assert ("at the target", f"{measures.error.target_rms_mm:.2f} mm RMS") in rows
    assert rows[-1][0] == "with"


def test_points_of_the_ac_pc_frame_are_undone_and_refused_on_one_line(state: PlannerState) -> None:
    for name, place in {"AC": [0.0, 0.0, 10.0], "PC": [0.0, 24.0, 10.0]}.items():
        state.set_landmark(name, np.array(place))
    with pytest.raises(InputError, match="lie on one line"):
        state.set_landmark("midline", np.array([0.0, 50.0, 10.0]))
    assert [row["name"] for row in landmark_rows(state) if row["place"]] == ["AC", "PC"]
    state.set_landmark("midline", np.array([0.0, 10.0, 60.0]))
    state.set_landmark("AC", np.array([1.0, 0.0, 10.0]))
    assert state.landmarks_mm["AC"][0] == 1.0
    state.jump_to_landmark("AC")
    assert state.look.crosshair_mm == pytest.approx([1.0, 0.0, 10.0])
    state.case.undo()
    assert state.landmarks_mm["AC"][0] == 0.0
    state.case.undo()
    assert read_plan(state.storage.plan).landmarks is None
    assert set(state.landmarks_mm) == {"AC", "PC"}
    with pytest.raises(UsageError, match="midline is not set"):
        state.jump_to_landmark("midline")
    with pytest.raises(UsageError, match="no point XY"):
        state.set_landmark("XY", T)
    with pytest.raises(InputError, match=r"^AC is \[2000000.0, 0.0, 0.0\], beyond"):
        state.set_landmark("AC", np.array([2e6, 0.0, 0.0]))


def test_a_limit_on_what_is_not_known_is_told_beside_the_measures(storage: Storage) -> None:
    state = PlannerState(cases.volume(), storage, Rules(Limits(least_no_go_distance_mm=3.0)))
    judged = state.case.judge(cases.plan().trajectory("left"))
    assert "no label map is given" in judged.problem
    assert judged.measures is not None
    assert judged.verdicts == ()


def test_doubts_about_the_measures_are_told(state: PlannerState) -> None:
    judged = state.case.judge(state.case.plan.trajectory("left"))
    assert judged.measures is not None
    scalp = judged.measures.crossings.scalp
    assert scalp is not None
    blurred = replace(judged.measures.crossings, scalp=replace(scalp, clear=False))
    doubtful = Judgement(replace(judged.measures, crossings=blurred))
    assert any("scalp is not clear here" in doubt for doubt in chosen_path(state, doubtful)["doubts"])
