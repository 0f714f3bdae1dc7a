"""One document in, another tool's format out."""

from __future__ import annotations

import os
from collections.abc import Callable

from ronnaplan.documents.fiducials import FiducialsDocument, read_fiducials
from ronnaplan.documents.files import read_json
from ronnaplan.documents.itk_transform import itk_transform
from ronnaplan.documents.markups import markups
from ronnaplan.documents.registration import FORMAT as REGISTRATION
from ronnaplan.documents.registration import RegistrationDocument, read_registration
from ronnaplan.documents.registration_exports import registration_csv, registration_markups
from ronnaplan.documents.table import csv_table
from ronnaplan.errors import UsageError


def export(path: str | os.PathLike[str], to: str) -> str | bytes:
    """Read the document at ``path`` and return it in the format ``to``; DICOM as bytes, all else as text."""
    content = read_json(path)
    if isinstance(content, dict) and content.get("format") == REGISTRATION:
        return REGISTRATION_EXPORTERS[to](read_registration(path))
    if to not in FIDUCIAL_EXPORTERS:
        raise UsageError(f"fiducials cannot become '{to}'; choose one of {', '.join(FIDUCIAL_EXPORTERS)}")
    return FIDUCIAL_EXPORTERS[to](read_fiducials(path))


def _fiducials_dicom(document: FiducialsDocument) -> bytes:
    from ronnaplan.documents.dicom_spatial import dicom_bytes, spatial_fiducials

    return dicom_bytes(spatial_fiducials(document))


def _registration_dicom(document: RegistrationDocument) -> bytes:
    from ronnaplan.documents.dicom_spatial import dicom_bytes, spatial_registration

    return dicom_bytes(spatial_registration(document))


FIDUCIAL_EXPORTERS: dict[str, Callable[[FiducialsDocument], str | bytes]] = {
    "markups": markups,
    "csv": csv_table,
    "dicom": _fiducials_dicom,
}
"""Formats a fiducials document can become, by the name given to ``--to``."""

REGISTRATION_EXPORTERS: dict[str, Callable[[RegistrationDocument], str | bytes]] = {
    "markups": registration_markups,
    "csv": registration_csv,
    "dicom": _registration_dicom,
    "itk": itk_transform,
}
"""Formats a registration document can become, by the name given to ``--to``."""
