"""Results to files, from Python: the documents that the command line writes, by the same functions."""

from __future__ import annotations

import os

from numpy.typing import ArrayLike

from ronnaplan.documents.fiducials import FiducialsDocument, fiducials_document, read_fiducials
from ronnaplan.documents.registration import RegistrationDocument, read_registration
from ronnaplan.documents.registration_made import registration_document, target_names
from ronnaplan.documents.revision import write_document
from ronnaplan.errors import check_type
from ronnaplan.geometry import Points, as_points
from ronnaplan.localization.fiducials import Fiducials
from ronnaplan.registration.marker_registration import MarkerRegistration


def write_fiducials(path: str | os.PathLike[str], found: Fiducials) -> FiducialsDocument:
    """Write what `localize` found to fiducials.json, and return the document.

    Raises `InputError` for what could not be read back, and where it cannot be written.
    """
    return write_document(path, fiducials_document(found), read_fiducials)


def write_registration(
    path: str | os.PathLike[str],
    registered: MarkerRegistration,
    found: Fiducials | FiducialsDocument,
    targets_mm: ArrayLike = (),
) -> RegistrationDocument:
    """Write what `register_markers` made of the markers ``found`` to registration.json, and return the document.

    With it goes the error to expect at ``targets_mm`` (T, 3), in the scan's LPS. A pairing that was refused is written
    with its rivals, and without a transform. Raises `FrameMismatchError` for the markers of another scan.
    """
    check_type(registered, MarkerRegistration, "the registration", "register_markers returns it")
    check_type(found, (Fiducials, FiducialsDocument), "what was found", "localize and read_fiducials return it")
    fiducials = fiducials_document(found) if isinstance(found, Fiducials) else found
    fiducials.points.frame.require(registered.ct.frame)
    places = as_points(targets_mm, "targets")
    targets = Points.exact(places, target_names(len(places)), registered.ct.frame)
    document = registration_document(registered, fiducials.source, targets)
    return write_document(path, document, read_registration)
