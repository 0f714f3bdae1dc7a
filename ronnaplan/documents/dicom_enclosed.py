"""A report or a picture inside a DICOM object: Encapsulated PDF and Secondary Capture (PS3.3, A.45 and A.8)."""

from __future__ import annotations

import io
from typing import Final

from pydicom.dataset import Dataset, FileDataset
from pydicom.uid import UID

from ronnaplan.documents.dicom_spatial import Kind, begin_object
from ronnaplan.documents.fiducials import FiducialsDocument

PDF: Final = Kind(UID("1.2.840.10008.5.1.4.1.1.104.1"), "DOC", 1504)
PICTURE: Final = Kind(UID("1.2.840.10008.5.1.4.1.1.7"), "OT", 1505)


def encapsulated_pdf(
    pdf: bytes, document: FiducialsDocument, patient: Dataset | None = None, *, title: str
) -> FileDataset:
    """Return the report ``pdf`` of ``document`` as a DICOM object; ``patient`` holds the modules to copy."""
    made = begin_object(PDF, document.source, f"pdf {document.model_dump_json()}", patient)
    _converted(made)
    del made.BodyPartExamined
    made.SeriesDescription = made.DocumentTitle = title
    made.BurnedInAnnotation = "NO"
    made.AcquisitionDateTime = None
    made.ConceptNameCodeSequence = []
    made.MIMETypeOfEncapsulatedDocument = "application/pdf"
    made.EncapsulatedDocument = pdf + b"\0" * (len(pdf) % 2)
    made.EncapsulatedDocumentLength = len(pdf)
    return made


def secondary_capture(
    png: bytes, document: FiducialsDocument, patient: Dataset | None = None, *, title: str
) -> FileDataset:
    """Return the picture ``png`` of ``document`` as a DICOM object; ``patient`` holds the modules to copy."""
    rows, columns, pixels = _decoded(png)
    made = begin_object(PICTURE, document.source, f"sheet {document.model_dump_json()}", patient)
    _converted(made)
    made.SeriesDescription = title
    made.BurnedInAnnotation = "NO"
    made.PatientOrientation = None
    made.SamplesPerPixel, made.PhotometricInterpretation, made.PlanarConfiguration = 3, "RGB", 0
    made.Rows, made.Columns = rows, columns
    made.BitsAllocated, made.BitsStored, made.HighBit, made.PixelRepresentation = 8, 8, 7, 0
    made.PixelData = pixels + b"\0" * (len(pixels) % 2)
    made["PixelData"].VR = "OB"
    return made


def _decoded(png: bytes) -> tuple[int, int, bytes]:
    """Return how many rows and columns a picture has, and its pixels as RGB, of which there is one copy then."""
    from PIL import Image

    with Image.open(io.BytesIO(png)) as picture:
        colours = picture if picture.mode == "RGB" else picture.convert("RGB")
        return colours.height, colours.width, colours.tobytes()


def _converted(made: FileDataset) -> None:
    made.ConversionType = "WSD"
    del made.ContentCreatorName
