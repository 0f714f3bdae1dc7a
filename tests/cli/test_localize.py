"""The verb localize writes its document and nothing else; what it refuses, it shows."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from phantoms.fast import render
from phantoms.output import write_phantom
from ronnaplan.cli import main
from tests.cli.calls import run
from tests.scans import balls, small_stack, two_sizes


def test_localize_prints_the_document_and_nothing_else(
    ct_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    status, out, err = run(["localize", str(ct_folder), "--diameter", "11.5"], capsys)
    assert status == 0
    (found,) = json.loads(out)["fiducials"]
    assert np.linalg.norm(np.array(found["center"]) - [5.0, -4.0, 2.0]) < 0.05
    assert "1 marker of 11.5 mm" in err
    assert (
        "if the head moved between the slices of two markers, no image shows it; 0.3 mm per axis are assumed"
        in err
    )


def test_localize_then_export(ct_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    fiducials, markups = tmp_path / "f.json", tmp_path / "f.mrk.json"
    assert main(["localize", str(ct_folder), "--diameter", "11.5", "--expected", "1", "-o", str(fiducials)]) == 0
    assert main(["export", str(fiducials), "--to", "markups", "-o", str(markups)]) == 0
    assert json.loads(markups.read_text())["markups"][0]["controlPoints"][0]["label"] == "F1"
    assert capsys.readouterr().out == ""


def test_diameters_given_one_after_another_are_all_looked_for(
    ct_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    status, out, err = run(
        ["localize", str(ct_folder), "--diameter", "8", "--diameter", "11.5,20", "--diameter", "11.5"], capsys
    )
    assert status == 0
    assert json.loads(out)["marker"]["diameters_mm"] == [8.0, 11.5, 20.0]
    assert "1 marker of 8 or 11.5 or 20 mm" in err


def test_another_set_of_balls_beside_the_commonest_is_told_of(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Four balls were taken for the markers without a word of three others; the number that is expected decides."""
    scene, stack = two_sizes(), small_stack()
    write_phantom(tmp_path / "ct", scene, stack, render(scene, stack, seed=1))
    call = ["localize", str(tmp_path / "ct"), "--diameter", "auto"]
    status, out, err = run(call, capsys)
    assert status == 0
    assert len(json.loads(out)["fiducials"]) == 4
    assert "warning: balls of 9.00 mm are taken, the commonest; seen: 4 spheres of 9.00 mm, 3 spheres" in err
    assert "--diameter 9.0,6.0 for all" in err
    status, out, err = run([*call, "--expected", "3"], capsys)
    assert len(json.loads(out)["fiducials"]) == 3
    assert "the commonest" not in err


def test_an_empty_scan_is_an_answer(ct_folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    status, out, err = run(["localize", str(ct_folder), "--diameter", "5"], capsys)
    assert status == 0
    assert json.loads(out)["fiducials"] == []
    assert "seen: 1 sphere of 11.50 mm: try --diameter 11.5" in err


def test_a_refusal_says_what_there_is_and_leaves_a_picture(
    ct_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    sheet = tmp_path / "sheet.png"
    call = ["localize", str(ct_folder), "--diameter", "8", "--expected", "1", "--report", str(sheet)]
    status, out, err = run(call, capsys)
    assert (status, out) == (3, "")
    assert "0 markers of 8 mm were found, 1 expected" in err
    assert "try --diameter 11.5" in err
    assert sheet.read_bytes().startswith(b"\x89PNG")


def test_fewer_than_no_markers_are_expected_of_no_scan(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Told before any scan is read: this one is not there."""
    call = ["localize", str(tmp_path / "none"), "--diameter", "auto", "--expected", "-1"]
    status, _, err = run(call, capsys)
    assert status == 2
    assert "--expected: -1 is out of range" in err


def test_a_symmetric_layout_is_warned_of_before_the_operation(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    square = [(-15.0, -15.0, 0.0), (15.0, -15.0, 0.0), (15.0, 15.0, 0.0), (-15.0, 15.0, 0.0)]
    scene, stack = balls(square), small_stack(spacing_mm=2.0, matrix=64)
    write_phantom(tmp_path / "ct", scene, stack, render(scene, stack, seed=1))
    assert main(["localize", str(tmp_path / "ct"), "--diameter", "11.5", "--expected", "4"]) == 0
    assert "would be refused" in capsys.readouterr().err


def test_slices_that_are_said_to_be_farther_apart_than_they_were_are_warned_of(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    places = [(-15.0, -13.0, 0.0), (15.0, -15.0, 3.0), (12.0, 15.0, -4.0), (-15.0, 11.0, 2.0)]
    scene, stack = balls(places), small_stack(matrix=96)
    images = render(scene, stack, seed=1)
    write_phantom(tmp_path / "ct", scene, small_stack(matrix=96, start_mm=-33, stop_mm=33, spacing_mm=1.5), images)
    status, out, err = run(["localize", str(tmp_path / "ct"), "--diameter", "11.5"], capsys)
    assert status == 0
    told = json.loads(out)["source"]["distortion"]
    assert "the slices' distance in the header (1.5 mm) may be wrong" in told
    assert f"warning: {told}" in err
    assert "--diameter" not in err


def test_a_marker_that_moved_puts_the_others_in_doubt(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A jump passes through the lower ball; the upper one is whole, and off to it."""
    centers = ([(-12.0, -9.0, -6.0), (12.0, 9.0, 8.0)], [(-11.5, -9.0, -6.0), (12.5, 9.0, 8.0)])
    stack = small_stack()
    before, after = (render(balls(places), stack, seed=seed) for seed, places in enumerate(centers))
    images = np.where((stack.positions_mm > -5.5)[:, np.newaxis, np.newaxis], after, before)
    write_phantom(tmp_path / "ct", balls(centers[0]), stack, images)
    status, _, err = run(["localize", str(tmp_path / "ct"), "--diameter", "11.5"], capsys)
    assert status == 0
    assert "motion is suspected of F2: if the head moved, the distances of all markers are open, of those" in err
