"""The command keeps its contract: exit status, one sentence for an error, nothing half-written."""

from __future__ import annotations

import argparse
import errno
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from ronnaplan.cli import command_parser, main, parse
from ronnaplan.text import NOTICE
from tests import cases
from tests.cli.calls import run
from tests.long import few_and_others

ROOT = Path(__file__).resolve().parents[2]
HEAVY = ("numpy", "scipy", "pydicom", "SimpleITK", "numba", "matplotlib", "pydantic", "cv2", "skimage")


def test_help_loads_nothing_heavy() -> None:
    code = "import sys\nfrom ronnaplan.cli import main\ntry: main(['--help'])\nexcept SystemExit: pass\n"
    code += f"print(*[name for name in {HEAVY} if name in sys.modules], file=sys.stderr)"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stderr.strip() == ""
    assert "not a medical device" in done.stdout


def parsers(one: argparse.ArgumentParser) -> Iterator[argparse.ArgumentParser]:
    yield one
    for action in one._actions:
        if isinstance(action, argparse._SubParsersAction):
            for other in action.choices.values():
                yield from parsers(other)


def test_every_help_says_what_this_is_not() -> None:
    found = list(parsers(command_parser()))
    assert len(found) > 40
    assert {one.epilog for one in found} == {NOTICE}


def test_every_option_says_what_it_is_and_what_stands_where_it_is_left_out() -> None:
    options = [
        (one.prog, option) for one in parsers(command_parser()) for option in one._actions if option.option_strings
    ]
    assert len(options) > 200
    for verb, option in options:
        assert option.help, (verb, option.option_strings)
        chosen = option.nargs != 0 and option.default not in (None, "", [])
        assert not chosen or "default" in option.help, (verb, option.option_strings)


def test_localizing_loads_nothing_that_takes_longer_than_the_work(ct_folder: Path) -> None:
    unneeded = (
        *("scipy.linalg", "scipy.special", "scipy.stats", "scipy.optimize", "scipy.ndimage", "scipy.spatial"),
        *("SimpleITK", "matplotlib", "skimage", "PIL", "ronnaplan.cli.plan"),
    )
    code = f"import sys\nfrom ronnaplan.cli import main\nmain(['localize', {str(ct_folder)!r}, '--diameter', '11.5'])\n"
    code += f"print('loaded', *[name for name in {unneeded} if name in sys.modules], file=sys.stderr)"
    for _ in range(2):  # what compiles, loads more
        done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
        if done.stderr.splitlines()[-1] == "loaded":
            break
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


@pytest.mark.parametrize(
    ("arguments", "status", "sentence"),
    [
        (["localize", "{ct}", "--diameter", "11.5", "--expected", "2"], 3, "1 marker of 11.5 mm was found"),
        (["localize", "{ct}/nowhere", "--diameter", "11.5"], 1, "nowhere"),
        (["localize", "{empty}", "--diameter", "11.5"], 1, ""),
        (["localize", "{ct}", "--diameter", "11.5", "--series", "1.2.3"], 1, "1.2.3"),
        (["localize", "{ct}", "--diameter", "0"], 2, "positive number of mm"),
        (["localize", "{ct}", "--diameter", "-2"], 2, "positive number of mm"),
        (["localize", "{ct}", "--diameter", "nan"], 2, "positive number of mm"),
        (["localize", "{ct}", "--diameter", "large"], 2, "several as 11.5,5"),
        (["localize", "{ct}", "--diameter", "1.5"], 1, "smaller than 2 pixels"),
        (["localize", "{ct}/nowhere", "--diameter", "5", "--marker", "shell:2.5"], 2, "leaves nothing hollow"),
        (["localize", "{ct}"], 2, "--diameter"),
        (["export", "{ct}/truth.json", "--to", "csv"], 1, "not a fiducials document"),
        (["export", "{ct}/truth.json", "--to", "stl"], 2, "give a case's folder"),
        (["export", "{ct}/truth.json", "--to", "csv", "--secret", "s"], 2, "--secret goes with --deidentify"),
        (["export", "{ct}", "--deidentify", "-o", "a", "--series", "1.2.3"], 2, "all of FILE"),
        (["export", "{ct}", "--deidentify", "-o", "a", "--labels", "b.nii"], 2, "all of FILE"),
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


@pytest.mark.parametrize(
    ("arguments", "status", "sentence"),
    [
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
        (["plan", "check", "", "--ct", "{ct}"], 2, "PLAN: is empty"),
        (["plan", "check", "plan.json", "--ct", "{ct}", "--fiducials", ""], 2, "--fiducials: is empty"),
        (["localize", "", "--diameter", "11.5"], 2, "PATH: is empty"),
        (["plan", "check", "plan.json", "--ct", "{ct}", "--no-go", ""], 2, "--no-go: is empty"),
        (["cohort", "{ct}", "", "-o", "out"], 2, "ROOT: is empty"),
        (
            ["localize", "-", "--diameter", "11.5"],
            1,
            "standard input is not read, so save what it brings to a file",
        ),
        (["robot", "pivot", "-"], 1, "standard input is not read, so save what it brings to a file"),
        (["robot", "pivot", "{ct}"], 1, "it is a folder"),
        (["localize", "{ct}", "--diameter", "11.5", "-o", "-"], 2, "leave -o out for standard output"),
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


@pytest.mark.parametrize(
    "command",
    [
        "register fiducials.json readings.csv",
        "robot pivot readings.csv",
        "robot hand-eye other.csv readings.csv",
        "export readings.csv --to csv",
    ],
)
def test_no_file_that_is_read_is_replaced(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "readings.csv").write_text("x,y,z\n")
    (tmp_path / "link.csv").symlink_to(tmp_path / "readings.csv")
    for name in ("readings.csv", "./readings.csv", "link.csv"):
        status, _, told = run([*command.split(), "-o", name], capsys)
        assert (status, told.count("\n")) == (2, 1)
        assert f"-o {name} is a file that is read here" in told
    assert (tmp_path / "readings.csv").read_text() == "x,y,z\n"


@pytest.mark.parametrize("command", ["localize {ct} --diameter 11.5", "plan new {ct}", "schema plan"])
def test_no_image_of_a_scan_is_replaced(command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    image = tmp_path / "CT0001.dcm"
    image.write_bytes((ROOT / "data" / "synthetic_ct" / image.name).read_bytes())
    before = image.read_bytes()
    status, _, told = run([*command.format(ct=tmp_path).split(), "-o", str(image)], capsys)
    assert (status, told.count("\n")) == (2, 1)
    assert "CT0001.dcm is a DICOM image, and would be lost" in told
    assert image.read_bytes() == before


@pytest.mark.skipif(sys.platform == "win32", reason="the system has other words for it")
@pytest.mark.parametrize(
    "command",
    [
        "report {name} -o r.html",
        "export {name} --to csv",
        "schema plan -o {name}",
        "plan undo {name}",
        "phantom water-disc --scanner fast --from 0 --to 3 --matrix 32 -o {name}",
        "series {name}",
    ],
)
def test_a_name_that_the_system_cannot_even_look_up_is_told(
    command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    status, out, told = run(command.format(name="n" * 300).split(), capsys)
    assert (status, out, told.count("\n")) == (1, "", 1)
    assert "File name too long" in told
    assert "Errno" not in told


def test_a_result_may_be_replaced_by_a_newer_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    for _ in range(2):
        assert run(["schema", "plan", "-o", "plan"], capsys)[0] == 0


@few_and_others("ending", ["> /dev/full"], [">&-"])
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


@pytest.mark.parametrize("text", ["-1.5e-05", "-2E3", "-.5", "-7", "-7."])
def test_a_negative_number_is_no_option_however_it_is_written(text: str) -> None:
    given = parse(["register", "f.json", "r.csv", "--target", text, "5", "10"])
    assert given.target == [[float(text), 5.0, 10.0]]


@pytest.mark.parametrize("code", [errno.ENOSPC, errno.ENOENT])
def test_a_disk_without_room_for_temporary_files_is_said_plainly(
    code: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def full(_: str) -> None:
        raise OSError(code, "no room")

    monkeypatch.setattr("ronnaplan.documents.schemas.schema", full)
    status, out, told = run(["schema", "plan"], capsys)
    assert (status, out) == (1, "")
    assert (
        told == "ronnaplan: no room; make room on the disk, or name another folder for temporary files by TMPDIR\n"
    )


def test_an_error_of_the_system_that_is_of_no_file_is_not_hidden(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(_: str) -> None:
        raise OSError(errno.EBADF, "Bad file descriptor")

    monkeypatch.setattr("ronnaplan.documents.schemas.schema", broken)
    with pytest.raises(OSError, match="Bad file"):
        main(["schema", "plan"])


@few_and_others("ending", ["2> /dev/full"], ["2>&-"])
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


@pytest.mark.parametrize(("asked", "encoding"), [({}, "utf-8"), ({"PYTHONIOENCODING": "cp1252"}, "cp1252")])
def test_what_is_redirected_is_utf8_whatever_the_terminal_takes(
    tmp_path: Path, asked: dict[str, str], encoding: str
) -> None:
    path = cases.write_case(tmp_path) / "fiducials.json"
    label = cases.fiducials().fiducials[0].label
    path.write_text(path.read_text().replace(f'"{label}"', '"Jochbögen"'), encoding="utf-8")
    of_a_region = {"LC_ALL": "C", "PYTHONCOERCECLOCALE": "0", "PYTHONUTF8": "0"}  # as Windows has them
    done = subprocess.run(
        [sys.executable, "-m", "ronnaplan", "export", str(path), "--to", "csv"],
        cwd=ROOT,
        env={**os.environ, **of_a_region, **asked},
        capture_output=True,
        check=True,
    )
    assert "Jochbögen" in done.stdout.decode(encoding)
    assert b"\r" not in done.stdout
