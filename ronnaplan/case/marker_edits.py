"""The markers of a scan as they are found, and what a person decides about them: the fitted values stay."""

from __future__ import annotations

from ronnaplan.ct import CTVolume
from ronnaplan.ct.progress import Progress
from ronnaplan.documents.fiducials import (
    FiducialEntry,
    FiducialsDocument,
    RejectedEntry,
    fiducials_document,
)
from ronnaplan.errors import RefusedError, UsageError

BY_HAND = "rejected by hand"
"""The reason of a marker that a person turned down; it is kept whole, so that it can be taken back."""


def localized(
    volume: CTVolume, diameter_mm: float, layer_mm: float = 0.0, progress: Progress = False
) -> FiducialsDocument:
    """Look for the markers of a diameter in a scan, hollow or wrapped as ``layer_mm`` says."""
    from ronnaplan.localization import Build, localize

    found = localize(volume, diameter_mm=diameter_mm, marker=Build(layer_mm), progress=progress)
    return fiducials_document(found)


def reject(document: FiducialsDocument, label: str) -> FiducialsDocument:
    """Move a marker to the rejected ones."""
    marker = named(document, label)
    kept = tuple(one for one in document.fiducials if one.label != label)
    entry = RejectedEntry(center=marker.center, reason=BY_HAND, marker=marker)
    return document.model_copy(update={"fiducials": kept, "rejected": (entry, *document.rejected)})


def accept(document: FiducialsDocument, index: int) -> FiducialsDocument:
    """Take a marker back that was rejected by hand.

    Raises `RefusedError` for a candidate that the localizer rejected: it has no covariance, and a position without
    one is not used.
    """
    if not 0 <= index < len(document.rejected):
        raise UsageError(f"there is no rejected candidate {index}; there are {len(document.rejected)}")
    entry = document.rejected[index]
    marker = entry.marker
    if marker is None:
        raise RefusedError(
            f"this candidate was rejected because {entry.reason}: it has no covariance and cannot be used; "
            "localize again with another diameter"
        )
    if marker.label in {one.label for one in document.fiducials}:
        raise UsageError(f"there is another marker {marker.label}; rename it first")
    rest = document.rejected[:index] + document.rejected[index + 1 :]
    return document.model_copy(update={"fiducials": (*document.fiducials, marker), "rejected": rest})


def rename(document: FiducialsDocument, label: str, new: str) -> FiducialsDocument:
    """Give a marker another label, which must be new and not empty."""
    new = new.strip()
    marker = named(document, label)
    if not new or new in {one.label for one in document.fiducials if one is not marker}:
        raise UsageError(f"'{new}' cannot be the marker's name; choose one that is not empty and not in use")
    renamed = tuple(one.model_copy(update={"label": new}) if one is marker else one for one in document.fiducials)
    return document.model_copy(update={"fiducials": renamed})


def named(document: FiducialsDocument, label: str) -> FiducialEntry:
    """Return the marker called ``label``; raises `UsageError` with the known names."""
    for one in document.fiducials:
        if one.label == label:
            return one
    known = ", ".join(one.label for one in document.fiducials) or "none"
    raise UsageError(f"there is no marker {label}; there are {known}")
