"""Results are written from Python as the command line writes them."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import SimpleITK as sitk
from pydicom.dataset import Dataset

from ronnaplan import read_ct, read_registration, register_markers, write_as, write_fiducials, write_registration
from ronnaplan.cli import main
from ronnaplan.ct import CTVolume, SeriesSource
from ronnaplan.ct.catalogue import Catalogue, find_series
from ronnaplan.documents.fiducials import read_fiducials
from ronnaplan.errors import FrameMismatchError, RonnaplanError, UnwrittenError, UsageError
from ronnaplan.localization import Fiducial, Fiducials
from tests import cases
from tests.ct import makers
from tests.registration import scene

GRID = [[0, 0, 9.0, -20], [0, 8.0, 0, -10], [12.0, 0, 0, 20], [0, 0, 0, 1.0]]
COVARIANCE = 1e-4 * np.eye(3)


def found(uid: str | None = scene.CT.uid) -> Fiducials:
    markers = tuple(
        Fiducial(label, center, COVARIANCE, COVARIANCE, cases.ball_parameters(), 0.9, 0.01)
        for label, center in zip(scene.ct_points().labels, scene.HEAD, strict=True)
    )
    return Fiducials(markers, (), (11.5,), SeriesSource(frame_of_reference_uid=uid), "00")


def scan(uid: str | None = scene.CT.uid) -> CTVolume:
    return CTVolume.from_array(np.zeros((3, 4, 5), np.int16), GRID, uid)


def test_what_python_writes_is_read_and_exported(tmp_path: Path) -> None:
    markers, file = tmp_path / "fiducials.json", tmp_path / "registration.json"
    assert write_fiducials(markers, found()) == read_fiducials(markers)
    registered = register_markers(found().points, scene.readings(), sigma_ct_mm=0.1)
    document = write_registration(file, registered, found(), [[10.0, -5, -20]])
    assert document == read_registration(file)
    assert json.loads(file.read_text())["targets"][0]["name"] == "target 1"
    assert document.pose.matrix is not None
    assert registered.registration is not None
    np.testing.assert_allclose(document.pose.matrix, registered.registration.transform, atol=1e-12)
    write_as(tmp_path / "ct_from_ots.tfm", document, "itk")
    transform = sitk.ReadTransform(str(tmp_path / "ct_from_ots.tfm"))
    place = registered.registration.pose.apply([[10.0, -5, -20]])[0]
    np.testing.assert_allclose(transform.TransformPoint(place.tolist()), [10.0, -5, -20], atol=1e-9)
    again = write_registration(file, registered, read_fiducials(markers))  # another content: the next revision
    assert again.revision == 1


def test_a_map_of_the_error_has_the_scans_voxels_from_python_and_from_the_command_line(tmp_path: Path) -> None:
    registered = register_markers(found().points, scene.readings(), sigma_ct_mm=0.1)
    file = tmp_path / "registration.json"
    document = write_registration(file, registered, found())
    tre = document.tre_map(scan())
    places = scan().grid.positions_mm(np.moveaxis(np.indices((3, 4, 5)), 0, -1).reshape(-1, 3).astype(float))
    np.testing.assert_allclose(tre.values.ravel(), document.expected.tre_rms_mm(places), rtol=1e-5)
    with pytest.raises(FrameMismatchError, match=r"1\.2\.3"):
        document.tre_map(scan("1.2.3"))
    sitk.WriteImage(scan(None).to_sitk(), str(tmp_path / "ct.nii.gz"))
    volume = CTVolume.from_sitk(scan(None).to_sitk())
    nameless = replace(
        found(None), voxel_sha256=volume.voxel_sha256
    )  # NIfTI names no frame: the voxels tell the scan
    written = write_registration(
        file, register_markers(nameless.points, scene.readings(), sigma_ct_mm=0.1), nameless
    )
    for name in ("map.nii.gz", "map.mha", "map.nrrd"):
        out = str(tmp_path / name)
        assert main(["export", str(file), "--to", "tre-map", "--ct", str(tmp_path / "ct.nii.gz"), "-o", out]) == 0
        np.testing.assert_array_equal(sitk.GetArrayFromImage(sitk.ReadImage(out)), written.tre_map(volume).values)
    with pytest.raises(FrameMismatchError, match="their voxels differ"):
        written.tre_map(CTVolume.from_array(np.ones((3, 4, 5), np.int16), GRID))


@pytest.mark.parametrize("name", ["map.nii.gz", "map.nii", "map.nrrd", "map.mha"])
def test_a_map_that_has_no_room_is_told_and_no_part_of_it_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    monkeypatch.setattr(sys, "dont_write_bytecode", True)  # what is imported below would be kept cut short
    resource = pytest.importorskip("resource")
    makers.write_series(tmp_path / "ct")
    volume = read_ct(tmp_path / "ct")
    markers = replace(found(makers.FRAME), source=volume.source, voxel_sha256=volume.voxel_sha256)
    registered = register_markers(markers.points, scene.readings(), sigma_ct_mm=0.1)
    document = write_registration(tmp_path / "registration.json", registered, markers)
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100, before[1]))
    try:
        with pytest.raises(UnwrittenError, match="cannot be read back as it was written; make room"):
            write_as(tmp_path / name, document, "tre-map", tmp_path / "ct")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert not (tmp_path / name).exists()


def test_a_map_lies_on_that_stack_of_a_series_whose_markers_were_registered(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def second(made: Dataset, k: int) -> None:
        made.AcquisitionNumber, made.ImagePositionPatient = 2, [-10, -20, 31 + 2 * k]
        made.PixelData = (makers.pattern(k) + 7).tobytes()

    makers.write_series(tmp_path / "ct")
    makers.write_series(tmp_path / "ct", change=second, prefix="second")
    volume = read_ct(tmp_path / "ct", f"{makers.SERIES}#2")
    markers = replace(found(makers.FRAME), source=volume.source, voxel_sha256=volume.voxel_sha256)
    registered = register_markers(markers.points, scene.readings(), sigma_ct_mm=0.1)
    document = write_registration(tmp_path / "registration.json", registered, markers)
    listed: list[object] = []

    def find(path: str | Path, *given: Any, **how: Any) -> Catalogue:
        listed.append(path)
        return find_series(path, *given, **how)

    for module in ("ronnaplan.documents.tre_image", "ronnaplan.ct.reader"):
        monkeypatch.setattr(f"{module}.find_series", find)
    write_as(tmp_path / "map.nrrd", document, "tre-map", tmp_path / "ct")
    assert len(listed) == 1  # headers of whole folders take long
    assert sitk.ReadImage(str(tmp_path / "map.nrrd")).GetOrigin() == (-10.0, -20.0, 31.0)


WRONG: dict[str, tuple[Callable[[Path], object], str]] = {
    "no name": (lambda path: main(["export", str(path), "--to", "tre-map", "--ct", "x"]), "name its file with -o"),
    "no scan": (lambda path: write_as(path.with_name("m.nii"), path, "tre-map"), "no scan was given"),
    "no image": (lambda path: write_as(path.with_name("m.png"), path, "tre-map", "x"), r"ends in \.nii\.gz"),
    "no transform's name": (lambda path: write_as(path.with_name("m.h5"), path, "itk"), r"ends in \.tfm or \.txt"),
    "no point list's name": (
        lambda path: write_as(path.with_name("m.fcsv"), path, "markups"),
        r"ends in \.mrk\.json",
    ),
    "no table's name": (lambda path: write_as(path.with_name("m.fcsv"), path, "csv"), r"ends in \.csv or \.txt"),
    "of fiducials": (
        lambda path: write_as(path.with_name("m.nii"), cases.fiducials(), "tre-map", "x"),
        "fiducials cannot become 'tre-map'; choose one of markups, csv, dicom",
    ),
    "a registration alone": (
        lambda path: write_registration(path, found(), found()),  # type: ignore[arg-type]
        "register_markers returns it",
    ),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_cannot_be_written_is_refused(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "registration.json"
    write_registration(file, register_markers(found().points, scene.readings(), sigma_ct_mm=0.1), found())
    call, told = WRONG[name]
    if name == "no name":
        assert call(file) == 2
        assert told in capsys.readouterr().err
    else:
        with pytest.raises(UsageError, match=told):
            call(file)
        assert [path.name for path in tmp_path.iterdir()] == ["registration.json"]


def test_the_markers_of_another_scan_are_refused(tmp_path: Path) -> None:
    registered = register_markers(found().points, scene.readings(), sigma_ct_mm=0.1)
    with pytest.raises(FrameMismatchError, match=r"1\.2\.3"):
        write_registration(tmp_path / "registration.json", registered, found("1.2.3"))
    with pytest.raises(RonnaplanError):
        read_registration(tmp_path / "registration.json")
