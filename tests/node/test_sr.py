"""The report of markers is made of whatever scanners write."""

from __future__ import annotations

from pathlib import Path

import pytest
from pydicom.dataset import Dataset

from ronnaplan.documents.fiducials import fiducials_document
from ronnaplan.jobs.localizing import warm_up
from ronnaplan.node.sr import PATIENT_AND_STUDY, structured_report
from tests.ct import makers
from tests.node.peers import save


def reported(folder: Path, *without: str) -> Dataset:
    """Return the report of the markers of a scan that leaves out some attributes."""
    images = []
    for k in range(2):
        made = makers.dataset(k)
        for keyword in without:
            if keyword in made:
                delattr(made, keyword)
        images.append(save(made, folder / f"{k}.dcm"))
    document = fiducials_document(warm_up()[1])
    source = document.source.model_copy(update={"frame_of_reference_uid": "1.2.3"})
    return structured_report(document.model_copy(update={"source": source}), images)


@pytest.mark.parametrize("without", PATIENT_AND_STUDY)
def test_what_a_scanner_leaves_out_is_empty(without: str, tmp_path: Path) -> None:
    assert not reported(tmp_path, without).get(without)


def test_patient_and_study_are_those_of_the_scan(tmp_path: Path) -> None:
    made, scan = reported(tmp_path), makers.dataset(0)
    assert made.PatientName == scan.PatientName
    assert made.StudyInstanceUID == scan.StudyInstanceUID
