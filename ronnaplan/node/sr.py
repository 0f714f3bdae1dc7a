"""Markers with their covariances, and trajectories, as Comprehensive 3-D SRs (TID 1500) in the scan's frame."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np
from highdicom.sr import (
    CodedConcept,
    Comprehensive3DSR,
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
from pydicom.dataset import Dataset
from pydicom.sr.codedict import codes
from pydicom.uid import ExplicitVRLittleEndian, generate_uid

from ronnaplan import __version__
from ronnaplan.ct.slices import CT_IMAGE
from ronnaplan.documents.fiducials import FiducialEntry, FiducialsDocument
from ronnaplan.documents.plan import plan_text
from ronnaplan.errors import InputError
from ronnaplan.planning import Plan, Trajectory

SCHEME: Final = "99RONNAPLAN"
"""Designator of the codes that no public scheme has."""

SQUARE_MILLIMETRE: Final = CodedConcept("mm2", "UCUM", "square millimeter")
MARKERS: Final = CodedConcept("CT_MARKERS", SCHEME, "CT with spherical fiducial markers")
PLANNED: Final = CodedConcept("CT_PLAN", SCHEME, "Planning of trajectories on a CT")
"""What the reports are about."""

IDENTITY: Final = (
    "SpecificCharacterSet",
    "SOPClassUID",
    "SOPInstanceUID",
    "StudyInstanceUID",
    "SeriesInstanceUID",
)
PATIENT_AND_STUDY: Final = (
    *("PatientID", "PatientName", "PatientBirthDate", "PatientSex"),
    *("AccessionNumber", "StudyID", "StudyDate", "StudyTime", "ReferringPhysicianName"),
)
"""What is read of each image."""

AXES: Final = "XYZ"
SERIES_NUMBER: Final = 1501


def structured_report(document: FiducialsDocument, images: list[Path]) -> Dataset:
    """Return the markers of ``document``, found in ``images``, whose patient and study it copies.

    Raises `InputError` where the scan has no frame of reference.
    """
    frame = document.source.frame_of_reference_uid
    if not frame:
        raise InputError("the scan has no Frame of Reference UID, so nothing in DICOM can be tied to it")
    content = document.model_dump_json()
    groups = [_group(one, frame, content) for one in document.fiducials]
    made = _report(groups, MARKERS, content, _evidence(images))
    made.SeriesDescription = f"{len(document.fiducials)} markers with covariances"
    return made


def warm_up(document: FiducialsDocument) -> None:
    """Load what highdicom knows of the standard (22 MB of JSON): report the markers of ``document``, of no scan."""
    scan = Dataset()
    scan.SOPClassUID, scan.SOPInstanceUID, scan.StudyInstanceUID, scan.SeriesInstanceUID = CT_IMAGE, *"123"
    groups = [_group(one, frame="1", content="") for one in document.fiducials]
    _report(groups, MARKERS, "", [_complete(scan)])


def planned_trajectories(plan: Plan, images: list[Path]) -> Dataset:
    """Return the trajectories of ``plan`` on the scan of ``images``: lines from entry to target, with their lengths.

    Raises `InputError` where there is none, or the scan has no frame of reference.
    """
    frame = plan.source.frame_of_reference_uid
    if not frame or not plan.trajectories:
        raise InputError("the plan has no trajectory or no Frame of Reference UID; an object needs both")
    content = plan_text(plan)
    groups = [_path(one, frame, content) for one in plan.trajectories]
    made = _report(groups, PLANNED, content, _evidence(images))
    made.SeriesDescription = f"{len(plan.trajectories)} planned trajectories, revision {plan.revision}"
    return made


def _report(
    groups: list[MeasurementsAndQualitativeEvaluations],
    procedure: CodedConcept,
    content: str,
    evidence: list[Dataset],
) -> Dataset:
    device = DeviceObserverIdentifyingAttributes(
        uid=generate_uid(entropy_srcs=["ronnaplan", __version__]),
        name="ronnaplan",
        manufacturer_name="ronnaplan",
        model_name=f"ronnaplan {__version__}",
    )
    report = MeasurementReport(
        ObservationContext(
            observer_device_context=ObserverContext(
                observer_type=codes.DCM.Device, observer_identifying_attributes=device
            )
        ),
        procedure_reported=procedure,
        imaging_measurements=groups,
        title=codes.DCM.ImagingMeasurementReport,
    )
    made = Comprehensive3DSR(
        evidence=evidence,
        content=report,
        series_instance_uid=generate_uid(entropy_srcs=["sr series", content]),
        series_number=SERIES_NUMBER,
        sop_instance_uid=generate_uid(entropy_srcs=["sr", content]),
        instance_number=1,
        manufacturer="ronnaplan",
        is_complete=True,
        transfer_syntax_uid=ExplicitVRLittleEndian,
    )
    made.ManufacturerModelName, made.SoftwareVersions, made.DeviceSerialNumber = "ronnaplan", __version__, "none"
    return made


def _evidence(images: list[Path]) -> list[Dataset]:
    """Return who the images are, and their patient and study."""
    tags = [*IDENTITY, *PATIENT_AND_STUDY]
    return [_complete(dcmread(path, stop_before_pixels=True, specific_tags=tags)) for path in images]


def _complete(image: Dataset) -> Dataset:
    """Give an image what highdicom copies and scanners may leave out: it is of type 2, so empty."""
    for keyword in PATIENT_AND_STUDY:
        if keyword not in image:
            setattr(image, keyword, None)
    return image


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
