"""Documents that come later than the scan are answered, too: as objects in the patient's study, once each state."""

from __future__ import annotations

import dataclasses
import io
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydicom import dcmread

from ronnaplan.ct import VolumeFlag, read_ct
from ronnaplan.documents.plan import write_plan
from ronnaplan.errors import RefusedError
from ronnaplan.jobs import localizing
from ronnaplan.jobs.localizing import warm_up
from ronnaplan.node import papers as papers_module
from ronnaplan.node import received
from ronnaplan.node.config import Rule
from ronnaplan.node.index import Index
from ronnaplan.node.logs import Log
from ronnaplan.node.papers import PapersWatch
from ronnaplan.node.work import Order, begin, finish
from ronnaplan.planning import Plan, Trajectory
from tests.ct import makers
from tests.documents.test_patient import document, identify
from tests.node.peers import configuration, program
from tests.node.test_series import add

UIDS = {"study_uid": makers.STUDY, "series_uid": makers.SERIES}


@pytest.fixture
def order(tmp_path: Path) -> Order:
    """A job whose own answers were all made, and a registration and a plan beside it."""
    scan = makers.write_series(tmp_path / makers.STUDY / makers.SERIES, change=identify)
    for path in scan.iterdir():
        path.rename(path.with_suffix(".dcm"))
    papers = tmp_path / "documents" / makers.STUDY
    papers.mkdir(parents=True)
    document(papers, "registration")
    volume = read_ct(scan)
    left = Trajectory("left", np.array([0.0, 0, 30]), np.array([20.0, 30, 90]), frame=volume.frame)
    write_plan(papers / "plan.json", Plan.of_scan(volume).add(left))
    rule = Rule(name="r", documents="documents")
    return Order(1, scan, len(list(scan.iterdir())), tmp_path, tmp_path / "answers", rule, rule.answers)


def told(order: Order) -> list[dict[str, Any]]:
    lines: list[dict[str, Any]] = []

    def tell(event: str, **facts: Any) -> None:
        lines.append({"event": event, **facts})

    finish(begin(order, tell), tell, lambda _: None)
    return lines


def test_a_scan_of_which_files_are_gone_is_refused(order: Order) -> None:
    next(order.folder.iterdir()).unlink()
    with pytest.raises(RefusedError, match=f"1 of its {order.instances} files are gone"):
        told(order)


def test_a_folder_of_documents_that_cannot_be_looked_into_is_told_once_and_keeps_nothing_back(
    order: Order, index: Index, tmp_path: Path
) -> None:
    name = "d" * 300  # longer than a name may be; a folder that only others may read is alike
    rule = Rule(name="r", documents=name)
    with pytest.raises(RefusedError, match="no 3 balls of one size"):  # it was looked into
        told(dataclasses.replace(order, rule=rule))
    said = io.StringIO()
    watch = PapersWatch(configuration(tmp_path, rule=[{"name": "r", "documents": name}]), index, Log(said))
    for now in (0.0, 10.0):
        watch.tick(now)
    assert said.getvalue().count("documents unread") == 1


def test_a_study_s_folder_that_cannot_be_looked_into_keeps_no_other_study_waiting(
    index: Index, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    looked: list[str] = []

    def stamp(folder: Path) -> str:
        if folder.name == "1.1":
            raise PermissionError(13, "Permission denied", str(folder))
        looked.append(folder.name)
        return ""

    monkeypatch.setattr(papers_module, "stamp_of", stamp)
    for study in ("1.1", "1.2"):
        (tmp_path / "documents" / study).mkdir(parents=True)
    said = io.StringIO()
    config = configuration(tmp_path, rule=[{"name": "r", "documents": "documents"}])
    PapersWatch(config, index, Log(said)).tick(0.0)
    assert looked == ["1.2"]
    assert "1.1" in said.getvalue()


def test_registration_and_plan_become_objects_of_the_patient_s_study(order: Order) -> None:
    answers = {line["kind"]: line for line in told(order) if line["event"] == "answer"}
    assert sorted(answers) == ["plan", "registration"]
    for kind, line in answers.items():
        made = dcmread(line["path"])
        assert (made.PatientID, made.StudyInstanceUID) == ("4711", makers.STUDY)
        if shutil.which("dciodvfy"):
            done = subprocess.run(["dciodvfy", "-new", line["path"]], capture_output=True, text=True, check=False)
            assert "Error" not in done.stderr, (kind, done.stderr)
    (container,) = (
        item for item in dcmread(answers["plan"]["path"]).ContentSequence if item.ValueType == "CONTAINER"
    )
    (number,) = (item for item in container.ContentSequence[0].ContentSequence if item.ValueType == "NUM")
    assert float(number.MeasuredValueSequence[0].NumericValue) == pytest.approx(70.0)
    assert list(number.ContentSequence[0].GraphicData) == [0, 0, 30, 20, 30, 90]
    if program("dsrdump"):
        command = [str(program("dsrdump")), answers["plan"]["path"]]
        assert b"SCOORD3D" in subprocess.run(command, capture_output=True, check=True).stdout
    again = {line["kind"]: line for line in told(order) if line["event"] == "answer"}
    assert {kind: line["sop_uid"] for kind, line in again.items()} == {
        kind: line["sop_uid"] for kind, line in answers.items()
    }


@pytest.mark.filterwarnings("ignore:Invalid value for VR:UserWarning")
def test_a_birth_date_that_is_none_keeps_no_answer_back_and_is_told_without_its_value(
    order: Order, monkeypatch: pytest.MonkeyPatch
) -> None:
    for path in order.folder.iterdir():
        made = dcmread(path)
        made.PatientBirthDate = "1970.01.31"
        made.save_as(path)
    volume = dataclasses.replace(read_ct(order.folder), flags=(VolumeFlag.MISSING_SLICE,))
    found = warm_up()[1]
    markers = dataclasses.replace(found, source=volume.source)
    monkeypatch.setattr(received, "read_received", lambda *_: volume)
    monkeypatch.setattr(localizing, "find_markers", lambda *_: (markers, ("balls of 9.00 mm are taken",)))
    rule = Rule(name="r", answers=("fiducials", "sr"))
    lines = told(dataclasses.replace(order, rule=rule, have=()))
    answers = [dcmread(line["path"]) for line in lines if line["event"] == "answer"]
    assert [(one.PatientID, one.PatientBirthDate) for one in answers] == [("4711", ""), ("4711", "")]
    (empty,) = (line["reason"] for line in lines if line["event"] == "left empty")
    assert "PatientBirthDate is none that DICOM knows, and is left empty" in empty
    assert "1970" not in empty
    assert lines[-1]["reason"] == (
        "1 marker; one or more slices are missing; balls of 9.00 mm are taken"  # which the status page shows
    )
    later = told(order)  # of registration and plan
    assert [line["event"] for line in later] == ["left empty", "answer", "left empty", "answer", "ended"]
    assert {line["reason"] for line in later if line["event"] == "left empty"} == {empty}


def test_a_document_of_another_scan_is_left_out_and_says_why(order: Order, tmp_path: Path) -> None:
    document(tmp_path / "documents" / makers.STUDY, "registration", series_instance_uid="1.2.9")
    lines = told(order)
    assert [line["kind"] for line in lines if line["event"] == "answer"] == ["plan"]
    (left,) = (line for line in lines if line["event"] == "left out")
    assert "does not hold series 1.2.9" in left["reason"]


def test_a_finished_job_is_done_again_once_for_each_state_of_its_documents(index: Index, tmp_path: Path) -> None:
    add(index, 1, 0.0, **UIDS)
    index.run("INSERT INTO jobs (series, revision, rule, state, due, completed) VALUES (1, 1, 'r', 'done', 0, 0)")
    config = configuration(tmp_path, rule=[{"name": "r", "documents": "documents"}])
    watched = PapersWatch(config, index, Log(io.StringIO()))
    folder = tmp_path / "documents" / makers.STUDY
    seen = []
    for number, content in enumerate((None, "{}", "{}", "{ }")):
        if content is not None and (number != 2):
            folder.mkdir(parents=True, exist_ok=True)
            (folder / "plan.json").write_text(content)
        watched.tick(10.0 * number)
        seen.append(index.value("SELECT state FROM jobs"))
        index.run("UPDATE jobs SET state = 'done'")
    assert seen == ["done", "waiting", "done", "waiting"]
