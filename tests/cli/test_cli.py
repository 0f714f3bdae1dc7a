"""The command keeps its contract: exit status, one sentence for an error, nothing half-written."""

from __future__ import annotations

import csv
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from phantoms.fast import render
from phantoms.output import write_phantom
from phantoms.series import SeriesOptions
from ronnaplan import read_ct
from ronnaplan.cli import demo, main
from tests.scans import balls, small_stack

ROOT = Path(__file__).resolve().parents[2]
HEAVY = ("numpy", "scipy", "pydicom", "SimpleITK", "numba", "matplotlib", "pydantic", "cv2", "skimage")


@pytest.fixture(scope="module")
def ct_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("scan") / "ct"
    scene, stack = balls([(5.0, -4.0, 2.0)]), small_stack(spacing_mm=2.0, matrix=64)
    write_phantom(folder, scene, stack, render(scene, stack, seed=1))
    return folder


def run(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> tuple[int, str, str]:
    status = main(arguments)
    printed = capsys.readouterr()
    return status, printed.out, printed.err


def test_help_loads_nothing_heavy() -> None:
    code = "import sys\nfrom ronnaplan.cli import main\ntry: main(['--help'])\nexcept SystemExit: pass\n"
    code += f"print(*[name for name in {HEAVY} if name in sys.modules], file=sys.stderr)"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stderr.strip() == ""
    assert "not a medical device" in done.stdout


def test_localizing_loads_nothing_that_takes_longer_than_the_work(ct_folder: Path) -> None:
    unneeded = (
        *("scipy.linalg", "scipy.special", "scipy.stats", "scipy.optimize", "scipy.ndimage", "scipy.spatial"),
        *("SimpleITK", "matplotlib", "skimage", "PIL", "ronnaplan.cli.plan"),
    )
    code = f"import sys\nfrom ronnaplan.cli import main\nmain(['localize', {str(ct_folder)!r}, '--diameter', '11.5'])\n"
    code += f"print('loaded', *[name for name in {unneeded} if name in sys.modules], file=sys.stderr)"
    for _ in range(2):  # what compiles, loads more
        done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stderr.splitlines()[-1] == "loaded"


def test_linear_algebra_starts_no_threads_of_its_own_unless_told_to() -> None:
    code = "import os\nfrom ronnaplan.cli import main\ntry: main(['--version'])\nexcept SystemExit: pass\n"
    code += "import numpy, threadpoolctl\nprint(os.environ['OPENBLAS_NUM_THREADS'])\n"
    code += "print(max((one['num_threads'] for one in threadpoolctl.threadpool_info()), default=1))"
    unset = {name: value for name, value in os.environ.items() if not name.endswith("_NUM_THREADS")}
    for environment, told in ((unset, "1"), ({**unset, "OPENBLAS_NUM_THREADS": "2"}, "2")):
        command = [sys.executable, "-c", code]
        done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=True)
        setting, threads = done.stdout.splitlines()[-2:]
        assert setting == told
        assert int(threads) <= int(told)


def test_python_searches_nothing_for_garbage_when_it_ends() -> None:
    code = "import atexit, gc, sys\natexit.register(lambda: print(len(gc.get_objects())))\n"
    code += "from ronnaplan.cli import main\nmain(['--version'])"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert int(done.stdout.splitlines()[-1]) < 1000


def test_localize_prints_the_document_and_nothing_else(
    ct_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    status, out, err = run(["localize", str(ct_folder), "--diameter", "11.5"], capsys)
    assert status == 0
    (found,) = json.loads(out)["fiducials"]
    assert np.linalg.norm(np.array(found["center"]) - [5.0, -4.0, 2.0]) < 0.05
    assert "1 markers of 11.5 mm" in err


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
    assert "1 markers of 8 or 11.5 or 20 mm" in err


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


@pytest.mark.parametrize(
    ("arguments", "status", "sentence"),
    [
        (["localize", "{ct}", "--diameter", "11.5", "--expected", "2"], 3, "1 markers of 11.5 mm were found"),
        (["localize", "{ct}/nowhere", "--diameter", "11.5"], 1, "nowhere"),
        (["localize", "{empty}", "--diameter", "11.5"], 1, ""),
        (["localize", "{ct}", "--diameter", "11.5", "--series", "1.2.3"], 1, "1.2.3"),
        (["localize", "{ct}", "--diameter", "0"], 2, "positive number of mm"),
        (["localize", "{ct}", "--diameter", "-2"], 2, "positive number of mm"),
        (["localize", "{ct}", "--diameter", "nan"], 2, "positive number of mm"),
        (["localize", "{ct}", "--diameter", "large"], 2, "several as 11.5,5"),
        (["localize", "{ct}", "--diameter", "1.5"], 1, "smaller than 2 pixels"),
        (["localize", "{ct}"], 2, "--diameter"),
        (["export", "{ct}/truth.json", "--to", "csv"], 1, "not a fiducials document"),
        (["export", "{ct}/truth.json", "--to", "stl"], 2, "give a case's folder"),
        (["localize", "{ct}", "--diameter", "11.5", "--diameter", "auto"], 2, "both 11.5 and auto"),
        (
            ["localize", "{ct}", "--diameter", "11.5", "--expected", "1", "--expected", "1"],
            2,
            "--expected: is given twice",
        ),
        (["export", "{ct}", "--to", "csv", "--to", "itk"], 2, "--to: is given twice"),
        (["robot", "pivot", "{ct}", "-o", "a", "-o", "b"], 2, "-o/--output: is given twice"),
        (["fly"], 2, "invalid choice"),
        ([], 2, "VERB"),
    ],
)
def test_a_bad_call_ends_in_one_sentence_and_writes_nothing(
    arguments: list[str],
    status: int,
    sentence: str,
    ct_folder: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    empty = tmp_path / "empty"
    empty.mkdir()
    output = tmp_path / "out.json"
    output.write_text("as before")
    filled = [argument.format(ct=ct_folder, empty=empty) for argument in arguments]
    got, out, err = run([*filled, "-o", str(output)] if filled[:1] == ["localize"] else filled, capsys)
    assert got == status
    assert out == ""
    assert err.count("\n") == 1
    assert err.startswith("ronnaplan: ")
    assert sentence in err
    assert output.read_text() == "as before"


def test_the_demo_finds_every_marker_within_0_03_mm(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    status, out, _ = run(["demo", "--output-dir", str(tmp_path / "demo")], capsys)
    assert status == 0
    truth = json.loads((ROOT / "data" / "synthetic_ct" / "truth.json").read_text())["markers"]
    found = json.loads((tmp_path / "demo" / "fiducials.json").read_text())["fiducials"]
    assert len(found) == len(truth)
    centers = np.array([marker["center"] for marker in truth])
    for one in found:
        assert np.linalg.norm(centers - one["center"], axis=1).min() < 0.03
    assert (tmp_path / "demo" / "markers.png").read_bytes().startswith(b"\x89PNG")
    assert "markers.png" in out
    assert "not a medical device" in out


def test_the_demo_says_how_the_command_is_found_only_where_it_is_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.prefix", str(tmp_path / ".venv"))
    monkeypatch.setattr("shutil.which", lambda _: None)
    assert demo._first() == ""
    for folder, shown in (
        ("Scripts", " (after '.venv/Scripts/activate')"),
        ("bin", " (after '. .venv/bin/activate')"),
    ):
        (tmp_path / ".venv" / folder).mkdir(parents=True)
        (tmp_path / ".venv" / folder / "activate").touch()
        assert shown in demo._first()
    monkeypatch.setattr("shutil.which", lambda _: "/somewhere/ronnaplan")
    assert demo._first() == ""


def test_fewer_than_no_markers_are_expected_of_no_scan(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Told before any scan is read: this one is not there."""
    call = ["localize", str(tmp_path / "none"), "--diameter", "auto", "--expected", "-1"]
    status, _, err = run(call, capsys)
    assert status == 2
    assert "--expected: -1 is out of range" in err


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
    assert "002-ct: 1 markers" in err
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
    assert "001-exam: 1 markers" in err
    assert all(line.startswith(("001-exam: ", "002-exam: ")) for line in err.splitlines())
    scans = json.loads((results / "summary.json").read_text())["scans"]
    assert len({one["series"] for one in scans}) == 2
    assert {Path(one["first_file"]).parent for one in scans} == {exam / "0", exam / "1"}


def test_a_symmetric_layout_is_warned_of_before_the_operation(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    square = [(-15.0, -15.0, 0.0), (15.0, -15.0, 0.0), (15.0, 15.0, 0.0), (-15.0, 15.0, 0.0)]
    scene, stack = balls(square), small_stack(spacing_mm=2.0, matrix=64)
    write_phantom(tmp_path / "ct", scene, stack, render(scene, stack, seed=1))
    assert main(["localize", str(tmp_path / "ct"), "--diameter", "11.5", "--expected", "4"]) == 0
    assert "would be refused" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "status", "sentence"),
    [
        (["localize", "", "--diameter", "11.5"], 1, "expected the path of a CT"),
        (["localize", "{ct}", "--diameter", "1e9"], 1, "more than half of this scan"),
        (["localize", "{ct}", "--diameter", "1_1"], 2, "positive number of mm"),
        (["localize", "{ct}", "--diameter", "11,5"], 2, "may be 11.5 mm or 2 diameters"),
        (["localize", "{ct}", "--diameter", "5,8,11"], 2, "for several 5.0,8.0,11.0"),
        (["localize", "{ct}", "--diameter", "\u0661\u0661.5"], 2, "positive number of mm"),
        (["localize", "{ct}", "--diameter", "9" * 400], 2, "positive number of mm"),
        (["localize", "{ct}", "--diameter", "11.5", "--expected", "1_0"], 2, "no whole number"),
        (["localize", "{ct}", "--diameter", "11.5", "--expected", "9" * 5000], 2, "no whole number"),
        (["track", "--port", "99999999"], 2, "out of range"),
        (["track", "--seconds", "1e300"], 2, "no duration"),
        (["track", "--seconds", "1_0"], 2, "no duration"),
        (["view", "{ct}", "--port", "99999999"], 2, "out of range"),
        (["view", "{ct}", "--port", "-1"], 2, "out of range"),
        (["view", "{ct}", "--tracker", "localhost:\u00b2"], 2, "HOST:PORT"),
        (["phantom", "x", "--padding", "1_0"], 2, "no number"),
        (["localize", "{ct}", "--diameter", "11.5", "--report", "sheet.txt"], 2, "the contact sheet is a .png"),
        (["localize", "{ct}", "--diameter", "11.5", "-o", "/nowhere/at/all.json"], 1, "does not exist"),
        (["localize", "{ct}/a\x1b[31mb", "--diameter", "11.5"], 1, r"a\x1b[31mb"),
    ],
)
def test_a_slip_is_answered_in_one_plain_sentence(
    arguments: list[str], status: int, sentence: str, ct_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    got, out, err = run([argument.format(ct=ct_folder) for argument in arguments], capsys)
    assert (got, out, err.count("\n")) == (status, "", 1)
    assert sentence in err
    assert "\x1b" not in err


VERBS_THAT_PRINT = {
    "export": ["export", "{fiducials}", "--to", "csv"],
    "series": ["series", "{ct}"],
    "series as JSON": ["series", "{ct}", "--json"],
    "scenes": ["phantom", "--list"],
    "help": ["series", "--help"],
    "version": ["--version"],
}


@pytest.mark.parametrize("ending", ["> /dev/full", ">&-"])
def test_a_full_disk_or_a_closed_output_is_said_plainly(ending: str, ct_folder: Path, tmp_path: Path) -> None:
    fiducials = tmp_path / "f.json"
    assert main(["localize", str(ct_folder), "--diameter", "11.5", "-o", str(fiducials)]) == 0
    for name, arguments in VERBS_THAT_PRINT.items():
        given = " ".join(arguments).format(ct=ct_folder, fiducials=fiducials)
        call = f"{sys.executable} -m ronnaplan {given} {ending}"
        done = subprocess.run(call, shell=True, cwd=ROOT, capture_output=True, text=True, check=False)
        assert done.returncode == 1, name
        assert "standard output" in done.stderr, name
        assert done.stderr.count("\n") == 1, done.stderr


@pytest.mark.parametrize("ending", ["2> /dev/full", "2>&-"])
def test_messages_that_nobody_can_read_get_nowhere_else(ending: str, ct_folder: Path) -> None:
    call = f"{sys.executable} -m ronnaplan localize {ct_folder} --diameter 11.5 {ending}"
    done = subprocess.run(call, shell=True, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0
    assert len(json.loads(done.stdout)["fiducials"]) == 1
    bad = f"{sys.executable} -m ronnaplan localize {ct_folder}/nowhere --diameter 11.5 {ending}"
    done = subprocess.run(bad, shell=True, cwd=ROOT, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (1, "")


def test_a_reader_that_goes_away_is_no_error(ct_folder: Path) -> None:
    call = f"{sys.executable} -m ronnaplan series {ct_folder} --json | true; echo ${{PIPESTATUS[0]}}"
    done = subprocess.run(["bash", "-c", call], cwd=ROOT, capture_output=True, text=True, check=False)
    assert (done.stdout.strip(), done.stderr) == ("0", "")
