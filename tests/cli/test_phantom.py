from __future__ import annotations

import argparse
import json
from pathlib import Path

import pydicom
import pytest

from ronnaplan.cli import main, phantom
from ronnaplan.errors import InputError, UsageError


def run(*arguments: str) -> int:
    parser = argparse.ArgumentParser()
    phantom.configure(parser)
    return phantom.run(parser.parse_args(arguments))


SMALL = ("--matrix", "48", "--from", "60", "--to", "64", "--spacing", "2")


def test_the_fast_scanner_writes_series_and_truth(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "ct"
    assert run("patient-3", "-o", str(folder), "--scanner", "fast", "--thickness", "3", *SMALL) == 0
    truth = json.loads((folder / "truth.json").read_text())
    assert [one["label"] for one in truth["markers"]] == ["M1", "M2", "M3"]
    assert truth["scan"]["renderer"] == "fast"
    files = sorted(folder.glob("*.dcm"))
    assert len(files) == 3
    assert float(pydicom.dcmread(files[0]).SliceThickness) == 3.0
    output = capsys.readouterr()
    assert output.out == ""
    assert "not whole in the scan" in output.err
    assert "wrote 3 slices" in output.err


def test_another_scan_is_another_series_in_another_frame_of_reference(tmp_path: Path) -> None:
    scene = tmp_path / "ball.toml"
    scene.write_text(
        '[[part]]\nshape = "sphere"\ncenter = [0, 0, 62]\ndiameter = 5\nmaterial = "steel"\nmarker = "S"\n'
    )

    def written(name: str, *options: str) -> tuple[str, str, str]:
        assert run(str(scene), "-o", str(tmp_path / name), "--scanner", "fast", *SMALL, *options) == 0
        dataset = pydicom.dcmread(tmp_path / name / "CT0001.dcm")
        return dataset.SeriesInstanceUID, dataset.FrameOfReferenceUID, dataset.SOPInstanceUID

    first = written("first")
    assert written("again") == first
    others = [written(option, option, "0.5") for option in ("--dose", "--tilt")]
    assert all(len(set(uids)) == 3 for uids in zip(first, *others, strict=True))


def test_the_full_scanner_follows_its_options(tmp_path: Path) -> None:
    options = ("--kernel", "bone", "--dose", "0.3", "--seed", "9", "--tilt", "10", "--transfer-syntax", "rle")
    assert run("random-patient", "-o", str(tmp_path / "ct"), *SMALL, "--from", "62", *options) == 0
    truth = json.loads((tmp_path / "ct" / "truth.json").read_text())
    assert truth["scene"] == "random patient 9"
    assert (truth["scan"]["kernel"], truth["scan"]["dose"], truth["scan"]["tilt_deg"]) == ("bone", 0.3, 10.0)
    dataset = pydicom.dcmread(next((tmp_path / "ct").glob("*.dcm")))
    assert dataset.file_meta.TransferSyntaxUID == "1.2.840.10008.1.2.5"


def test_a_scene_file_is_scanned(tmp_path: Path) -> None:
    scene = tmp_path / "ball.toml"
    scene.write_text(
        '[[part]]\nshape = "sphere"\ncenter = [0, 0, 62]\ndiameter = 5\nmaterial = "steel"\nmarker = "S"\n'
    )
    assert run(str(scene), "-o", str(tmp_path / "ct"), "--scanner", "fast", *SMALL) == 0
    assert json.loads((tmp_path / "ct" / "truth.json").read_text())["markers"][0]["material"] == "steel"


def test_the_list_shows_every_scene_with_its_picture(capsys: pytest.CaptureFixture[str]) -> None:
    from phantoms.library import READY

    assert run("--list") == 0
    shown = capsys.readouterr().out
    assert all(f"{name}: " in shown for name in READY)
    assert shown.count("●") > 40
    assert "patient-3: patient with 3 freely placed markers on bone screws; markers of 11.5 mm\n" in shown


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["no-such-scene"], "no ready-made scene is called 'no-such-scene'"),
        (["random-patient", "--protocol", "no such"], "no protocol is called 'no such'"),
        (["patient-3", "--protocol", "rendered triangle"], "a protocol scans random-patient only"),
        (["patient-3", "--kernel", "sharp"], "unknown kernel 'sharp'"),
        (["patient-3", "--dose", "-1"], "dose is -1.0; expected zero or more"),
        (["patient-3", "--spacing", "0"], "spacing is 0.0 mm; expected a positive length"),
        (["patient-3", "--from", "80", "--to", "20"], "no slice lies between"),
        (["patient-3", "--tilt", "80"], "tilt is 80.0 degrees"),
        (["patient-3", "--transfer-syntax", "jpeg"], "unknown transfer syntax 'jpeg'"),
        (["patient-3", "--kilovolts", "20", "--matrix", "32"], "tube voltage is 20.0 kV"),
        (["patient-3", "--kilovolts", "20", "--scanner", "fast"], "tube voltage is 20.0 kV"),
        (["patient-3", "--scatter", "0.02", "--scanner", "fast"], "the fast renderer scatters nothing"),
        (
            ["random-patient", "--protocol", "rendered triangle", "--scatter", "0.02"],
            "the fast renderer scatters nothing",
        ),
    ],
)
def test_what_no_option_can_say_is_wrong_usage_and_writes_nothing(
    tmp_path: Path, arguments: list[str], sentence: str
) -> None:
    with pytest.raises(UsageError, match=sentence):
        run(*arguments, "-o", str(tmp_path / "ct"))
    assert list(tmp_path.iterdir()) == []


def test_a_scene_file_that_is_none_is_one_sentence_and_writes_nothing(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"cannot read nowhere\.toml"):
        run("nowhere.toml", "-o", str(tmp_path / "ct"))
    assert list(tmp_path.iterdir()) == []


def test_scene_and_folder_are_both_needed() -> None:
    with pytest.raises(UsageError, match="a scene and -o DIR are needed"):
        run("patient-3")


def test_a_seed_below_zero_is_wrong_usage(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["phantom", "patient-3", "-o", str(tmp_path / "x"), "--seed", "-1"]) == 2
    assert "--seed: -1 is out of range" in capsys.readouterr().err


def test_a_foreign_folder_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("keep me")
    with pytest.raises(InputError, match="choose a new folder"):
        run("patient-3", "-o", str(tmp_path), "--scanner", "fast", *SMALL)
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]
