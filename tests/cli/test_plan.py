"""``ronnaplan plan`` from an empty plan to a checked one; a bad call leaves the plan file as it was."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from phantoms.fast import render
from phantoms.output import write_phantom
from phantoms.stack import axial_stack
from ronnaplan.cli import main
from ronnaplan.ct import CTVolume, read_ct
from ronnaplan.documents.measures import MeasuresDocument
from ronnaplan.documents.plan import change_plan, read_plan
from ronnaplan.documents.schemas import schema
from ronnaplan.planning import Trajectory
from ronnaplan.untrusted import checked
from tests import cases
from tests.documents.test_schemas import fits
from tests.planning.heads import layered_head

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "planning.md").read_text(encoding="utf-8")

POINTS = ["--entry", "-20", "10", "77", "--target", "-10", "5", "20", "--coordinates", "LPS"]


@pytest.fixture(scope="module")
def ct(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("scan") / "ct"
    stack = axial_stack(start_mm=-20, stop_mm=90, spacing_mm=2.0, matrix=128, field_of_view_mm=190.0)
    write_phantom(folder, layered_head(), stack, render(layered_head(), stack, seed=1))
    return folder


@pytest.fixture(scope="module")
def begun(ct: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A plan of one trajectory."""
    path = tmp_path_factory.mktemp("begun") / "plan.json"
    assert main(["plan", "new", str(ct), "-o", str(path)]) == 0
    assert main(["plan", "add", str(path), "A", "--ct", str(ct), *POINTS]) == 0
    return path


@pytest.fixture
def plan(begun: Path, tmp_path: Path) -> Path:
    """A copy of it that a test may change."""
    return Path(shutil.copy(begun, tmp_path))


def limits(tmp_path: Path, **values: float) -> str:
    path = tmp_path / "limits.json"
    path.write_text(json.dumps({"format": "ronnaplan.limits", "version": 1, **values}))
    return str(path)


def test_a_plan_is_tied_to_its_scan_and_ras_is_turned_to_lps(plan: Path, ct: Path) -> None:
    ras = ["--entry", "20", "-10", "77", "--target", "10", "-5", "20", "--coordinates", "RAS"]
    assert main(["plan", "add", str(plan), "B", "--ct", str(ct), *ras, "--instrument", "DBS lead"]) == 0
    read = read_plan(plan)
    assert read.frame.uid is not None
    np.testing.assert_allclose(read.trajectory("A").entry_mm, [-20, 10, 77])
    np.testing.assert_array_equal(read.trajectory("A").entry_mm, read.trajectory("B").entry_mm)
    assert read.trajectory("B").instrument.diameter_mm == 1.27


def test_a_plan_with_trajectories_is_not_begun_anew(
    plan: Path, ct: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = plan.read_bytes()
    assert main(["plan", "new", str(ct), "-o", str(plan)]) == 1
    told = capsys.readouterr().err
    assert "holds a plan of 1 trajectory, which would be lost" in told
    assert "go on with it ('plan add'), name another file with -o, or delete it first" in told
    assert plan.read_bytes() == before
    assert main(["plan", "remove", str(plan), "A"]) == 0
    assert main(["plan", "new", str(ct), "-o", str(plan)]) == 0


def test_edit_lock_undo_redo_and_remove(plan: Path, ct: Path, capsys: pytest.CaptureFixture[str]) -> None:
    moved = ["--target", "-8", "4", "18", "--coordinates", "LPS", "--rename", "A2", "--notes", "deeper"]
    assert main(["plan", "edit", str(plan), "A", "--ct", str(ct), *moved]) == 0
    assert main(["plan", "lock", str(plan), "A2"]) == 0
    assert main(["plan", "remove", str(plan), "A2"]) == 1
    assert "locked" in capsys.readouterr().err
    assert main(["plan", "undo", str(plan)]) == 0
    assert main(["plan", "remove", str(plan), "A2"]) == 0
    assert read_plan(plan).trajectories == ()
    assert main(["plan", "undo", str(plan)]) == 0
    assert main(["plan", "undo", str(plan)]) == 0
    assert main(["plan", "redo", str(plan)]) == 0
    assert main(["plan", "list", str(plan)]) == 0
    assert "A2" in capsys.readouterr().out
    assert main(["plan", "list", str(plan), "--history"]) == 0
    assert capsys.readouterr().out.splitlines()[-1].split()[2:] == ["edit", "A2"]


def test_what_changes_nothing_is_no_change(plan: Path, ct: Path, capsys: pytest.CaptureFixture[str]) -> None:
    edit = ["plan", "edit", str(plan), "A", "--ct", str(ct)]
    assert main([*edit, "--notes", "deeper"]) == 0
    before = plan.read_bytes()
    assert main(edit) == 2
    assert "nothing is to be changed in A; give" in capsys.readouterr().err
    assert main([*edit, "--notes", "deeper"]) == 0
    assert main(["plan", "unlock", str(plan), "A"]) == 0
    assert plan.read_bytes() == before


def measures(written: Path) -> Any:
    """Return what a file of measures holds, which fits its published schema."""
    content = json.loads(written.read_text())
    checked(content, MeasuresDocument)  # by the model, which declares every field
    described = schema("measures")
    assert fits(content, described, described["$defs"])
    return content


def test_check_passes_then_refuses_with_a_table(
    plan: Path, ct: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    check = ["plan", "check", str(plan), "--ct", str(ct), "--limits"]
    output = tmp_path / "measures.json"
    assert (
        main([*check, limits(tmp_path, longest_path_mm=80, greatest_skull_angle_deg=30), "-o", str(output)]) == 0
    )
    measured = measures(output)
    (one,) = measured["trajectories"]
    assert one["length_mm"] == pytest.approx(np.linalg.norm([-10, 5, 57]))
    assert 6.0 < one["skull_thickness_mm"] < 7.0
    assert all(verdict["passes"] for verdict in measured["verdicts"])
    capsys.readouterr()
    assert main([*check, limits(tmp_path, longest_path_mm=50)]) == 3
    printed = capsys.readouterr()
    assert "FAIL" in printed.out
    assert "1 of 3 limits are broken" in printed.err


def test_a_check_of_long_names_fits_a_terminal_and_tells_them_apart(
    plan: Path, ct: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    ends = ["--entry", "-22", "10", "77", "--target", "-14", "5", "20", "--coordinates", "LPS"]
    names = [f"left {'n' * 290} {which}" for which in ("first", "second")]
    for name in names:
        assert main(["plan", "add", str(plan), name, "--ct", str(ct), *ends]) == 0
    capsys.readouterr()
    main(["plan", "check", str(plan), "--ct", str(ct)])
    printed = capsys.readouterr().out
    assert max(map(len, printed.splitlines())) < 240
    for end in ("n first", "n second"):
        assert end in printed
    assert main(["plan", "list", str(plan)]) == 0
    assert names[0] in capsys.readouterr().out  # to be named in another command


def test_every_limit_of_the_documentation_s_example_is_judged_in_the_measures(tmp_path: Path) -> None:
    limits, output = tmp_path / "limits.json", tmp_path / "measures.json"
    (example,) = re.findall(r'\{"format": "ronnaplan.limits".*?\}', PAGE, re.DOTALL)
    limits.write_text(example)
    cases.write_case(tmp_path)
    other = Trajectory("other", cases.ENTRY_MM - [60, 0, 0], cases.TARGET_MM - [25, 0, 0], cases.volume().frame)
    change_plan(tmp_path / "plan.json", lambda now: now.add(other))
    beside = ["--fiducials", str(tmp_path / "fiducials.json"), "--limits", str(limits)]
    no_go = ["--no-go", str(cases.write_label_map(tmp_path / "vessel.nii.gz"))]
    check = ["plan", "check", str(tmp_path / "plan.json"), "--ct", str(cases.CT), *beside, *no_go]
    assert main([*check, "-o", str(output)]) == 0
    verdicts = [one for one in measures(output)["verdicts"] if one["trajectory"] == "left"]
    assert {one["measure"]: one["limit"] for one in verdicts if not re.search(r" F\d", one["measure"])} == {
        "way out of the head": None,
        "path within the instrument": 200,
        "path length": 90,
        "angle to skull normal": 30,
        "skull along the path": 12,
        "distance to vessel": 3,
        "distance to metal": 2,
        "distance to other": 4,
        "expected error at target": 1,
        "expected angular error": 1,
        "chance to stay within 2 mm": 0.95,
    }
    assert [one["limit"] for one in verdicts if re.search(r" F\d", one["measure"])] == [5] * 6
    assert [one["passes"] for one in verdicts] == [True] * len(verdicts)


def test_arc_and_ring_follow_the_frame_s_own_axes(plan: Path, ct: Path, tmp_path: Path) -> None:
    output, check = tmp_path / "measures.json", ["plan", "check", str(plan), "--ct", str(ct)]
    found = []
    for axes in ([], ["-0.96", "-0.28", "0", "0.28", "-0.96", "0", "0", "0", "1"]):
        assert main([*check, "-o", str(output), *(["--frame-axes", *axes] if axes else [])]) == 0
        found.append(measures(output)["trajectories"][0]["arc_and_ring"]["arc_deg"])
    outward = np.array([-10, 5, 57]) / np.linalg.norm([-10, 5, 57])
    assert found[0] == pytest.approx(np.degrees(np.arccos(outward @ [-1, 0, 0])))
    assert found[1] == pytest.approx(np.degrees(np.arccos(outward @ [-0.96, -0.28, 0])))


def test_proposals_are_printed_with_reasons_and_the_best_is_added(
    plan: Path, ct: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    target = ["--target", "15", "0", "30", "--coordinates", "LPS"]
    propose = ["plan", "propose", str(plan), "C", "--ct", str(ct), *target, "--limits"]
    assert main([*propose, limits(tmp_path, longest_path_mm=60), "--add", "--count", "2"]) == 0
    out = capsys.readouterr().out
    assert "mm long" in out
    assert read_plan(plan).trajectory("C").length_mm < 60
    assert main([*propose, limits(tmp_path, longest_path_mm=10)]) == 3
    assert "no entry keeps every limit" in capsys.readouterr().err


def test_markers_are_proposed_and_written_for_slicer(
    plan: Path, ct: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "markers.mrk.json"
    ask = ["plan", "markers", "--ct", str(ct), "--plan", str(plan), "--count", "5", "--tracker", "left"]
    assert main([*ask, "-o", str(output)]) == 0
    shown = capsys.readouterr()
    assert "largest expected TRE" in shown.out
    assert "warning: below the middle of the head" in shown.err
    points = json.loads(output.read_text())["markups"][0]["controlPoints"]
    assert [point["label"] for point in points] == ["M1", "M2", "M3", "M4", "M5"]
    assert main(["plan", "markers", "--ct", str(ct), "--count", "5"]) == 1


def test_export_and_import_round_trip(plan: Path, ct: Path, tmp_path: Path) -> None:
    for to, name in (("markups", "lines.mrk.json"), ("csv", "lines.csv")):
        assert main(["plan", "export", str(plan), "--to", to, "-o", str(tmp_path / name)]) == 0
        other = tmp_path / f"{to}.json"
        assert main(["plan", "new", str(ct), "-o", str(other)]) == 0
        assert main(["plan", "import", str(other), str(tmp_path / name), "--ct", str(ct)]) == 0
        np.testing.assert_allclose(read_plan(other).trajectory("A").entry_mm, [-20, 10, 77])


@pytest.mark.parametrize(("to", "name"), [("markups", "x.csv"), ("csv", "x.json"), ("contacts", "x.mrk.json")])
def test_what_is_exported_has_a_name_by_which_it_is_read_again(
    plan: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], to: str, name: str
) -> None:
    assert main(["plan", "export", str(plan), "--to", to, "-o", str(tmp_path / name)]) == 2
    assert "expected a name that ends in" in capsys.readouterr().err
    assert not (tmp_path / name).exists()


def test_a_plan_that_is_exported_as_a_result_is_told_which_command_does_it(
    plan: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["export", str(plan), "--to", "markups"]) == 2
    assert "is a plan; ronnaplan plan export writes its trajectories" in capsys.readouterr().err


def test_an_electrode_is_chosen_measured_exported_and_taken_back(
    plan: Path, ct: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    edit = ["plan", "edit", str(plan), "A", "--ct", str(ct), "--electrode"]
    assert main([*edit, "DIXI D08-05AM"]) == 0
    assert main(["plan", "check", str(plan), "--ct", str(ct), "-o", str(tmp_path / "measures.json")]) == 0
    told = measures(tmp_path / "measures.json")["trajectories"][0]["electrode"]
    assert told["model"] == "DIXI D08-05AM"
    assert told["contacts"][0]["center"] == pytest.approx(read_plan(plan).trajectory("A").contacts_mm[0])
    assert main(["plan", "export", str(plan), "--to", "contacts", "-o", str(tmp_path / "contacts.csv")]) == 0
    assert len((tmp_path / "contacts.csv").read_text().splitlines()) == 6
    capsys.readouterr()
    assert main(["plan", "list", str(plan)]) == 0
    assert "DIXI D08-05AM" in capsys.readouterr().out
    assert main([*edit, "none"]) == 0
    assert read_plan(plan).trajectory("A").electrode is None
    assert main([*edit, "D08"]) == 2
    assert "unknown electrode 'D08'" in capsys.readouterr().err


def test_additions_made_at_the_same_time_are_all_kept(plan: Path, ct: Path) -> None:
    names = [f"B{number}" for number in range(3)]
    adds = [
        [sys.executable, "-m", "ronnaplan", "plan", "add", str(plan), name, "--ct", str(ct), *POINTS]
        for name in names
    ]
    running = [subprocess.Popen(add, env={**os.environ, "PYTHONWARNINGS": "error"}) for add in adds]
    assert [one.wait(timeout=120) for one in running] == [0] * len(names)
    kept = read_plan(plan)
    assert {one.name for one in kept.trajectories} == {"A", *names}
    assert kept.revision == 1 + len(names)
    assert [one.name for one in plan.parent.iterdir()] == ["plan.json"]


def test_an_addition_is_made_to_the_plan_as_it_is_when_it_is_written(
    plan: Path, ct: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def slowly(*given: Any, **options: Any) -> CTVolume:
        change_plan(plan, lambda now: now.edit("A", notes="by another hand"))
        return read_ct(*given, **options)

    monkeypatch.setattr("ronnaplan.ct.read_ct", slowly)
    assert main(["plan", "add", str(plan), "B", "--ct", str(ct), *POINTS]) == 0
    kept = read_plan(plan)
    assert kept.trajectory("A").notes == "by another hand"
    assert kept.trajectory("B").notes == ""


def test_a_proposal_for_a_plan_that_was_changed_meanwhile_is_refused(
    plan: Path, ct: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def slowly(*given: Any, **options: Any) -> CTVolume:
        change_plan(plan, lambda now: now.edit("A", notes="by another hand"))
        return read_ct(*given, **options)

    monkeypatch.setattr("ronnaplan.ct.read_ct", slowly)
    target = ["--target", "15", "0", "30", "--coordinates", "LPS"]
    assert main(["plan", "propose", str(plan), "C", "--ct", str(ct), *target, "--add", "--count", "1"]) == 3
    assert "propose them again" in capsys.readouterr().err
    assert [one.name for one in read_plan(plan).trajectories] == ["A"]


def test_landmarks_are_kept_and_listed(plan: Path, capsys: pytest.CaptureFixture[str]) -> None:
    points = ["--ac", "0", "-12", "10", "--pc", "0", "12", "10", "--midline", "0", "0", "50"]
    assert main(["plan", "landmarks", str(plan), *points, "--coordinates", "LPS"]) == 0
    kept = read_plan(plan).landmarks
    assert kept is not None
    np.testing.assert_array_equal(kept.ac_mm, [0, -12, 10])
    assert main(["plan", "list", str(plan)]) == 0
    told = "AC 0.00, -12.00, 10.00; PC 0.00, 12.00, 10.00; midline 0.00, 0.00, 50.00. AC and PC are 24.0 mm apart."
    assert capsys.readouterr().out.endswith(f"\n\nAC-PC frame, LPS mm: {told}\n")


def test_a_target_is_stated_from_the_mid_commissural_point(
    plan: Path, ct: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scan, from_middle = ["--ct", str(ct)], ["--target-acpc", "-12", "-2", "-4"]
    assert main(["plan", "edit", str(plan), "A", *scan, *from_middle]) == 1
    assert "no AC-PC frame; state AC, PC and a point of the midline first" in capsys.readouterr().err
    points = ["--ac", "1", "-12", "20", "--pc", "1", "12", "20", "--midline", "1", "0", "60"]
    assert main(["plan", "landmarks", str(plan), *points, "--coordinates", "LPS"]) == 0
    assert main(["plan", "edit", str(plan), "A", *scan, *from_middle]) == 0
    assert read_plan(plan).trajectory("A").target_mm == pytest.approx([13.0, 2.0, 16.0])  # left, behind, below
    entry = ["--entry", *POINTS[1:4], "--coordinates", "RAS"]
    assert main(["plan", "add", str(plan), "B", *scan, *from_middle, *entry]) == 0
    assert read_plan(plan).trajectory("B").target_mm == pytest.approx([13.0, 2.0, 16.0])
    other = ["--target-acpc", "12", "-2", "6", "--count", "1", "--add"]
    assert main(["plan", "propose", str(plan), "C", *scan, *other]) == 0
    assert read_plan(plan).trajectory("C").target_mm == pytest.approx([-11.0, 2.0, 26.0])
    assert main(["plan", "edit", str(plan), "A", *scan, *from_middle, "--target", "1", "2", "3"]) == 2


def test_an_empty_plan_does_not_pass_a_check(ct: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """As no export, report or placement takes one: a script would go on with a plan in which nothing was checked."""
    empty, measures = tmp_path / "empty.json", tmp_path / "measures.json"
    assert main(["plan", "new", str(ct), "-o", str(empty)]) == 0
    assert main(["plan", "check", str(empty), "--ct", str(ct), "-o", str(measures)]) == 1
    printed = capsys.readouterr()
    assert "the plan has no trajectory to check; add one first" in printed.err
    assert (printed.out, measures.exists()) == ("", False)


BAD = [
    (["add", "{plan}", "B", "--entry", "-10", "5", "20", *POINTS[4:]], 1, "0.00 mm apart"),
    (["add", "{plan}", "B", "--entry", "0", "0", "300", *POINTS[4:]], 1, "outside the scan"),
    (["add", "{plan}", "B", "--entry", "-20", "10", "88", *POINTS[4:]], 1, "in air"),
    (["add", "{plan}", "B", *POINTS[:4], "--target", "90", "0", "20", *POINTS[8:]], 1, "in air"),
    (["add", "{plan}", "B", *POINTS, "--instrument", "laser"], 2, "unknown instrument 'laser'"),
    (["add", "{plan}", "B", *POINTS, "--diameter", "-2", "--length", "9"], 2, "diameter of -2.0 mm"),
    (["add", "{plan}", "B", *POINTS, "--colour", "Red"], 2, "--colour: 'Red' is no colour; expected #rrggbb"),
    (["add", "{plan}", "B", *POINTS, "--diameter", "2"], 2, "--length"),
    (["add", "{plan}", "B", *POINTS, "--notes", "\udcff"], 1, "notes: holds characters that are no text"),
    (["add", "{plan}", "B", *POINTS[:-2]], 2, "--coordinates"),
    (["add", "{plan}", "A", *POINTS], 1, "already has"),
    (["edit", "{plan}", "A", "--target", "0", "0", "20"], 2, "--coordinates"),
    (
        ["edit", "{plan}", "A", "--notes", "x", *POINTS[8:]],
        2,
        "--coordinates is the system of --entry or --target",
    ),
    (["propose", "{plan}", "B", "--target-acpc", "1", "2", "3", *POINTS[8:]], 2, "the system of --target, which"),
    (["markers", "--count", "5", *POINTS[8:]], 2, "the system of --target, which is not given"),
    (["edit", "{plan}", "Z", "--notes", "none"], 1, "no trajectory 'Z'"),
    (["check", "{plan}", "--frame-axes", *["1", "0", "0", "0", "1", "0", "0", "0", "2"]], 1, "not rigid"),
    (["check", "{plan}", "--no-go", "{plan}"], 1, "neither a NIfTI"),
    (["check", "{plan}", "--limits", "{plan}"], 1, "not a limits document"),
    (["check", "{plan}", "--fiducials", "{plan}"], 1, "not a fiducials document"),
    (["check", "{plan}", "--sigma-ots", "1e300"], 2, "--sigma-ots: 1e300"),
    (["propose", "{plan}", "B", *POINTS[4:], "--count", "0"], 2, "--count: 0"),
    (["markers", "--plan", "{plan}", "--count", "-1"], 2, "--count: -1"),
    (["markers", "--count", "5", "--sigma-ct", "0"], 2, "--sigma-ct: 0"),
    (["markers", "--count", "5", "--visible", "40"], 2, "--visible"),
    (["import", "{plan}", "paths.csv", "--coordinates", "LPS", "--first", "target"], 2, "--first"),
    (["add", "{newer}", "B", *POINTS], 1, "version 2"),
    (["check", "{foreign}"], 1, "frame"),
    (["add", "{foreign}", "B", *POINTS], 1, "frame"),
]


@pytest.mark.parametrize(("arguments", "status", "words"), BAD)
def test_a_bad_call_ends_in_one_sentence_and_leaves_the_plan_untouched(
    arguments: list[str],
    status: int,
    words: str,
    plan: Path,
    ct: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    content = json.loads(plan.read_text())
    newer, foreign = tmp_path / "newer.json", tmp_path / "foreign.json"
    newer.write_text(json.dumps({**content, "version": 2}))
    foreign.write_text(json.dumps({**content, "source": {"frame_of_reference_uid": "9.9"}}))
    before = {path: path.read_bytes() for path in (plan, newer, foreign)}
    capsys.readouterr()
    filled = [argument.format(plan=plan, newer=newer, foreign=foreign) for argument in arguments]
    assert main(["plan", *filled, "--ct", str(ct)]) == status
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.count("\n") == 1
    assert words in printed.err
    assert {path: path.read_bytes() for path in before} == before


def test_a_template_is_bent_to_a_scan(ct: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    asked = ["plan", "template", "--markers", "3", "--ct", str(ct), "--size", "80", "60"]
    assert main([*asked, "-o", str(tmp_path / "t.stl")]) == 0
    assert "bent to a radius of" in capsys.readouterr().out
    assert main([*asked, "--at", "0", "0", "300", "--coordinates", "LPS", "-o", str(tmp_path / "u.stl")]) == 1
    assert "off the scalp" in capsys.readouterr().err
    assert not (tmp_path / "u.stl").exists()
