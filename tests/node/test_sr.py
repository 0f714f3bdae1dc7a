"""The report of markers is made of whatever scanners write."""

from __future__ import annotations

from pathlib import Path

import pytest
from highdicom.sr import Comprehensive3DSR
from pydicom.dataset import Dataset

from ronnaplan.ct.volume import SeriesSource
from ronnaplan.documents.dicom_enclosed import PDF, PICTURE
from ronnaplan.documents.dicom_spatial import FIDUCIALS, REGISTRATION
from ronnaplan.documents.fiducials import Source, fiducials_document
from ronnaplan.documents.patient import PATIENT, STUDY, patient_of_scan
from ronnaplan.errors import InputError
from ronnaplan.jobs.localizing import warm_up
from ronnaplan.node.sr import MARKERS, PLANNED, planned_trajectories, structured_report
from ronnaplan.planning import Plan
from tests.ct import makers
from tests.long import few_and_others
from tests.node.peers import save


def test_no_two_kinds_of_objects_have_one_series_number() -> None:
    kinds = (FIDUCIALS, REGISTRATION, PDF, PICTURE, MARKERS.kind, PLANNED.kind)
    assert len({kind.series_number for kind in kinds}) == len(kinds)


def reported(folder: Path, *without: str) -> Dataset:
    """Return the report of the markers of a scan that leaves out some attributes."""
    images = []
    for k in range(3):
        made = makers.dataset(k)
        for keyword in without:
            if keyword in made:
                delattr(made, keyword)
        images.append(save(made, folder / f"{k}.dcm"))
    first = makers.dataset(0)
    source = Source(
        study_instance_uid=first.StudyInstanceUID,
        series_instance_uid=first.SeriesInstanceUID,
        frame_of_reference_uid=first.FrameOfReferenceUID,
    )
    document = fiducials_document(warm_up()[1]).model_copy(update={"source": source})
    return structured_report(document, patient_of_scan(folder, source), images)


LEFT_OUT = sorted({*PATIENT, *STUDY} - {"StudyInstanceUID"})


@few_and_others("without", LEFT_OUT[::4], [name for n, name in enumerate(LEFT_OUT) if n % 4])
def test_what_a_scanner_leaves_out_is_empty(without: str, tmp_path: Path) -> None:
    assert not reported(tmp_path, without).get(without)


def test_patient_and_study_are_those_of_the_scan_and_its_images_are_named(tmp_path: Path) -> None:
    made, scan = reported(tmp_path), makers.dataset(0)
    assert made.PatientName == scan.PatientName
    assert made.StudyInstanceUID == scan.StudyInstanceUID
    (study,) = made.CurrentRequestedProcedureEvidenceSequence
    (series,) = study.ReferencedSeriesSequence
    assert (study.StudyInstanceUID, series.SeriesInstanceUID) == (scan.StudyInstanceUID, scan.SeriesInstanceUID)
    named = [one.ReferencedSOPInstanceUID for one in series.ReferencedSOPSequence]
    assert named == [makers.dataset(k).SOPInstanceUID for k in range(3)]


def test_highdicom_takes_the_object_for_one_of_its_own(tmp_path: Path) -> None:
    made = reported(tmp_path)
    assert [str(item.name.meaning) for item in Comprehensive3DSR.from_dataset(made).content] == [
        "Imaging Measurement Report"
    ]


def test_a_plan_without_trajectories_or_a_frame_makes_no_object() -> None:
    for uid, lacking in (("1.2.3", "no trajectory"), (None, "no Frame of Reference UID")):
        with pytest.raises(InputError, match=lacking):
            planned_trajectories(Plan(SeriesSource()), Source(frame_of_reference_uid=uid), Dataset(), [])
