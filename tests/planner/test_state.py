"""The planner without a browser: what a person does, what is written, and what is found again."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from ronnaplan.case.surroundings import Judgement, Rules
from ronnaplan.documents.plan import read_plan, write_plan
from ronnaplan.documents.reading import to_json
from ronnaplan.errors import FrameMismatchError, InputError, RefusedError, UsageError
from ronnaplan.geometry import Points
from ronnaplan.planner.over_cut import over_cut
from ronnaplan.planner.panels import chosen_path, landmark_rows, placement_line, proposal_rows
from ronnaplan.planner.panes import Pane
from ronnaplan.planner.state import PlannerState
from ronnaplan.planner.storage import Storage
from ronnaplan.planning import Limits
from ronnaplan.planning.electrodes import ELECTRODES
from ronnaplan.planning.uncertainty import ExpectedPose
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


def test_the_view_does_not_jump_when_an_end_is_dragged(state: PlannerState) -> None:
    before = {view: state.look.cut(view).center_mm for view in ("axial", "coronal", "sagittal")}
    state.case.drag("left", "target", T + 9)
    state.case.end_drag()
    for view, center in before.items():
        assert state.look.cut(view).center_mm == pytest.approx(center, abs=0)


def test_the_place_under_the_pointer_stays_there_when_zooming(state: PlannerState) -> None:
    state.look.jump(T)
    before = state.look.cut("coronal").on_screen_mm(T) / state.look.field_mm
    state.look.zoom("coronal", 1.7, T)
    after = state.look.cut("coronal").on_screen_mm(T) / state.look.field_mm
    assert after == pytest.approx(before)
    for _ in range(50):
        state.look.zoom("axial", 1.7, T)
    assert state.look.field_mm == 10.0
    state.look.fit()
    assert state.look.field_mm == pytest.approx(256 * 250 / 256, rel=0.01)


def test_the_cuts_are_linked_by_the_crosshair(state: PlannerState) -> None:
    state.look.jump([10.0, 20.0, 30.0])
    for view in ("axial", "coronal", "sagittal"):
        assert state.look.cut(view).on_screen_mm(state.look.crosshair_mm)[2] == pytest.approx(0.0, abs=1e-9)
    state.look.scroll("axial", 2)
    assert abs(state.look.crosshair_mm[2] - 30.0) == pytest.approx(2 * 1.5)
    for _ in range(500):
        state.look.scroll("axial", 1)
    low, high = state.look.bounds_mm
    assert low[2] <= state.look.crosshair_mm[2] <= high[2]


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


def test_a_no_go_region_on_the_path_is_a_broken_limit(storage: Storage) -> None:
    volume = cases.volume()
    mask = np.zeros(volume.voxels_hu.shape, dtype=np.bool_)
    k, j, i = np.rint(volume.grid.indices((E + T) / 2)).astype(int)
    mask[k - 2 : k + 3, j - 2 : j + 3, i - 2 : i + 3] = True
    state = PlannerState(volume, storage, no_go={"vessel": mask})
    assert [one.measure for one in state.case.judge(state.case.plan.trajectory("left")).broken] == [
        "distance to vessel"
    ]


def test_a_label_map_is_shown_and_judges_nothing(storage: Storage) -> None:
    volume = cases.volume()
    mask = np.zeros(volume.voxels_hu.shape, dtype=np.bool_)
    k, j, i = np.rint(volume.grid.indices((E + T) / 2)).astype(int)
    mask[k - 4 : k + 5, j - 4 : j + 5, i - 4 : i + 5] = True
    state = PlannerState(volume, storage, no_go={"vessel": mask}, labels={"vessel": mask, "tumor": mask})
    about = [one.measure for one in state.case.judge(state.case.plan.trajectory("left")).verdicts]
    assert "distance to vessel" in about
    assert not any("tumor" in measure for measure in about)
    state.look.jump((E + T) / 2)
    drawn = over_cut(state, "axial", False, Pane())["regions"]
    assert [one["name"] for one in drawn] == ["vessel", "vessel (shown only)", "tumor"]
    assert len({one["colour"] for one in drawn}) == 3
    page, other = state.beside(), state.beside()
    page.look.show_region("tumor", "#123456", 0.0)
    assert "tumor" not in [one["name"] for one in over_cut(page, "axial", False, Pane())["regions"]]
    assert "tumor" in [one["name"] for one in over_cut(other, "axial", False, Pane())["regions"]]
    other.look.show_region("vessel", "#654321", 0.5)
    plain = PlannerState(volume, storage)
    plain.look.save()
    again = PlannerState(volume, storage, labels={"vessel": mask, "tumor": mask}).look.regions
    assert [(one.colour, one.opacity) for one in again.values()] == [("#654321", 0.5), ("#123456", 0.0)]


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


def test_without_a_trajectory_there_is_nothing_to_look_along(state: PlannerState) -> None:
    state.case.remove("left")
    assert state.look.selected is None
    with pytest.raises(UsageError, match="select one"):
        state.look.cut("inline")
    state.case.undo()
    assert state.look.selected == "left"
    assert state.look.cut("probe").away == pytest.approx(state.case.plan.trajectory("left").inward)


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


def test_proposals_hold_only_for_what_they_were_asked_for(state: PlannerState) -> None:
    with pytest.raises(InputError, match="another target"):
        state.offers.take_proposal(0)
    state.offers.propose("left")
    assert state.offers.proposals is not None
    best = state.offers.proposals.best[0].trajectory.entry_mm
    state.add_trajectory(E + np.array([5, 0, 0]), T + np.array([5, 0, 0]))
    assert state.offers.proposals is None  # another trajectory is selected
    with pytest.raises(InputError, match="another target"):
        state.offers.take_proposal(0)
    state.look.select("left")
    assert state.offers.proposals is None  # and there is one more to keep away from
    state.case.undo()
    state.offers.take_proposal(0)
    assert state.case.plan.trajectory("left").entry_mm == pytest.approx(best, abs=0)
    assert state.offers.proposals is not None
    promised, kept = (
        state.offers.proposals.best[0].measures,
        state.case.judge(state.case.plan.trajectory("left")).measures,
    )
    assert kept is not None
    assert kept.error is not None
    assert promised.error is not None
    np.testing.assert_array_equal(promised.error.tre_rms_mm, kept.error.tre_rms_mm)
    assert promised.error.probability == kept.error.probability
    state.case.edit("left", target_mm=T + np.array([0, 0, 1]))
    assert proposal_rows(state) == {"rows": [], "none": ""}
    state.case.undo()
    assert len(proposal_rows(state)["rows"]) > 0
    state.case.reject_marker("F2")
    assert state.offers.proposals is None


def test_marker_places_hold_for_the_trajectories_they_were_asked_for(state: PlannerState) -> None:
    state.offers.propose_markers(4)
    assert state.offers.placement is not None
    assert len(state.offers.placement.centers_mm) == 4
    placed = state.offers.placement
    points = Points(placed.centers_mm, np.zeros((4, 3, 3)), tuple("ABCD"))
    told = ExpectedPose.planned(points).tre_rms_mm([cases.TARGET_MM])
    assert placed.largest_tre_mm == told[0]  # as `plan check` tells it of markers that stand there
    assert "4 places" in placement_line(state)
    state.case.edit("left", target_mm=T + np.array([0, 0, 1]))
    assert placement_line(state) == ""


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
