"""The markers of a scan as they are found, and what a person decides about them: the fitted values stay."""

from __future__ import annotations

from ronnaplan.ct import CTVolume
from ronnaplan.documents.agreement import disagreement
from ronnaplan.documents.fiducials import (
    FiducialEntry,
    FiducialsDocument,
    RejectedEntry,
    fiducials_document,
)
from ronnaplan.documents.registration import RegistrationDocument
from ronnaplan.errors import RefusedError, UsageError
from ronnaplan.text import as_read, listed

BY_HAND = "rejected by hand"
"""The reason of a marker that a person turned down; it is kept whole, so that it can be taken back."""


def localized(volume: CTVolume, diameter_mm: float, layer_mm: float) -> FiducialsDocument:
    """Look for the markers of a diameter in a scan, hollow or wrapped as ``layer_mm`` says."""
    from ronnaplan.localization import Build, localize

    found = localize(volume, diameter_mm=diameter_mm, marker=Build(layer_mm))
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
    entry = candidate(document, index)
    marker = entry.marker
    if marker is None:
        raise RefusedError(
            f"this candidate was rejected because {entry.reason}: it has no covariance and cannot be used; "
            "localize again with another diameter"
        )
    for one in document.fiducials:
        if as_read(one.label) == as_read(marker.label):
            raise UsageError(f"there is another marker {one.label}; rename it first")
    rest = document.rejected[:index] + document.rejected[index + 1 :]
    return document.model_copy(update={"fiducials": (*document.fiducials, marker), "rejected": rest})


def rename(document: FiducialsDocument, label: str, new: str) -> FiducialsDocument:
    """Give a marker another label, which must be new and not empty."""
    new = new.strip()
    marker = named(document, label)
    if not new or as_read(new) in {as_read(one.label) for one in document.fiducials if one is not marker}:
        raise UsageError(f"'{new}' cannot be the marker's name; choose one that is not empty and not in use")
    renamed = tuple(one.model_copy(update={"label": new}) if one is marker else one for one in document.fiducials)
    return document.model_copy(update={"fiducials": renamed})


def carried_over(
    registration: RegistrationDocument, before: FiducialsDocument, after: FiducialsDocument
) -> RegistrationDocument:
    """Return a registration of the markers ``before`` with the labels that the same markers have ``after``.

    A label is a name and no measurement: pairs, transform and errors stay. It is returned as it is where more than
    labels differs, where it is not of these markers, and where one of its sentences may tell of a renamed one.
    """
    new = dict(zip((one.label for one in before.fiducials), (one.label for one in after.fiducials), strict=False))
    pairings = (registration.pairs, *(rival.pairs for rival in registration.rivals))
    known = {*registration.unpaired_ct, *(pair.ct for pairs in pairings for pair in pairs)}
    told = "\n".join((registration.reason, registration.doubt or "", *registration.notes))
    if _unlabelled(before) != _unlabelled(after) or not known <= set(new) or disagreement(before, registration):
        return registration
    if any(label in told for label in known if new[label] != label):
        return registration
    pairs, *others = (tuple(pair.model_copy(update={"ct": new[pair.ct]}) for pair in pairs) for pairs in pairings)
    rivals = (
        rival.model_copy(update={"pairs": own}) for rival, own in zip(registration.rivals, others, strict=True)
    )
    alone = tuple(new[label] for label in registration.unpaired_ct)
    return registration.model_copy(update={"pairs": pairs, "rivals": tuple(rivals), "unpaired_ct": alone})


def _unlabelled(document: FiducialsDocument) -> list[FiducialEntry]:
    return [one.model_copy(update={"label": ""}) for one in document.fiducials]


def candidate(document: FiducialsDocument, index: int) -> RejectedEntry:
    """Return a rejected candidate by its place in their list; raises `UsageError` where there is none."""
    if not 0 <= index < len(document.rejected):
        raise UsageError(f"there is no rejected candidate {index}; there are {len(document.rejected)}")
    return document.rejected[index]


def named(document: FiducialsDocument, label: str) -> FiducialEntry:
    """Return the marker called ``label``; raises `UsageError` with the known names."""
    for one in document.fiducials:
        if one.label == label:
            return one
    known = listed(one.label for one in document.fiducials)
    raise UsageError(f"there is no marker {label}; there are {known}")
