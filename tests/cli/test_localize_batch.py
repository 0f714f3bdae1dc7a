"""Several scans, or series, at once: each has its result, and a summary tells what became of all."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import pytest
import SimpleITK
from pydicom import Dataset, dcmread

from phantoms.fast import render
from phantoms.output import write_phantom
from phantoms.series import SeriesOptions
from ronnaplan import read_ct
from ronnaplan.cli.localize_batch import jobs_of
from tests.cli.calls import run
from tests.ct import makers
from tests.scans import balls, small_stack


def test_a_batch_goes_on_after_a_bad_scan(
    ct_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bad, results = tmp_path / "bad", tmp_path / "results"
    bad.mkdir()
    call = [
        "localize",
        str(bad),
        str(ct_folder),
        "--diameter",
        "11.5",
        "-o",
        str(results),
        "--report",
        "sheet.png",
    ]
    status, _, err = run(call, capsys)
    assert status == 1
    assert "001-bad: " in err
    assert "002-ct: 1 marker of" in err
    names = ["002-ct.fiducials.json", "002-ct.png", "summary.csv", "summary.json"]
    assert sorted(path.name for path in results.iterdir()) == names
    first, second = json.loads((results / "summary.json").read_text())["scans"]
    assert (first["scan"], first["status"], first["markers"]) == ("001-bad", 1, None)
    assert (second["scan"], second["status"], second["markers"]) == ("002-ct", 0, 1)
    assert second["fiducials"] == "002-ct.fiducials.json"
    rows = list(csv.DictReader((results / "summary.csv").read_text().splitlines()))
    assert [row["message"] for row in rows] == [first["message"], second["message"]]
    status, _, err = run(call[:5], capsys)
    assert status == 2
    assert "name a folder" in err


def test_a_batch_is_refused_where_an_earlier_one_left_its_results(
    ct_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    results = tmp_path / "results"
    results.mkdir()
    (results / "fiducials.json").write_text("of a person")  # a batch writes no such file
    call = ["localize", str(ct_folder), str(ct_folder), "--diameter", "11.5", "-o", str(results)]
    assert run(call, capsys)[0] == 0
    written = {path: path.read_bytes() for path in results.iterdir()}
    status, _, err = run([*call, "--expected", "2"], capsys)
    assert (status, err.count("\n")) == (1, 1)
    assert "results of an earlier run (summary.json)" in err
    assert {path: path.read_bytes() for path in results.iterdir()} == written
    for name in ("summary.json", "summary.csv"):
        (results / name).unlink()  # of a batch that was stopped, the documents alone lie there
    assert "earlier run (001-ct.fiducials.json)" in run(call, capsys)[2]


def test_the_summary_tells_what_was_found_of_each_size_and_of_a_refused_scan(
    ct_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = str(ct_folder)
    call = ["localize", folder, folder, "--diameter", "8,11.5", "--expected", "2", "-o", str(tmp_path / "results")]
    assert run(call, capsys)[0] == 3
    scan, _ = json.loads((tmp_path / "results" / "summary.json").read_text())["scans"]
    assert (scan["status"], scan["markers"], scan["markers_by_diameter"]) == (3, 1, "8:0 11.5:1")
    assert (scan["diameters_mm"], scan["fiducials"]) == ("8 or 11.5", None)
    assert scan["series"] == read_ct(ct_folder).source.series_instance_uid is not None


def test_the_summary_tells_that_the_geometry_may_be_wrong(
    ct_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    wrong = "4 markers are alike ellipsoids"
    monkeypatch.setattr("ronnaplan.localization.localizer.distortion", lambda *_: wrong)
    status, _, err = run(
        ["localize", str(ct_folder), str(ct_folder), "--diameter", "11.5", "-o", str(tmp_path)], capsys
    )
    assert status == 0
    assert err.count(wrong) == 2
    rows = csv.DictReader((tmp_path / "summary.csv").read_text().splitlines())
    assert all(row["message"].endswith(f"; warning: {wrong}") for row in rows)


def test_the_summary_tells_the_flags_of_a_scan(
    ct_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """An image file names no frame of reference, the same scan's series does."""
    image = SimpleITK.GetImageFromArray(read_ct(ct_folder).voxels_hu)
    SimpleITK.WriteImage(image, str(tmp_path / "scan.nrrd"))
    call = ["localize", str(tmp_path / "scan.nrrd"), str(ct_folder), "--diameter", "11.5"]
    assert run([*call, "-o", str(tmp_path / "results")], capsys)[0] == 0
    scans = json.loads((tmp_path / "results" / "summary.json").read_text())["scans"]
    assert ["no_frame_of_reference" in scan["flags"].split() for scan in scans] == [True, False]


def test_every_series_of_a_folder_is_done_when_asked_for(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    exam, results = tmp_path / "exam", tmp_path / "results"
    for number, place in enumerate([(5.0, -4.0, 2.0), (-5.0, 4.0, -2.0)]):
        scene, stack = balls([place]), small_stack(spacing_mm=2.0, matrix=64)
        write_phantom(exam / str(number), scene, stack, render(scene, stack, seed=1), SeriesOptions(seed=number))
    call = ["localize", str(exam), "--diameter", "11.5"]
    status, _, err = run(call, capsys)
    assert status == 1
    assert "--series" in err
    assert "--all-series does them all" in err
    status, _, err = run([*call, "--all-series", "-o", str(results)], capsys)
    assert status == 0
    assert "001-exam: 1 marker of" in err
    assert all(line.startswith(("001-exam: ", "002-exam: ")) for line in err.splitlines())
    scans = json.loads((results / "summary.json").read_text())["scans"]
    assert len({one["series"] for one in scans}) == 2
    assert {Path(one["first_file"]).parent for one in scans} == {exam / "0", exam / "1"}


def test_a_scan_that_cannot_be_used_is_told_where_all_series_are_done(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its summary had one row of two scans, and nothing told of the other."""

    def of_another(made: Dataset, k: int) -> None:
        made.SeriesInstanceUID = "1.2.9"
        if k == 1:
            made.PixelData = made.PixelData[:-20]

    makers.write_series(makers.write_series(tmp_path), 4, of_another, "other")
    assert [one.series for one in jobs_of([str(tmp_path)], None, all_series=True)] == [makers.SERIES]
    assert "holds a scan that cannot be used, too, and is left out" in capsys.readouterr().err


def test_the_parts_of_one_series_are_told_apart_by_the_name_that_asks_for_them_again(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    exam, results = tmp_path / "exam", tmp_path / "results"
    for number, place in enumerate([(5.0, -4.0, 2.0), (-5.0, 4.0, -2.0)]):
        scene, stack = balls([place]), small_stack(spacing_mm=2.0, matrix=64)
        write_phantom(exam / str(number), scene, stack, render(scene, stack, seed=1), SeriesOptions(seed=1))
        for path in (exam / str(number)).glob("*.dcm"):
            image = dcmread(path)
            image.AcquisitionNumber = number + 1
            image.save_as(path)
    call = ["localize", str(exam), "--diameter", "11.5"]
    assert run([*call, "--all-series", "-o", str(results)], capsys)[0] == 0
    for scan in json.loads((results / "summary.json").read_text())["scans"]:
        status, out, _ = run([*call, "--series", scan["series"]], capsys)
        assert (status, out) == (0, (results / scan["fiducials"]).read_text())


def test_a_path_that_is_no_text_is_told_escaped(
    ct_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scan, results = tmp_path / "\udcffct", tmp_path / "results"
    scan.symlink_to(ct_folder)
    assert run(["localize", str(scan), str(scan), "--diameter", "11.5", "-o", str(results)], capsys)[0] == 0
    told = str(tmp_path / r"\udcffct")
    assert [one["path"] for one in json.loads((results / "summary.json").read_text())["scans"]] == [told] * 2
    rows = list(csv.DictReader((results / "summary.csv").read_text().splitlines()))
    assert [row["path"] for row in rows] == [told] * 2


def test_a_path_that_is_not_there_is_one_bad_scan_also_where_all_series_are_asked_for(
    ct_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    paths = [str(tmp_path / "none"), str(ct_folder)]
    call = ["localize", *paths, "--all-series", "--diameter", "11.5", "-o", str(tmp_path / "results")]
    assert run(call, capsys)[0] == 1
    first, second = json.loads((tmp_path / "results" / "summary.json").read_text())["scans"]
    assert (first["scan"], first["status"], second["status"]) == ("001-none", 1, 0)
    assert "there is no file or folder" in first["message"]
