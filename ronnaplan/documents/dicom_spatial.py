"""DICOM Spatial Fiducials and Spatial Registration objects (PS3.3, A.40 and A.39), bound to the scan's frame.

A Spatial Registration maps its items' frames of reference into the object's own, here the tracker's. Patient and study
are left empty, as ronnaplan's documents do not carry them, unless they are given (`ronnaplan.documents.patient`).
"""

from __future__ import annotations

import datetime
import io
import re
from collections import defaultdict
from collections.abc import Iterator, Sequence
from functools import partial
from itertools import chain, count
from typing import Final, NamedTuple

from pydicom.dataset import Dataset, FileDataset, FileMetaDataset
from pydicom.uid import UID, ExplicitVRLittleEndian, generate_uid
from pydicom.valuerep import DSfloat

from ronnaplan import __version__
from ronnaplan.documents.fiducials import FiducialEntry, FiducialsDocument, Source
from ronnaplan.documents.registration import RegistrationDocument
from ronnaplan.errors import InputError
from ronnaplan.geometry import FloatArray
from ronnaplan.text import counted

SPATIAL_REGISTRATION = UID("1.2.840.10008.5.1.4.1.1.66.1")
SPATIAL_FIDUCIALS = UID("1.2.840.10008.5.1.4.1.1.66.2")


class Kind(NamedTuple):
    """A kind of object: its class and modality, and its series' number, by which archives and viewers list series."""

    sop_class: UID
    modality: str
    series_number: int


FIDUCIALS: Final = Kind(SPATIAL_FIDUCIALS, "FID", 1502)
REGISTRATION: Final = Kind(SPATIAL_REGISTRATION, "REG", 1503)
IDENTITY = (1.0, 0, 0, 0, 0, 1.0, 0, 0, 0, 0, 1.0, 0, 0, 0, 0, 1.0)
UID_PATTERN = r"[0-9.]{1,64}"
LONGEST_IDENTIFIER = 16
"""Fiducial Identifier is a Short String (SH)."""
LONGEST_DESCRIPTION = 64
"""Fiducial Description is a Long String (LO)."""


def spatial_fiducials(document: FiducialsDocument, patient: Dataset | None = None) -> FileDataset:
    """Return the markers as a Spatial Fiducials object: points with their RMS error (mm) as uncertainty radius.

    ``patient`` holds the patient and study modules to copy.

    Raises `InputError` when the document has no frame of reference or no marker.
    """
    frame = frame_uid(document.source)
    if not document.fiducials:
        raise InputError("the document holds no fiducials; a Spatial Fiducials object needs at least one")
    dataset = begin_object(FIDUCIALS, document.source, document.model_dump_json(), patient)
    dataset.SeriesDescription = counted(len(document.fiducials), "marker")
    dataset.ContentLabel = "MARKERS"
    dataset.ContentDescription = f"Spheres of {document.marker.diameter_mm:g} mm found by ronnaplan"
    markers = Dataset()
    markers.FrameOfReferenceUID = frame
    identifiers = _identifiers([entry.label for entry in document.fiducials])
    markers.FiducialSequence = [
        _fiducial(entry, identifier) for entry, identifier in zip(document.fiducials, identifiers, strict=True)
    ]
    dataset.FiducialSetSequence = [markers]
    return dataset


def spatial_registration(document: RegistrationDocument, patient: Dataset | None = None) -> FileDataset:
    """Return the registration as a Spatial Registration object from the scan's frame into the tracker's.

    The tracker's frame of reference has no UID of its own: one is made from the document's content, the same at
    every export. ``patient`` holds the patient and study modules to copy. Raises `InputError` for a refused
    registration or one without the scan's frame of reference.
    """
    transform = document.pose.matrix
    content = document.model_dump_json()
    dataset = begin_object(REGISTRATION, document.source, content, patient)
    dataset.FrameOfReferenceUID = generate_uid(entropy_srcs=["tracker frame", content])
    dataset.PositionReferenceIndicator = None
    dataset.SeriesDescription = "CT to tracker"
    dataset.ContentLabel = "CT_TO_TRACKER"
    dataset.ContentDescription = f"{len(document.pairs)} marker pairs, FRE {document.fre_rms:.3f} mm RMS"
    to_itself = _matrix(dataset.FrameOfReferenceUID, IDENTITY)
    dataset.RegistrationSequence = [_matrix(frame_uid(document.source), transform.ravel()), to_itself]
    return dataset


def dicom_bytes(dataset: FileDataset) -> bytes:
    """Return ``dataset`` as the bytes of a DICOM file."""
    file = io.BytesIO()
    dataset.save_as(file, enforce_file_format=True)
    return file.getvalue()


def frame_uid(source: Source) -> str:
    """Return the Frame of Reference UID of a scan; raises `InputError` where it has none that DICOM can hold."""
    if not source.frame_of_reference_uid:
        raise InputError("the scan has no Frame of Reference UID, so nothing in DICOM can be tied to it")
    return _checked_uid(source.frame_of_reference_uid)


def _checked_uid(text: str) -> str:
    if re.fullmatch(UID_PATTERN, text) is None:
        raise InputError(f"{text[:80]!r} is not a DICOM UID (digits and dots, at most 64); correct the document")
    return text


def begin_object(kind: Kind, source: Source, content: str, patient: Dataset | None) -> FileDataset:
    """Return an object with everything but its own module: patient, study, series, equipment, SOP.

    Its UIDs are made of ``content``, of which each kind of object needs its own.
    """
    content += "" if patient is None else str(patient)
    uid = generate_uid(entropy_srcs=[kind.sop_class, content])
    meta = FileMetaDataset()
    meta.MediaStorageSOPClassUID = kind.sop_class
    meta.MediaStorageSOPInstanceUID = uid
    meta.TransferSyntaxUID = ExplicitVRLittleEndian
    dataset = FileDataset("", {}, file_meta=meta, preamble=b"\0" * 128)
    dataset.SOPClassUID, dataset.SOPInstanceUID = kind.sop_class, uid
    dataset.SpecificCharacterSet = "ISO_IR 192"
    for keyword in ("PatientName", "PatientID", "PatientBirthDate", "PatientSex", "StudyDate", "StudyTime"):
        setattr(dataset, keyword, None)
    for keyword in ("ReferringPhysicianName", "StudyID", "AccessionNumber", "ContentCreatorName"):
        setattr(dataset, keyword, None)
    study = source.study_instance_uid
    dataset.StudyInstanceUID = _checked_uid(study) if study else generate_uid(entropy_srcs=["study", content])
    if patient is not None:
        dataset.update(patient)
    dataset.SeriesInstanceUID = generate_uid(entropy_srcs=["series", content])
    dataset.BodyPartExamined = "HEAD"
    dataset.Modality, dataset.SeriesNumber, dataset.InstanceNumber = kind.modality, kind.series_number, 1
    dataset.Manufacturer, dataset.ManufacturerModelName = "ronnaplan", "ronnaplan"
    dataset.SoftwareVersions, dataset.DeviceSerialNumber = __version__, "none"
    now = datetime.datetime.now()
    dataset.SeriesDate = dataset.ContentDate = now.strftime("%Y%m%d")
    dataset.SeriesTime = dataset.ContentTime = now.strftime("%H%M%S")
    return dataset


def _identifiers(labels: Sequence[str]) -> list[str]:
    """Return labels as a Short String has room for them, each another than all before it."""
    found: dict[str, None] = {}
    numbers: defaultdict[str, Iterator[int]] = defaultdict(
        partial(count, 2)
    )  # of alike labels: none is tried twice
    for label in map(_one_value, labels):
        kept = label[:LONGEST_IDENTIFIER]
        ends = (f"~{number}" for number in numbers[kept])
        numbered = (f"{kept[: LONGEST_IDENTIFIER - len(end)]}{end}" for end in ends)
        found[next(one for one in chain([kept.rstrip()], numbered) if one not in found)] = None
    return list(found)


def _one_value(text: str) -> str:
    """Return ``text`` without backslashes, by which DICOM parts values, and blanks around it, which do not count."""
    return text.replace("\\", "/").strip()


def _fiducial(entry: FiducialEntry, identifier: str) -> Dataset:
    fiducial = Dataset()
    fiducial.ShapeType = "POINT"
    fiducial.FiducialIdentifier = identifier
    what = f"sphere {entry.diameter_mm:.2f} mm"
    if identifier != entry.label:
        what += f", {_one_value(entry.label)}"
    fiducial.FiducialDescription = what[:LONGEST_DESCRIPTION]
    fiducial.ContourUncertaintyRadius = sum(entry.covariance[axis][axis] for axis in range(3)) ** 0.5
    fiducial.NumberOfContourPoints = 1
    fiducial.ContourData = [DSfloat(value, auto_format=True) for value in entry.center]
    return fiducial


def _matrix(frame_uid: str, numbers: FloatArray | tuple[float, ...]) -> Dataset:
    """Return a Registration Sequence item that maps ``frame_uid`` by the 16 ``numbers``, row by row."""
    step = Dataset()
    step.FrameOfReferenceTransformationMatrixType = "RIGID"
    step.FrameOfReferenceTransformationMatrix = [DSfloat(float(value), auto_format=True) for value in numbers]
    registration = Dataset()
    registration.RegistrationTypeCodeSequence = []
    registration.MatrixSequence = [step]
    item = Dataset()
    item.FrameOfReferenceUID = frame_uid
    item.MatrixRegistrationSequence = [registration]
    return item
