"""From a scan on the wire to its markers in an archive, with nobody at the keyboard."""

from __future__ import annotations

import io
import json
import shutil
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydicom import dcmread
from pydicom.dataset import FileDataset

from ronnaplan.documents.dicom_spatial import SPATIAL_REGISTRATION
from ronnaplan.node.hub import Hub
from ronnaplan.node.index import Index
from ronnaplan.node.logs import Log
from ronnaplan.report.pdf import find_browser
from tests import cases
from tests.node.peers import Orthanc, free_port, needs, program, send, until, write_toml

SCAN = Path("data/synthetic_ct")
REST = """
[jobs]
retry_s = 1.0
[[peer]]
name = "pacs"
title = "ORTHANC"
port = {archive}
[[peer]]
name = "web"
url = "http://127.0.0.1:{http}/dicom-web"
[[rule]]
name = "skin"
diameters = [11.5]
expected = 6
answers = ["fiducials", "sr", "pdf", "sheet"]
receivers = ["pacs", "web"]
documents = "documents"
"""
CLASSES = {
    "fiducials": "1.2.840.10008.5.1.4.1.1.66.2",
    "sr": "1.2.840.10008.5.1.4.1.1.88.34",
    "pdf": "1.2.840.10008.5.1.4.1.1.104.1",
    "sheet": "1.2.840.10008.5.1.4.1.1.7",
}


class Running:
    """A node that a test moves on, and what it said."""

    def __init__(self, home: Path, orthanc: Orthanc) -> None:
        from ronnaplan.node.config import read_config

        self.port, self.said = free_port(), io.StringIO()
        path = write_toml(home, self.port, REST.format(archive=orthanc.port, http=orthanc.http), quiet_s=2.0)
        self.config = read_config(path)
        self.config.data.mkdir()
        self.index = Index(self.config.data)
        self.hub = Hub(path, self.config, self.index, Log(self.said))

    def tick_until(self, condition: Any, seconds: float = 500.0) -> None:
        def done() -> bool:
            self.hub.tick(time.time(), time.perf_counter())
            return bool(condition())

        until(done, seconds)

    def events(self, kind: str) -> list[dict[str, Any]]:
        return [line for line in map(json.loads, self.said.getvalue().splitlines()) if line["event"] == kind]


@pytest.fixture(scope="module")
def answered(orthanc: Orthanc, tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Running, Orthanc]]:
    """The committed scan was sent, and everything that answers it was delivered."""
    running = Running(tmp_path_factory.mktemp("node"), orthanc)
    orthanc.know("node", "RONNAPLAN", running.port)
    running.tick_until(lambda: running.events("listening"))
    send(running.port, *sorted(SCAN.glob("*.dcm")), options=["-xt"])
    wanted = 4 if find_browser() else 3
    running.tick_until(lambda: len(running.events("delivered")) == 2 * wanted and running.events("job ended"))
    running.tick_until(lambda: sum(one["kept"] for one in running.events("commitment")) == wanted)
    yield running, orthanc
    running.hub.close()
    running.index.close()


def objects(orthanc: Orthanc) -> dict[str, FileDataset]:
    found = {str(one.SOPClassUID): one for one in orthanc.instances()}
    return {kind: found[uid] for kind, uid in CLASSES.items() if uid in found}


@needs("storescu")
def test_the_archive_has_one_of_each_in_the_patient_s_own_study(answered: tuple[Running, Orthanc]) -> None:
    _, orthanc = answered
    scan = dcmread(SCAN / "CT0001.dcm", stop_before_pixels=True)
    (patient,) = (orthanc.get(f"/patients/{one}") for one in orthanc.get("/patients"))
    assert patient["MainDicomTags"]["PatientID"] == scan.PatientID
    assert patient["MainDicomTags"]["PatientName"] == str(scan.PatientName)
    (study,) = (orthanc.get(f"/studies/{one}") for one in orthanc.get("/studies"))
    assert study["MainDicomTags"]["StudyInstanceUID"] == scan.StudyInstanceUID
    kinds = [one for one in CLASSES if one != "pdf" or find_browser()]
    assert sorted(objects(orthanc)) == sorted(kinds)
    assert len(orthanc.instances()) == len(kinds)


@needs("storescu")
def test_the_markers_in_the_archive_are_where_the_phantom_has_them(answered: tuple[Running, Orthanc]) -> None:
    truth = np.array([one["center"] for one in json.loads((SCAN / "truth.json").read_text())["markers"]])
    made = objects(answered[1])
    (markers,) = made["fiducials"].FiducialSetSequence
    centers = np.array([one.ContourData for one in markers.FiducialSequence], dtype=float)
    report = [item for item in made["sr"].ContentSequence if item.ValueType == "CONTAINER"]
    groups = [group for item in report for group in item.ContentSequence]
    coordinates = [
        [float(value) for value in point.GraphicData]
        for group in groups
        for number in group.ContentSequence
        if number.ValueType == "NUM"
        for point in number.get("ContentSequence", [])
    ]
    for found in (centers, np.array(coordinates)):
        assert len(found) == len(truth) == 6
        assert np.linalg.norm(found[:, None] - truth, axis=2).min(axis=0).max() < 0.05


@needs("storescu")
def test_the_report_states_the_covariance_of_each_center(answered: tuple[Running, Orthanc]) -> None:
    _, orthanc = answered
    sr = objects(orthanc)["sr"]
    group = next(item for item in sr.ContentSequence if item.ValueType == "CONTAINER").ContentSequence[0]
    numbers = {
        one.ConceptNameCodeSequence[0].CodeValue: float(one.MeasuredValueSequence[0].NumericValue)
        for one in group.ContentSequence
        if one.ValueType == "NUM"
    }
    matrix = np.array([[numbers[f"COVARIANCE_{''.join(sorted(a + b))}"] for b in "XYZ"] for a in "XYZ"])
    assert np.linalg.eigvalsh(matrix).min() > 0
    (fiducial, *_) = objects(orthanc)["fiducials"].FiducialSetSequence[0].FiducialSequence
    assert float(fiducial.ContourUncertaintyRadius) == pytest.approx(np.sqrt(np.trace(matrix)), rel=1e-3)


@needs("storescu")
def test_each_answer_is_listed_under_a_number_of_its_own(answered: tuple[Running, Orthanc]) -> None:
    made = objects(answered[1]).values()
    assert len({one.SeriesNumber for one in made}) == len(made)


@needs("storescu", "dciodvfy", "dsrdump")
def test_validators_find_no_error(answered: tuple[Running, Orthanc], tmp_path: Path) -> None:
    for kind, made in objects(answered[1]).items():
        path = tmp_path / f"{kind}.dcm"
        made.save_as(path, enforce_file_format=True)
        told = subprocess.run(["dciodvfy", "-new", str(path)], capture_output=True, text=True, check=False).stderr
        assert "Error" not in told, told
    shown = subprocess.run(
        [str(program("dsrdump")), str(tmp_path / "sr.dcm")], capture_output=True, text=True, check=True
    )
    assert shown.stdout.count("SCOORD3D") == 6


@needs("storescu")
@pytest.mark.skipif(find_browser() is None, reason="no Chromium is installed to print a PDF with")
def test_the_report_opens_as_a_pdf(answered: tuple[Running, Orthanc], tmp_path: Path) -> None:
    made = objects(answered[1])["pdf"]
    content = made.EncapsulatedDocument[: made.EncapsulatedDocumentLength]
    assert content.startswith(b"%PDF-")
    assert content.rstrip().endswith(b"%%EOF")
    if shutil.which("pdftotext"):
        (tmp_path / "r.pdf").write_bytes(content)
        text = subprocess.run(["pdftotext", str(tmp_path / "r.pdf"), "-"], capture_output=True, check=True).stdout
        assert b"6 markers" in text


@needs("storescu")
def test_a_node_that_starts_again_answers_nothing_twice(answered: tuple[Running, Orthanc]) -> None:
    running, orthanc = answered
    before = len(orthanc.instances())
    running.hub.close()
    running.hub = Hub(running.config.home / "node.toml", running.config, running.index, Log(running.said))
    listened = len(running.events("listening"))
    running.tick_until(lambda: len(running.events("listening")) > listened)
    assert running.index.rows("SELECT count(*) FROM jobs WHERE state != 'done'") == [(0,)]
    assert len(orthanc.instances()) == before
    states = running.index.rows("SELECT state, count(*) FROM deliveries GROUP BY state")
    assert states == [("kept", before), ("sent", before)]  # DICOMweb has no storage commitment


@needs("storescu")
def test_a_registration_and_a_plan_that_come_later_get_into_the_archive_too(
    answered: tuple[Running, Orthanc], tmp_path: Path
) -> None:
    """The last one: it puts a second SR into the archive."""
    running, orthanc = answered
    scan = dcmread(SCAN / "CT0001.dcm", stop_before_pixels=True)
    cases.write_case(tmp_path)
    registration = json.loads((tmp_path / "registration.json").read_text())
    registration["source"]["study_instance_uid"] = scan.StudyInstanceUID
    (tmp_path / "registration.json").write_text(json.dumps(registration))
    folder = running.config.home / "documents" / scan.StudyInstanceUID
    folder.mkdir(parents=True)
    before, sent = len(orthanc.instances()), len(running.events("delivered"))
    for name in ("registration.json", "plan.json"):
        (tmp_path / name).rename(folder / name)
    running.tick_until(lambda: len(running.events("delivered")) == sent + 4)
    new = [one for one in orthanc.instances() if one.SOPClassUID == SPATIAL_REGISTRATION]
    plans = [one for one in orthanc.instances() if "1 planned trajectories" in one.get("SeriesDescription", "")]
    assert len(orthanc.instances()) == before + 2
    assert len(new) == len(plans) == 1
    for made in (*new, *plans):
        assert (made.PatientID, made.StudyInstanceUID) == (scan.PatientID, scan.StudyInstanceUID)
        path = tmp_path / "made.dcm"
        made.save_as(path, enforce_file_format=True)
        if program("dciodvfy"):
            told = subprocess.run(["dciodvfy", "-new", str(path)], capture_output=True, text=True, check=False)
            assert "Error" not in told.stderr, told.stderr
