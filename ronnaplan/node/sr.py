"""Markers with their covariances, and trajectories, as Comprehensive 3-D SRs (TID 1500) in the scan's frame."""

from __future__ import annotations

from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from highdicom.sr import (
    CodedConcept,
    CoordinatesForMeasurement3D,
    DeviceObserverIdentifyingAttributes,
    Measurement,
    MeasurementReport,
    MeasurementsAndQualitativeEvaluations,
    ObservationContext,
    ObserverContext,
    TrackingIdentifier,
)
from pydicom import dcmread
from pydicom.dataset import Dataset, FileDataset
from pydicom.sr.codedict import codes
from pydicom.uid import Comprehensive3DSRStorage, generate_uid

from ronnaplan import __version__
from ronnaplan.documents.dicom_spatial import Kind, begin_object, frame_uid
from ronnaplan.documents.fiducials import FiducialEntry, FiducialsDocument, Source
from ronnaplan.documents.plan import plan_text
from ronnaplan.planning import Plan, Trajectory
from ronnaplan.text import counted

SCHEME: Final = "99RONNAPLAN"
"""Designator of the codes that no public scheme has."""

SQUARE_MILLIMETRE: Final = CodedConcept("mm2", "UCUM", "square millimeter")


class Subject(NamedTuple):
    """What a report is about."""

    kind: Kind
    procedure: CodedConcept


MARKERS: Final = Subject(
    Kind(Comprehensive3DSRStorage, "SR", 1501),
    CodedConcept("CT_MARKERS", SCHEME, "CT with spherical fiducial markers"),
)
PLANNED: Final = Subject(
    Kind(Comprehensive3DSRStorage, "SR", 1506), CodedConcept("CT_PLAN", SCHEME, "Planning of trajectories on a CT")
)

IDENTITY: Final = ("SOPClassUID", "SOPInstanceUID", "StudyInstanceUID", "SeriesInstanceUID")
"""What is read of each image."""

AXES: Final = "XYZ"


def structured_report(document: FiducialsDocument, patient: Dataset, images: list[Path]) -> FileDataset:
    """Return the markers of ``document``, found in ``images``; ``patient`` holds the modules to copy.

    Raises `InputError` where the scan has no frame of reference.
    """
    frame = frame_uid(document.source)
    content = document.model_dump_json()
    groups = [_group(one, frame, content) for one in document.fiducials]
    made = _report(groups, MARKERS, document.source, content, patient, images)
    made.SeriesDescription = f"{counted(len(document.fiducials), 'marker')} with covariances"
    return made


def planned_trajectories(plan: Plan, source: Source, patient: Dataset, images: list[Path]) -> FileDataset:
    """Return the trajectories of ``plan`` on the scan of ``images``: lines from entry to target, with their lengths.

    Raises `InputError` where there is none, or the scan has no frame of reference.
    """
    frame = frame_uid(source)
    plan.require_trajectories()
    content = plan_text(plan)
    groups = [_path(one, frame, content) for one in plan.trajectories]
    made = _report(groups, PLANNED, source, content, patient, images)
    made.SeriesDescription = f"{len(plan.trajectories)} planned trajectories, revision {plan.revision}"
    return made


def _report(
    groups: list[MeasurementsAndQualitativeEvaluations],
    subject: Subject,
    source: Source,
    content: str,
    patient: Dataset,
    images: list[Path],
) -> FileDataset:
    """Return the SR whose content highdicom builds.

    What is about it (PS3.3, A.35.13) is made as that of all other answers: highdicom's own class for the whole loads
    22 MB of JSON for that, which take 100 MB.
    """
    device = DeviceObserverIdentifyingAttributes(
        uid=generate_uid(entropy_srcs=["ronnaplan", __version__]),
        name="ronnaplan",
        manufacturer_name="ronnaplan",
        model_name=f"ronnaplan {__version__}",
    )
    (report,) = MeasurementReport(
        ObservationContext(
            observer_device_context=ObserverContext(
                observer_type=codes.DCM.Device, observer_identifying_attributes=device
            )
        ),
        procedure_reported=subject.procedure,
        imaging_measurements=groups,
        title=codes.DCM.ImagingMeasurementReport,
    )
    made = begin_object(subject.kind, source, f"sr {content}", patient)
    del made.BodyPartExamined, made.ContentCreatorName  # of other modules
    made.CompletionFlag, made.VerificationFlag, made.PreliminaryFlag = "COMPLETE", "UNVERIFIED", "FINAL"
    made.PerformedProcedureCodeSequence, made.ReferencedPerformedProcedureStepSequence = [], []
    made.CurrentRequestedProcedureEvidenceSequence = _evidence(images)
    made.update(report)
    return made


def _evidence(images: list[Path]) -> list[Dataset]:
    """Return which images were looked at: their studies, the series of these, the instances of these."""
    series: dict[tuple[str, str], list[Dataset]] = {}
    for path in images:
        image = dcmread(path, stop_before_pixels=True, specific_tags=list(IDENTITY))
        reference = Dataset()
        reference.ReferencedSOPClassUID, reference.ReferencedSOPInstanceUID = (
            image.SOPClassUID,
            image.SOPInstanceUID,
        )
        series.setdefault((image.StudyInstanceUID, image.SeriesInstanceUID), []).append(reference)
    studies: dict[str, list[Dataset]] = {}
    for (study_uid, series_uid), references in series.items():
        item = Dataset()
        item.SeriesInstanceUID, item.ReferencedSOPSequence = series_uid, references
        studies.setdefault(study_uid, []).append(item)
    found = []
    for study_uid, items in studies.items():
        item = Dataset()
        item.StudyInstanceUID, item.ReferencedSeriesSequence = study_uid, items
        found.append(item)
    return found


def _path(one: Trajectory, frame: str, content: str) -> MeasurementsAndQualitativeEvaluations:
    """Return a trajectory: its length along the line from entry to target."""
    ends = np.array([one.entry_mm, one.target_mm])
    line = CoordinatesForMeasurement3D("POLYLINE", ends, frame)
    length = float(np.linalg.norm(ends[1] - ends[0]))
    return MeasurementsAndQualitativeEvaluations(
        TrackingIdentifier(uid=generate_uid(entropy_srcs=[one.name, content]), identifier=one.name),
        finding_type=CodedConcept("TRAJECTORY", SCHEME, "Planned trajectory, from entry to target"),
        measurements=[
            Measurement(codes.SCT.Length, _short(length), codes.UCUM.Millimeter, referenced_coordinates=[line])
        ],
    )


def _group(marker: FiducialEntry, frame: str, content: str) -> MeasurementsAndQualitativeEvaluations:
    """Return a marker: its diameter where its center is, and the covariance of the center in mm^2."""
    center = CoordinatesForMeasurement3D("POINT", np.array([marker.center]), frame)
    measurements = [
        Measurement(codes.SCT.Diameter, marker.diameter_mm, codes.UCUM.Millimeter, referenced_coordinates=[center])
    ]
    for row in range(3):
        for column in range(row, 3):
            axes = AXES[row] + AXES[column]
            name = CodedConcept(f"COVARIANCE_{axes}", SCHEME, f"Covariance of the center, {axes[0]} and {axes[1]}")
            measurements.append(Measurement(name, _short(marker.covariance[row][column]), SQUARE_MILLIMETRE))
    return MeasurementsAndQualitativeEvaluations(
        TrackingIdentifier(uid=generate_uid(entropy_srcs=[marker.label, content]), identifier=marker.label),
        finding_type=codes.DCM.FiducialMark,
        measurements=measurements,
    )


def _short(value: float) -> float:
    """Return ``value`` as a Decimal String of 16 characters can hold it."""
    return float(f"{value:.9g}")
