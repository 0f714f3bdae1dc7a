"""``ronnaplan plan template``: body, document and drawing beside each other; what cannot be is refused."""

from pathlib import Path

import numpy as np
import pytest

from ronnaplan.cli import main
from ronnaplan.documents.template import printed_template_document, read_template_document
from ronnaplan.planning.template_layout import Bridge, TemplateLayout
from tests.cases import CT
from tests.long import few_and_others
from tests.planning.test_template import read_body

MIRRORED = "their own mirror image"
"""What is told of four flat markers."""


def test_a_standard_head_gives_body_document_and_drawing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    body = tmp_path / "t.3mf"
    ask = ["plan", "template", "--markers", "3", "--screw-play", "0.3", "--name", "T1", "-o", str(body)]
    assert main(ask) == 0
    assert read_body(body.read_bytes(), body.suffix).is_watertight
    assert {one.name for one in tmp_path.iterdir()} == {"t.3mf", "t.json", "t.svg", "t.pdf"}
    read = read_template_document(tmp_path / "t.json")
    assert (read.name, read.labels) == ("T1", ("A", "B", "C"))
    assert read.tolerance == pytest.approx(4 * np.sqrt(2 * ((0.2**2 + 0.3**2) / 3 + 0.15**2)), abs=1e-3)
    told = capsys.readouterr().out
    assert "mm away, refused for it in less than 0.001 %" in told
    assert "0.21 mm of print and screws" in told


@pytest.mark.parametrize(
    ("options", "status", "sentence"),
    [
        (["--markers", "7"], 1, "3 to 6"),
        (["--markers", "3", "--radius", "0"], 1, "bent to a radius of 0 mm"),
        (["--markers", "3", "--thickness", "0"], 1, "0 mm thick"),
        (
            ["--markers", "3", "--flat", "--name", "a\nb"],
            1,
            "name: holds characters that no line of text can show",
        ),
        (["--markers", "3", "--at", "0", "0", "0"], 2, "--at is a place of the scan"),
        (["--markers", "3", "--flat", "--series", "1.2.3"], 2, "--series is one of the scan"),
        (["--markers", "3", "--size", "55", "40", "--screw-play", "3"], 3, "expected"),
    ],
)
def test_what_cannot_be_is_refused(
    options: list[str], status: int, sentence: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["plan", "template", *options, "-o", str(tmp_path / "t.stl")]) == status
    assert sentence in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_nothing_is_written_where_one_of_its_files_cannot_be(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The body and its document were those of a new template then, the drawing none or an earlier one's."""
    (tmp_path / "t.pdf").mkdir()
    assert main(["plan", "template", "--markers", "3", "--flat", "-o", str(tmp_path / "t.stl")]) == 1
    assert "t.pdf is no regular file" in capsys.readouterr().err
    assert [one.name for one in tmp_path.iterdir()] == ["t.pdf"]


def test_another_kind_of_body_is_refused(tmp_path: Path) -> None:
    assert main(["plan", "template", "--markers", "3", "-o", str(tmp_path / "t.obj")]) == 2


def test_no_other_document_is_replaced_by_the_one_beside_the_body_but_a_template(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    beside = tmp_path / "plan.json"
    beside.write_text('{"format": "ronnaplan.plan"}')
    command = ["plan", "template", "--markers", "3", "--flat", "-o", str(tmp_path / "plan.stl")]
    assert main(command) == 1
    assert "plan.json is no template, and would be lost" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["plan.json"]
    found = TemplateLayout(Bridge(), np.array([[-45.0, -25.0], [-20.0, 28.0], [50.0, 10.0]]))
    beside.write_text(printed_template_document(found, "an earlier one"))
    assert main(command) == 0
    told = capsys.readouterr()
    assert MIRRORED not in told.out + told.err
    assert read_template_document(beside).name != "an earlier one"
    assert read_body((tmp_path / "plan.stl").read_bytes(), ".stl").is_watertight


@few_and_others(("options", "is_told"), [(["4", "--flat"], True)], [(["4"], False)])
def test_who_wants_four_flat_markers_is_told_what_their_mirror_image_costs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], options: list[str], is_told: bool
) -> None:
    assert main(["plan", "template", "--markers", *options, "-o", str(tmp_path / "t.stl")]) == 0
    told = capsys.readouterr()
    assert (MIRRORED in told.out + told.err) is is_told


def test_a_plate_for_a_scan_may_be_wider_than_a_standard_head_is_bent(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    size = ["--markers", "3", "--size", "170", "60"]
    assert main(["plan", "template", *size, "-o", str(tmp_path / "t.stl")]) == 1
    assert "170 mm wide was to be bent to a radius of 80 mm" in capsys.readouterr().err
    assert main(["plan", "template", *size, "--ct", str(CT), "-o", str(tmp_path / "t.stl")]) == 0
    assert "bent to a radius of 8" in capsys.readouterr().out
