from __future__ import annotations

import errno
import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pydicom
import pytest
from pydicom.tag import BaseTag, tag_in_exception

from phantoms import output
from phantoms.anatomy import scalp_foot
from phantoms.errors import PhantomError
from phantoms.fast import render
from phantoms.markers import MarkerKind, marker
from phantoms.output import write_phantom
from phantoms.scene import Part, Scene
from phantoms.series import TRANSFER_SYNTAXES, SeriesOptions
from phantoms.solids import sphere
from phantoms.stack import SliceStack, axial_stack
from tests.long import few_and_others


@pytest.fixture
def scene() -> Scene:
    return Scene((Part(sphere((0, 0, 0), 40), "water"),), name="ball") + marker(
        "M1", scalp_foot((0, 0, 1), 0.22), MarkerKind(5.0, "ceramic")
    )


@pytest.fixture
def stack() -> SliceStack:
    return axial_stack(
        start_mm=-3, stop_mm=30, spacing_mm=3, thickness_mm=4, matrix=64, field_of_view_mm=64, tilt_deg=12
    )


@few_and_others("syntax", ["explicit", "jpeg-2000"], sorted({*TRANSFER_SYNTAXES} - {"explicit", "jpeg-2000"}))
def test_written_values_and_places_are_read_back(
    tmp_path: Path, scene: Scene, stack: SliceStack, syntax: str
) -> None:
    images = render(scene, stack, seed=3)
    options = SeriesOptions(order="shuffled", slope=0.5, intercept=-500, transfer_syntax=syntax)
    write_phantom(tmp_path / "ct", scene, stack, images, options)
    datasets = sorted(
        (pydicom.dcmread(path) for path in (tmp_path / "ct").glob("*.dcm")),
        key=lambda dataset: float(dataset.ImagePositionPatient[2]),
    )
    stored = np.stack([d.pixel_array * float(d.RescaleSlope) + float(d.RescaleIntercept) for d in datasets])
    assert (stored == images).all()
    assert np.array([d.ImagePositionPatient for d in datasets], dtype=float) == pytest.approx(stack.origins_mm)
    orientation = np.array(datasets[0].ImageOrientationPatient, dtype=float)
    assert orientation == pytest.approx(np.concatenate([stack.column_direction, stack.row_direction]))
    assert [d.InstanceNumber for d in datasets] != sorted(d.InstanceNumber for d in datasets)
    truth = json.loads((tmp_path / "ct" / "truth.json").read_text())
    assert truth["markers"][0]["center"] == pytest.approx(scene.markers[0].center_mm)
    assert truth["markers"][0]["whole_in_scan"] is True


def test_a_marker_cut_by_the_scans_edge_is_flagged(tmp_path: Path, scene: Scene) -> None:
    stack = axial_stack(start_mm=0, stop_mm=20, matrix=32, field_of_view_mm=64)
    write_phantom(tmp_path / "ct", scene, stack, render(scene, stack))
    assert json.loads((tmp_path / "ct" / "truth.json").read_text())["markers"][0]["whole_in_scan"] is False


def test_only_an_earlier_phantom_is_replaced(tmp_path: Path, scene: Scene, stack: SliceStack) -> None:
    images = render(scene, stack)
    write_phantom(tmp_path / "ct", scene, stack, images)
    write_phantom(tmp_path / "ct", scene, stack, images)
    assert [path.name for path in tmp_path.iterdir()] == ["ct"]
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.txt").write_text("irreplaceable")
    with pytest.raises(PhantomError, match="choose a new folder"):
        write_phantom(tmp_path / "mine", scene, stack, images)
    assert [path.name for path in (tmp_path / "mine").iterdir()] == ["thesis.txt"]


def test_a_failure_leaves_nothing_behind(tmp_path: Path, scene: Scene, stack: SliceStack) -> None:
    with pytest.raises(PhantomError, match="do not fit 16 bits"):
        write_phantom(tmp_path / "ct", scene, stack, render(scene, stack), SeriesOptions(slope=0.01))
    assert list(tmp_path.iterdir()) == []


def test_a_disk_that_fills_amid_the_pixels_is_told_in_a_sentence_and_leaves_nothing_behind(
    tmp_path: Path, scene: Scene, stack: SliceStack, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where it fills within an element, pydicom raises another error, whose text is a traceback."""

    def full(*_: object) -> None:
        with tag_in_exception(BaseTag(0x7FE00010)):
            raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(output, "write_series", full)
    with pytest.raises(PhantomError, match=r"^cannot write to \S+: No space left on device; make room, or choose"):
        write_phantom(tmp_path / "ct", scene, stack, render(scene, stack), SeriesOptions())
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(shutil.which("dciodvfy") is None, reason="dciodvfy of Debian's dicom3tools is not installed")
@few_and_others("options", [SeriesOptions()], [SeriesOptions(padding_hu=-2000, transfer_syntax="jpeg-ls")])
def test_an_independent_validator_finds_no_fault(
    tmp_path: Path, scene: Scene, stack: SliceStack, options: SeriesOptions
) -> None:
    write_phantom(tmp_path / "ct", scene, stack, render(scene, stack), options)
    for path in (tmp_path / "ct").glob("*.dcm"):
        answer = subprocess.run(["dciodvfy", str(path)], capture_output=True, text=True, check=False)
        assert "Error" not in answer.stderr
        assert "Warning" not in answer.stderr


def test_when_the_exchange_fails_the_earlier_phantom_stays(
    tmp_path: Path, scene: Scene, stack: SliceStack, monkeypatch: pytest.MonkeyPatch
) -> None:
    images = render(scene, stack)
    write_phantom(tmp_path / "ct", scene, stack, images)
    before = {path.name: path.read_bytes() for path in (tmp_path / "ct").iterdir()}
    rename = Path.rename

    def fail_for_the_new(self: Path, target: Path) -> Path:
        if self.name == "new":
            raise PermissionError(13, "Permission denied")
        return rename(self, target)

    monkeypatch.setattr(Path, "rename", fail_for_the_new)
    with pytest.raises(PhantomError, match="Permission denied"):
        write_phantom(tmp_path / "ct", scene, stack, images)
    assert {path.name: path.read_bytes() for path in (tmp_path / "ct").iterdir()} == before
    assert [path.name for path in tmp_path.iterdir()] == ["ct"]
