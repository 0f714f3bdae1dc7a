import json
import zipfile
from pathlib import Path

import pytest
from pydicom.dataset import Dataset

from ronnaplan.cli import main
from tests.ct.makers import SERIES, write_series


def mixed(folder: Path) -> Path:
    write_series(folder / "ct")

    def scout(made: Dataset, k: int) -> None:
        made.ImageType, made.SeriesInstanceUID = ["ORIGINAL", "PRIMARY", "LOCALIZER"], "1.2.3.7"
        made.SeriesDescription = "Scout\x1b[31m"

    write_series(folder / "scout", 1, scout)
    (folder / "readme.txt").write_text("no image")
    return folder


def test_the_table_shows_each_series_and_why_one_cannot_be_used(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["series", str(mixed(tmp_path))]) == 0
    shown = capsys.readouterr().out
    assert "yes  CT        4       8 x 10  0.500 x 0.750  2.000   0.0       H30     Head 2 mm" in shown
    assert SERIES in shown
    assert "cannot be used: a localizer (projection image)" in shown
    assert "\n1 other file:\n" in shown
    assert "readme.txt: it is not a DICOM file" in shown
    assert "\x1b" not in shown


def test_json_says_the_same_for_a_program(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["series", str(mixed(tmp_path)), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["format"] == "ronnaplan.series"
    usable = {entry["series"]: entry["usable"] for entry in document["series"]}
    assert usable == {SERIES: True, "1.2.3.7": False}
    assert document["series"][0]["spacing_mm"] == [2, 2]


@pytest.mark.parametrize("name", ["ct.tar.gz", "ct.tgz", "ct.7z", "0001.dcm.gz"])
def test_what_is_packed_in_a_way_that_is_not_read_is_told_to_be_unpacked(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / name).write_bytes(b"\x1f\x8b packed")
    assert main(["series", str(tmp_path / name)]) == 1
    assert "(it is packed in a way that is not read; unpack it first)" in capsys.readouterr().err


def test_an_archive_within_an_archive_is_told_to_be_unpacked(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_series(tmp_path / "ct", 1)
    with zipfile.ZipFile(tmp_path / "inner.zip", "w") as inner:
        inner.write(next((tmp_path / "ct").iterdir()))
    with zipfile.ZipFile(tmp_path / "outer.zip", "w") as outer:
        outer.write(tmp_path / "inner.zip", "inner.zip")
    assert main(["series", str(tmp_path / "outer.zip")]) == 1
    assert "unpack it first" in capsys.readouterr().err


def test_what_the_parts_of_a_series_differ_in_is_told_of_each_and_of_no_whole_one(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """As a name that was corrected at the scanner leaves it: the rows looked alike, and one had to be chosen."""
    write_series(tmp_path)

    def renamed(made: Dataset, k: int) -> None:
        made.PatientName, made.StudyInstanceUID = "Doe^Janet", "1.2.3.98"
        made.ImagePositionPatient = [0, 0, 100 + 2 * k]

    write_series(tmp_path, 3, renamed, prefix="renamed")
    assert main(["series", str(tmp_path)]) == 0
    shown = capsys.readouterr().out
    assert shown.count("a part of its series, which mixes studies, patients\n") == 2
    assert "Doe" not in shown
    assert main(["series", str(tmp_path), "--json"]) == 0
    assert [one["apart"] for one in json.loads(capsys.readouterr().out)["series"]] == [["studies", "patients"]] * 2
    assert main(["series", str(write_series(tmp_path / "whole"))]) == 0
    assert "mixes" not in capsys.readouterr().out


def test_each_part_of_a_series_says_what_it_is(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """As of two tubes: all else of the rows is alike, and one has to be chosen."""
    write_series(tmp_path, change=lambda made, k: setattr(made, "KVP", "80"))

    def high(made: Dataset, k: int) -> None:
        made.KVP, made.RescaleIntercept = "140", -1000

    write_series(tmp_path, 4, high, prefix="high")
    assert main(["series", str(tmp_path)]) == 0
    shown = capsys.readouterr().out
    for kilovolts in (80, 140):
        assert f"which mixes tube voltages; this one: tube voltage {kilovolts} kV\n" in shown


@pytest.mark.parametrize("also", [[], ["--json"]])
def test_the_patients_name_is_shown_only_when_asked_for(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], also: list[str]
) -> None:
    write_series(tmp_path)
    assert main(["series", str(tmp_path), *also]) == 0
    assert "Doe" not in capsys.readouterr().out
    assert main(["series", str(tmp_path), "--patient", *also]) == 0
    assert "Doe^Jane" in capsys.readouterr().out


@pytest.mark.parametrize("name", ["nowhere", "empty", "text"])
def test_what_holds_no_series_is_one_sentence_and_exit_status_1(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "text").write_text("hello")
    assert main(["series", str(tmp_path / name)]) == 1
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1


@pytest.mark.parametrize("content", [b"", b"x"])
def test_what_is_named_like_an_archive_and_is_none_is_told(
    content: bytes, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "bad.zip").write_bytes(content)
    assert main(["series", str(tmp_path / "bad.zip")]) == 1
    assert "holds no DICOM series (it is no zip archive in spite of its name; copy it" in capsys.readouterr().err
    write_series(tmp_path / "ct")
    with zipfile.ZipFile(tmp_path / "good.zip", "w") as made:
        made.write(next((tmp_path / "ct").iterdir()))
    assert main(["series", str(tmp_path)]) == 0
    shown = capsys.readouterr().out
    assert "bad.zip: it is no zip archive in spite of its name" in shown
    assert "good.zip: it is an image file or archive; name it by itself" in shown
