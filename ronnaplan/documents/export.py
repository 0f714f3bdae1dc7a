"""One document in, another tool's format out."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import TYPE_CHECKING, TypeAlias

from ronnaplan.documents.fiducials import FiducialsDocument, Source, read_fiducials
from ronnaplan.documents.fiducials_csv import csv_table
from ronnaplan.documents.files import TABLE_ENDINGS, read_json, require_ending, write_atomically
from ronnaplan.documents.markups import MARKUPS_ENDINGS, markups
from ronnaplan.documents.plan import FORMAT as PLAN
from ronnaplan.documents.registration import FORMAT as REGISTRATION
from ronnaplan.documents.registration import RegistrationDocument, read_registration
from ronnaplan.documents.registration_exports import itk_transform, registration_csv, registration_markups
from ronnaplan.documents.ros import ros_transform
from ronnaplan.errors import UsageError, check_type

if TYPE_CHECKING:
    from pydicom.dataset import Dataset

DICOM = "dicom"
TRE_MAP = "tre-map"
ENDINGS = {"itk": (".tfm", ".txt"), "markups": MARKUPS_ENDINGS, "csv": TABLE_ENDINGS}
"""What files must be called where the program that reads them goes by the name: ITK takes a `.h5` for HDF5, Slicer a
`.fcsv` for its own points, of which a header says whether they are LPS or RAS."""

Exportable: TypeAlias = FiducialsDocument | RegistrationDocument


def export(
    document: str | os.PathLike[str] | Exportable, to: str, ct: str | os.PathLike[str] | None = None
) -> str | bytes:
    """Return a document, or the one at a path, in the format ``to``; DICOM as bytes, all else as text.

    ``ct`` is the scan whose patient and study a DICOM object is to name; without it they stay empty. Raises
    `UsageError` for a format that the document cannot become.
    """
    if ct is not None and to != DICOM:
        raise UsageError(f"a file of the kind '{to}' names no patient; give the scan with --to {DICOM} only")
    content = _content(document)
    _require(to, content)
    if isinstance(content, RegistrationDocument):
        if to == TRE_MAP:
            raise UsageError(f"'{to}' is an image: give write_as the name of its file")
        if to != DICOM:
            return REGISTRATION_EXPORTERS[to](content)
        from ronnaplan.documents.dicom_spatial import dicom_bytes, spatial_registration

        return dicom_bytes(spatial_registration(content, _patient(ct, content.source)))
    if to != DICOM:
        return FIDUCIAL_EXPORTERS[to](content)
    from ronnaplan.documents.dicom_spatial import dicom_bytes, spatial_fiducials

    return dicom_bytes(spatial_fiducials(content, _patient(ct, content.source)))


def write_as(
    path: str | os.PathLike[str],
    document: str | os.PathLike[str] | Exportable,
    to: str,
    ct: str | os.PathLike[str] | None = None,
) -> None:
    """Write a document, or the one at a path, to ``path`` in another tool's format ``to``.

    Fiducials become ``markups`` (.mrk.json), ``csv`` or ``dicom``; a registration these, ``itk`` (.tfm), ``ros``, or a
    ``tre-map``: the error to expect (mm RMS) at every voxel of the scan ``ct``, as .nii.gz, .nii, .nrrd or .mha. Raises
    `UsageError` for a format that the document cannot become, and for a name by which it could not be read again.
    """
    if to == TRE_MAP:
        from ronnaplan.documents.tre_image import tre_image

        registration = _content(document)
        if not isinstance(registration, RegistrationDocument):
            raise _cannot(to, registration)
        write_atomically(path, tre_image(registration, ct, os.fspath(path)))
    else:
        exported = export(document, to, ct)
        require_ending(path, to, ENDINGS.get(to, ("",)))
        write_atomically(path, exported)


def _content(document: str | os.PathLike[str] | Exportable) -> Exportable:
    """Return the document itself, or what is at its path."""
    if isinstance(document, FiducialsDocument | RegistrationDocument):
        return document
    check_type(
        document,
        (str, os.PathLike, FiducialsDocument, RegistrationDocument),
        "what is exported",
        "write_fiducials and write_registration return the document of a result",
    )
    content = read_json(document)
    form = content.get("format") if isinstance(content, dict) else None
    if form == REGISTRATION:
        return read_registration(document)
    if form == PLAN:
        raise UsageError(
            f"{document} is a plan; ronnaplan plan export writes its trajectories as markups or CSV, "
            "and ronnaplan robot export in the robot's coordinates"
        )
    return read_fiducials(document)


def _require(to: str, document: Exportable) -> None:
    if to not in _formats(document):
        raise _cannot(to, document)


def _cannot(to: str, document: Exportable) -> UsageError:
    what = "a registration" if isinstance(document, RegistrationDocument) else "fiducials"
    return UsageError(f"{what} cannot become '{to}'; choose one of {', '.join(_formats(document))}")


def _formats(document: Exportable) -> tuple[str, ...]:
    if isinstance(document, RegistrationDocument):
        return (*REGISTRATION_EXPORTERS, DICOM, TRE_MAP)
    return (*FIDUCIAL_EXPORTERS, DICOM)


def _patient(ct: str | os.PathLike[str] | None, source: Source) -> Dataset | None:
    if ct is None:
        return None
    from ronnaplan.documents.patient import patient_of_scan

    return patient_of_scan(ct, source)


FIDUCIAL_EXPORTERS: dict[str, Callable[[FiducialsDocument], str]] = {"markups": markups, "csv": csv_table}
"""Text formats a fiducials document can become, by the name given to ``--to``."""

REGISTRATION_EXPORTERS: dict[str, Callable[[RegistrationDocument], str]] = {
    "markups": registration_markups,
    "csv": registration_csv,
    "itk": itk_transform,
    "ros": ros_transform,
}
"""Text formats a registration document can become, by the name given to ``--to``."""
