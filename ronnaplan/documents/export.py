"""One document in, another tool's format out."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from ronnaplan.documents.fiducials import FiducialsDocument, Source, read_fiducials
from ronnaplan.documents.files import read_json
from ronnaplan.documents.itk_transform import itk_transform
from ronnaplan.documents.markups import markups
from ronnaplan.documents.registration import FORMAT as REGISTRATION
from ronnaplan.documents.registration import RegistrationDocument, read_registration
from ronnaplan.documents.registration_exports import registration_csv, registration_markups
from ronnaplan.documents.ros import ros_transform
from ronnaplan.documents.table import csv_table
from ronnaplan.errors import UsageError

if TYPE_CHECKING:
    from pydicom.dataset import Dataset

DICOM = "dicom"


def export(path: str | os.PathLike[str], to: str, ct: str | os.PathLike[str] | None = None) -> str | bytes:
    """Read the document at ``path`` and return it in the format ``to``; DICOM as bytes, all else as text.

    ``ct`` is the scan whose patient and study a DICOM object is to name; without it they stay empty. Raises
    `UsageError` for a format that the document cannot become.
    """
    if ct is not None and to != DICOM:
        raise UsageError(f"a file of the kind '{to}' names no patient; give the scan with --to {DICOM} only")
    content = read_json(path)
    if isinstance(content, dict) and content.get("format") == REGISTRATION:
        _require(to, "a registration", [*REGISTRATION_EXPORTERS, DICOM])
        registration = read_registration(path)
        if to != DICOM:
            return REGISTRATION_EXPORTERS[to](registration)
        from ronnaplan.documents.dicom_spatial import dicom_bytes, spatial_registration

        return dicom_bytes(spatial_registration(registration, _patient(ct, registration.source)))
    _require(to, "fiducials", [*FIDUCIAL_EXPORTERS, DICOM])
    fiducials = read_fiducials(path)
    if to != DICOM:
        return FIDUCIAL_EXPORTERS[to](fiducials)
    from ronnaplan.documents.dicom_spatial import dicom_bytes, spatial_fiducials

    return dicom_bytes(spatial_fiducials(fiducials, _patient(ct, fiducials.source)))


def _require(to: str, what: str, known: Sequence[str]) -> None:
    if to not in known:
        raise UsageError(f"{what} cannot become '{to}'; choose one of {', '.join(known)}")


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
