"""What one face of the program warns of or refuses, the others do, too."""

from __future__ import annotations

import html
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ronnaplan.case.expectation import expectation
from ronnaplan.case.folder import CaseFiles, read_case
from ronnaplan.case.surroundings import Rules, Surroundings, Terrain, scan_doubts
from ronnaplan.cli import main
from ronnaplan.ct.volume import VolumeFlag
from ronnaplan.documents.plan import change_plan, read_plan, write_plan
from ronnaplan.documents.reading import to_json
from ronnaplan.documents.registration import read_registration
from ronnaplan.errors import InputError
from ronnaplan.geometry import FloatArray
from ronnaplan.localization.fiducials import FiducialFlag
from ronnaplan.planner.panels import chosen_path, registration_panel
from ronnaplan.planner.state import PlannerState
from ronnaplan.planner.storage import Storage
from ronnaplan.planning import INSTRUMENTS, Landmarks, Limits, Plan, Trajectory
from ronnaplan.planning.angles import RAS_IN_LPS
from ronnaplan.report import marker_part
from ronnaplan.report.html import html_of
from ronnaplan.report.quality import quality_report
from ronnaplan.report.registration_part import registration_part
from tests import cases
from tests.case.test_one_truth import as_written, figures

pytestmark = pytest.mark.usefixtures("one_scan")
LOST = "1 reading left out: occluded"
FLAGGED = f"marker F1: {FiducialFlag.CUT}"


@pytest.fixture(autouse=True)
def no_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(marker_part, "marker_pictures", lambda *_: [])


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return cases.write_case(tmp_path)


def named(folder: Path) -> list[str]:
    return ["--ct", "ct"] + [
        text for name in ("fiducials", "registration") for text in (f"--{name}", str(folder / f"{name}.json"))
    ]


def report(folder: Path) -> str:
    return html.unescape(quality_report(read_case(CaseFiles.of_folder(folder), cases.volume)))


def planner(folder: Path) -> PlannerState:
    return PlannerState(cases.volume(), Storage.of(str(folder / "plan.json"), None, None))


def doubts(state: PlannerState) -> list[str]:
    """All that the page tells: of the scan above all panels, then beside the trajectory."""
    (path,) = state.case.plan.trajectories
    chosen = chosen_path(state, state.case.judge(path))
    return [*scan_doubts(state.case.volume), *chosen["remarks"], *chosen["doubts"]]


def test_what_is_doubtful_about_scan_markers_and_registration_is_told_by_every_face(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    known = cases.fiducials()
    first = known.fiducials[0].model_copy(update={"flags": ("cut",)})
    flagged = known.model_copy(update={"fiducials": (first, *known.fiducials[1:])})
    (folder / "fiducials.json").write_text(to_json(flagged))
    monkeypatch.setitem(vars(cases.volume()), "flags", (VolumeFlag.LOSSY,))
    rows = cases.write_readings(folder / "readings.csv").read_text().splitlines()
    seen = [f"{row},{'OCCLUDED' if n == 6 else 'OK'}" for n, row in enumerate(rows)]
    (folder / "readings.csv").write_text("\n".join(["label,x,y,z,status", *seen[1:]]) + "\n")
    files = [str(folder / name) for name in ("fiducials.json", "readings.csv")]
    assert main(["register", *files, "-o", str(folder / "registration.json")]) == 0
    found = read_registration(folder / "registration.json")
    alone = "CT markers without a partner: F6"
    assert found.notes[0] == LOST
    assert alone in found.doubts
    told = capsys.readouterr().err
    assert all(f"warning: {sentence}\n" in told for sentence in (FLAGGED, LOST, alone))
    expected = [
        f"the scan: {VolumeFlag.LOSSY}",
        *(f"registration: {sentence}" for sentence in (*found.notes, *found.doubts)),
        FLAGGED,
    ]
    for action in (["check"], ["propose", "--target", "-20", "5", "20", "--coordinates", "LPS"]):
        name = ["other"] if action[0] == "propose" else []
        assert main(["plan", action[0], str(folder / "plan.json"), *name, *action[1:], *named(folder)]) == 0
        assert [
            line.removeprefix("ronnaplan: warning: ") for line in capsys.readouterr().err.splitlines()
        ] == expected
    page = report(folder)
    assert all(f"<li>{sentence}</li>" in page for sentence in expected)
    state = planner(folder)
    assert doubts(state) == expected
    assert registration_panel(state)["doubts"] == [*found.notes, *found.doubts]


def test_an_entry_deep_beneath_the_scalp_is_doubted_by_every_face(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """As a click in the brain makes it: every limit is kept by what is left of the path."""
    path = str(folder / "plan.json")
    inward = read_plan(path).trajectory("left").inward
    deep = [str(value) for value in cases.ENTRY_MM + 40.0 * inward]
    edit = ["plan", "edit", path, "left", "--ct", "ct", "--entry", *deep, "--coordinates", "LPS"]
    assert main(edit) == 0
    warned = capsys.readouterr().err
    state = planner(folder)
    judged = state.case.judge(state.case.plan.trajectory("left"))
    assert judged.measures is not None
    assert judged.measures.entry_below_scalp_mm is not None
    said = f"the entry lies {judged.measures.entry_below_scalp_mm:.0f} mm beneath the scalp"
    assert f"left: {said}" in warned
    assert sum(one.startswith(said) for one in doubts(state)) == 1
    assert said in chosen_path(state, judged)["spoken"]
    assert main(["plan", "check", path, *named(folder)]) == 0
    assert f"warning: left: {said}" in capsys.readouterr().err
    page = report(folder)
    assert f"<li>trajectory left: {said}" in page
    assert f"<td>{len(judged.verdicts)} kept, doubted</td>" in page


def test_the_planner_tells_what_was_left_out_of_the_readings_it_loads(folder: Path) -> None:
    rows = cases.write_readings(folder / "readings.csv").read_text().splitlines()
    seen = [f"{row},{'OCCLUDED' if n == 6 else 'OK'}" for n, row in enumerate(rows)]
    (folder / "readings.csv").write_text("\n".join(["label,x,y,z,status", *seen[1:]]) + "\n")
    state = planner(folder)
    state.registering.load_readings("readings.csv")
    assert registration_panel(state)["doubts"][0] == LOST
    assert f"registration: {LOST}" in doubts(planner(folder))


def test_the_errors_of_a_registration_are_told_of_the_plan_as_it_is_now(folder: Path) -> None:
    cases.write_readings(folder / "readings.csv")
    state = planner(folder)
    state.registering.load_readings("readings.csv")
    state.case.rename("left", "right")
    told = {name for name, _ in registration_panel(state)["errors"]}
    assert told == {"right entry", "right target"}
    body = "".join(html_of(registration_part(read_case(CaseFiles.of_folder(folder), cases.volume)).body))
    assert all(name in body for name in told)
    assert "left entry" not in body


def test_documents_beside_the_plan_that_were_not_named_are_told(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "limits.json").write_text(json.dumps({"format": "ronnaplan.limits", "version": 1}))
    assert main(["plan", "check", str(folder / "plan.json"), "--ct", "ct"]) == 0
    told = capsys.readouterr().err
    for option in ("fiducials", "registration", "limits"):
        assert f"{option}.json lies beside the plan and does not count here; name it with --{option}" in told
    assert main(["plan", "check", str(folder / "plan.json"), *named(folder)]) == 0
    assert "beside the plan" in capsys.readouterr().err  # the limits


def test_a_document_that_was_named_and_is_not_there_is_refused_by_every_face(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    gone = str(folder / "gone.json")
    for option in ("--fiducials", "--registration", "--limits"):
        assert main(["plan", "check", str(folder / "plan.json"), "--ct", "ct", option, gone]) == 1
        assert main(["view", "ct", "--plan", str(folder / "plan.json"), option, gone]) == 1
        assert [gone in line for line in capsys.readouterr().err.splitlines() if "warning" not in line] == [
            True,
            True,
        ]


def test_markers_near_a_line_make_a_planned_error_doubtful() -> None:
    known = cases.fiducials()
    line = [
        entry.model_copy(update={"center": (10.0 * n, 0.0, 1.0 * (n == 1))})
        for n, entry in enumerate(known.fiducials)
    ]
    document = known.model_copy(update={"fiducials": tuple(line)})
    (remark,) = expectation(document, None, 0.56, 0.17).remarks
    assert remark.startswith("as planned: the markers' layout leaves a rotation uncertain by more than 8 degrees")
    assert expectation(known, None, 0.56, 0.17).remarks == ()


def test_a_proposal_keeps_its_distance_from_another_path_whatever_that_is_called() -> None:
    terrain, plan = Terrain(cases.volume()), cases.plan()
    around = Surroundings(terrain, Rules(Limits(least_trajectory_distance_mm=2.0)))
    taken: Any = None
    for name in ("other", "new 1"):
        other = plan.edit("left", name=name)
        found = around.propose(
            cases.TARGET_MM + np.array([8.0, 0.0, 0.0]), other, name="new", instrument=INSTRUMENTS["pointer"]
        )
        entries = [one.trajectory.entry_mm.tolist() for one in found.best]
        taken = taken or entries
        assert entries == taken
        for one in found.best:
            assert [near.other for near in one.measures.spacings] == [name]
            assert around.judge(one.trajectory, other).verdicts == one.verdicts


EXACT = ["--sigma-ct", "0.01", "--sigma-ots", "0.1"]


def test_a_proposed_path_is_proposed_with_the_figures_that_plan_check_gives_it(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    proposed: list[Any] = []
    monkeypatch.setattr("ronnaplan.planning.tables.proposals_table", lambda found, _: proposed.append(found))
    given, out, told = named(folder), tmp_path / "measures.json", []
    plan = (folder / "plan.json").read_bytes()
    for options in (given[:2], given[:4], [*given[:4], *EXACT], given):
        (folder / "plan.json").write_bytes(plan)
        target = ["--target", "-20", "5", "20", "--coordinates", "LPS", "--count", "1", "--add"]
        assert main(["plan", "propose", str(folder / "plan.json"), "new", *target, *options]) == 0
        assert main(["plan", "check", str(folder / "plan.json"), *options, "-o", str(out)]) == 0
        (best,) = proposed.pop().best
        (said,) = [one for one in json.loads(out.read_text())["trajectories"] if one["name"] == "new"]
        for written, error in (
            ("expected_error", best.measures.error),
            ("planned_error", best.measures.planned_error),
        ):
            assert figures(said[written], as_written(error)) == as_written(error)
        told.append(error_at_target(said))
    nothing, with_markers, exact_markers, registered = told
    assert nothing is None
    assert with_markers is not None
    assert exact_markers is not None
    assert exact_markers < 0.5 * with_markers
    assert registered != with_markers


def error_at_target(said: dict[str, Any]) -> float | None:
    return None if said["expected_error"] is None else said["expected_error"]["tre_rms_mm"][-1]


BAD = (
    (np.array([30.0, -20.0, 900.0]), np.array([10.0, 5.0, 900.0])),
    (cases.ENTRY_MM, cases.ENTRY_MM + np.array([0.0, 0.0, 12.0])),
)


@pytest.mark.parametrize(("entry_mm", "target_mm", "why"), [(*BAD[0], "outside the scan"), (*BAD[1], "in air")])
def test_a_bad_end_is_refused_by_every_face_in_the_same_words(
    folder: Path, capsys: pytest.CaptureFixture[str], entry_mm: FloatArray, target_mm: FloatArray, why: str
) -> None:
    path, state = folder / "plan.json", planner(folder)
    before = path.read_bytes()
    ends = [
        text
        for name, end in (("entry", entry_mm), ("target", target_mm))
        for text in (f"--{name}", *map(str, end))
    ]
    assert main(["plan", "add", str(path), "bad", "--ct", "ct", *ends, "--coordinates", "LPS"]) == 1
    sentence = capsys.readouterr().err.strip().removeprefix("ronnaplan: ")
    assert why in sentence
    with pytest.raises(InputError) as refused:
        state.add_trajectory(entry_mm, target_mm, "bad")
    assert str(refused.value) == sentence
    assert path.read_bytes() == before
    plan = read_plan(path)
    write_plan(path, Plan(plan.source, plan.voxel_sha256, (Trajectory("bad", entry_mm, target_mm, plan.frame),)))
    assert main(["plan", "check", str(path), *named(folder)]) == 1
    assert sentence in capsys.readouterr().err
    assert f"trajectory bad could not be judged: {sentence}" in report(folder)
    again = planner(folder)
    assert again.case.judge(again.case.plan.trajectory("bad")).problem == sentence


def test_angles_are_told_alike_in_the_frame_that_was_stated(folder: Path) -> None:
    axes = Rotation.from_euler("xyz", [10.0, -20.0, 15.0], degrees=True).as_matrix() @ RAS_IN_LPS
    landmarks = Landmarks(np.array([0.0, -12.0, 5.0]), np.array([0.0, 12.0, 6.0]), np.array([1.0, 0.0, 50.0]))
    change_plan(folder / "plan.json", lambda plan: plan.with_landmarks(landmarks))
    out, numbers = folder / "measures.json", [repr(float(one)) for one in axes.ravel()]
    arguments = [*named(folder), "--frame-axes", *numbers, "-o", str(out)]
    assert main(["plan", "check", str(folder / "plan.json"), *arguments]) == 0
    (said,) = json.loads(out.read_text())["trajectories"]
    expected = {
        "arc, ring of the frame": "{arc_deg:.1f}, {ring_deg:.1f} deg".format(**said["arc_and_ring"]),
        "AC-PC sagittal, coronal angle": "{sagittal_deg:.1f}, {coronal_deg:.1f} deg".format(**said["ac_pc"]),
    }
    rules = Rules(frame_axes=axes)
    page = quality_report(read_case(CaseFiles.of_folder(folder), cases.volume, rules))
    assert all(f"<th>{what}</th><td>{value}</td>" in page for what, value in expected.items())
    state = PlannerState(cases.volume(), Storage.of(str(folder / "plan.json"), None, None), rules)
    shown = dict(chosen_path(state, state.case.judge(state.case.plan.trajectory("left")))["measures"])
    assert expected.items() <= shown.items()
