"""What registration.json says of a registration that was made."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ronnaplan.documents.fiducials import Source
from ronnaplan.documents.reading import made
from ronnaplan.documents.registration import RegistrationDocument, TargetEntry
from ronnaplan.errors import InputError
from ronnaplan.geometry import LPS_FROM_RAS, FloatArray, Points
from ronnaplan.registration.diagnosis import doubted_marker, leave_one_out
from ronnaplan.registration.marker_registration import MarkerRegistration
from ronnaplan.registration.registration import Registration

SAME_PLACE_MM = 1e-3
"""No tracker reads every marker so near to its coordinates in the scan; tables of them have three digits or more."""


def registration_document(
    found: MarkerRegistration, source: Source, targets: Points | None = None, notes: Sequence[str] = ()
) -> RegistrationDocument:
    """Turn a registration into its document; ``targets`` are places of the same scan (`FrameMismatchError`).

    ``notes`` are what was to be told of the readings. Raises `InputError` for readings that are the scan's own markers.
    """
    content: dict[str, Any] = {
        "status": found.pairing.status,
        "reason": found.pairing.reason,
        "source": source.model_dump(),
        "frames": {"ct": found.ct.frame.name, "ots": found.ots.frame.name},
        "unpaired_ct": found.unpaired_ct,
        "unpaired_ots": found.unpaired_ots,
        "probability": _finite(found.pairing.probability),
        "rivals": [
            {"pairs": _labels(found, rival.pairs), "log_evidence_below": rival.log_evidence_below}
            for rival in found.pairing.rivals
        ],
        "notes": [*notes, *found.notes],
    }
    if found.registration is None:
        return made(RegistrationDocument, content)
    _require_read(found.registration)
    document = made(RegistrationDocument, content | _fitted(found, found.registration))
    return document if targets is None else document.model_copy(update={"targets": _targets(document, targets)})


def target_names(count: int) -> tuple[str, ...]:
    """Return what places are called of which only the coordinates were given."""
    return tuple(f"target {number}" for number in range(1, count + 1))


def _require_read(registration: Registration) -> None:
    """Raise `InputError` where all readings are the scan's markers to the last digit, in LPS or in RAS."""
    ct_mm, ots_mm = registration.moving_mm, registration.fixed_mm
    if any(np.abs(ots_mm - sign * ct_mm).max() < SAME_PLACE_MM for sign in (1.0, LPS_FROM_RAS)):
        raise InputError(
            "the readings are the scan's own markers, in the scan's coordinates; expected those of the tracker, so "
            "give the file that it recorded"
        )


def _fitted(found: MarkerRegistration, registration: Registration) -> dict[str, Any]:
    left_out: Sequence[float] = np.full(len(registration), np.nan).tolist()
    if len(registration) > 3:
        left_out = leave_one_out(registration).residuals_mm.tolist()
    residuals = registration.residuals_mm
    doubt = doubted_marker(registration)
    return {
        "pairs": [
            {
                **names,
                "residual": float(residuals[k]),
                "leave_one_out": _finite(left_out[k]),
                "center": registration.moving_mm[k].tolist(),
                "reading": registration.fixed_mm[k].tolist(),
            }
            for k, names in enumerate(_labels(found, found.pairing.pairs))
        ],
        "ots_from_ct": registration.transform.tolist(),
        "covariance": registration.pose.covariance.tolist(),
        "fre_rms": registration.fre_rms_mm,
        "sigma_ct_mm": found.sigma_ct_mm,
        "sigma_ots_mm": found.sigma_ots_mm,
        "fit_probability": registration.fit_probability,
        "flags": [flag.name.lower() for flag in registration.flags],
        "doubt": None if doubt is None else str(doubt),
    }


def _targets(document: RegistrationDocument, targets: Points) -> tuple[TargetEntry, ...]:
    """Return the error at ``targets`` as everyone tells it who reads the document."""
    document.require_frame(targets.frame)
    covariances = document.pose.point_covariances(targets.positions_mm)
    errors = document.expected.tre_rms_mm(targets.positions_mm)
    return tuple(
        made(
            TargetEntry,
            {
                "name": name,
                "center": place.tolist(),
                "predicted_tre_rms": float(error),
                "covariance": covariance.tolist(),
            },
        )
        for name, place, error, covariance in zip(
            targets.labels, targets.positions_mm, errors, covariances, strict=True
        )
    )


def _labels(found: MarkerRegistration, pairs: FloatArray | Any) -> list[dict[str, str]]:
    return [{"ct": found.ct.labels[int(i)], "ots": found.ots.labels[int(j)]} for i, j in pairs]


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
