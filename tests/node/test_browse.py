"""What an archive has can be looked through, by DIMSE and by DICOMweb."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydicom.uid import UID
from pynetdicom.association import Association

from ronnaplan.errors import InputError
from ronnaplan.node.archives import open_archive
from ronnaplan.node.browse import Shelf, listed_series, thumbnail
from ronnaplan.node.config import Config, Peer
from ronnaplan.node.pull import Wanted
from tests.ct import makers
from tests.long import few_and_others
from tests.node.peers import Orthanc, free_port, save

STUDY, CT, OTHER = "1.2.3.600", "1.2.3.600.1", "1.2.3.600.2"
SLICES = 5


def instance(series: str, k: int) -> Any:
    stored = np.zeros((64, 64), np.int16)
    stored[:, : 8 * (k + 1)] = 1000  # the slice that is shown is known by how much of it is bright
    made = makers.dataset(k, stored=stored)
    made.PatientID, made.StudyInstanceUID, made.SeriesInstanceUID = "BROWSED", STUDY, series
    made.SOPInstanceUID = UID(f"{series}.{SLICES - k}")  # not in their order
    made.file_meta.MediaStorageSOPInstanceUID = made.SOPInstanceUID
    made.SeriesDescription, made.InstanceNumber = f"series {series[-1]}", k + 1
    return made


@pytest.fixture(scope="module")
def archive(orthanc: Orthanc, tmp_path_factory: pytest.TempPathFactory) -> Orthanc:
    folder = tmp_path_factory.mktemp("sent")
    for series, count in ((CT, SLICES), (OTHER, 1)):
        for k in range(count):
            orthanc.post("/instances", save(instance(series, k), folder / f"{series}.{k}.dcm").read_bytes())
    return orthanc


@few_and_others("way", ["get", "web"], ["move"])
def test_series_are_listed_each_with_a_picture_of_its_middle(way: str, archive: Orthanc, tmp_path: Path) -> None:
    port = free_port()
    archive.know("node", "RONNAPLAN", port)
    config, by = Config(port=port, home=tmp_path), None if way == "web" else way
    peer = Peer(name="pacs", title="ORTHANC", port=archive.port)
    if way == "web":
        peer = Peer(name="pacs", url=f"http://127.0.0.1:{archive.http}/dicom-web")
    with open_archive(config, peer, by) as opened:
        found = sorted(listed_series(opened, Wanted(patient_id="BROWSED")), key=lambda one: one.series_uid)
        assert [(one.series_uid, one.modality, one.description) for one in found] == [
            (CT, "CT", "series 1"),
            (OTHER, "CT", "series 2"),
        ]
        assert {one.study_uid for one in found} == {STUDY}
        assert {one.instances for one in found} <= {SLICES, 1, None}
        picture = thumbnail(opened, found[0])
        assert picture is not None
        assert picture.shape == (96, 96)
        assert np.mean(picture > 128) == pytest.approx(3 / 8, abs=0.03)
        assert listed_series(opened, Wanted(patient_id="NOBODY")) == []


def test_no_answer_is_lost_to_a_library_that_is_slow_to_wait(
    archive: Orthanc, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def slow(association: Association, paused: bool) -> None:
        end = time.monotonic() + 0.2
        while not paused and time.monotonic() < end and association.dimse.msg_queue.empty():
            pass  # as if another thread had the processor: pynetdicom's own took an answer then
        association.__dict__["_is_paused"] = paused

    monkeypatch.setattr(
        Association, "_is_paused", property(lambda one: one.__dict__["_is_paused"], slow), raising=False
    )
    peer = Peer(name="pacs", title="ORTHANC", port=archive.port)
    keys = {"StudyInstanceUID": STUDY, "SeriesInstanceUID": CT, "SOPInstanceUID": ""}
    with open_archive(Config(home=tmp_path), peer) as opened:
        assert [len(opened.find("IMAGE", keys)) for _ in range(3)] == 3 * [SLICES]


def test_a_match_that_cannot_be_read_is_an_error(
    archive: Orthanc, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pynetdicom.association.decode", lambda *_: 1 / 0)
    peer = Peer(name="pacs", title="ORTHANC", port=archive.port)
    with open_archive(Config(home=tmp_path), peer) as opened, pytest.raises(InputError, match="cannot be read"):
        listed_series(opened, Wanted(patient_id="BROWSED"))


def test_a_series_that_is_gone_has_no_picture(archive: Orthanc, tmp_path: Path) -> None:
    peer = Peer(name="pacs", url=f"http://127.0.0.1:{archive.http}/dicom-web")
    with open_archive(Config(home=tmp_path), peer) as opened:
        (one, *_) = listed_series(opened, Wanted(study_uid=STUDY))
        gone = type(one)(**{**vars(one), "series_uid": "1.2.3.404"})
        assert thumbnail(opened, gone) is None


def test_a_shelf_names_no_patient_unless_asked_to_and_brings_a_series(archive: Orthanc, tmp_path: Path) -> None:
    peer = Peer(name="pacs", title="ORTHANC", port=archive.port)
    shelf = Shelf(Config(home=tmp_path), peer)
    rows = shelf.look("BROWSED", "")
    assert [(one["patient_id"], one["patient_name"]) for one in rows] == 2 * [("BROWSED", "")]
    (named, _) = Shelf(Config(home=tmp_path), peer, names=True).look("BROWSED", "")
    assert named["patient_name"] == str(instance(CT, 0).PatientName)
    number = next(n for n, one in enumerate(rows) if one["series_uid"] == CT)
    picture = shelf.picture(number)
    assert picture is not None
    assert picture.shape == (96, 96)
    shelf.fetch(number, tmp_path)
    assert sorted(path.name for path in tmp_path.glob("*.dcm")) == [f"{CT}.{k + 1}.dcm" for k in range(SLICES)]
    for gone in (2, -1):
        with pytest.raises(InputError, match="no longer listed"):
            shelf.fetch(gone, tmp_path)
