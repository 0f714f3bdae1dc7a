"""Whether a registration was made of the markers as they are now."""

from __future__ import annotations

import numpy as np

from ronnaplan.documents.fiducials import FiducialsDocument
from ronnaplan.documents.registration import RegistrationDocument

SAME_CENTER_MM = 1e-6
"""Round-off of a written center."""


def disagreement(fiducials: FiducialsDocument, registration: RegistrationDocument) -> str | None:
    """Return in words how the registration's markers differ from ``fiducials``, None where they are the same."""
    centers = {one.label: one.center for one in fiducials.fiducials}
    known = {pair.ct for pair in registration.pairs} | set(registration.unpaired_ct)
    for pair in registration.pairs:
        if pair.ct not in centers:
            return f"the registration uses marker {pair.ct}, which is no longer there; register again"
        if not np.allclose(pair.center, centers[pair.ct], rtol=0.0, atol=SAME_CENTER_MM):
            return f"the registration has marker {pair.ct} at another place; register again"
    missing = [label for label in centers if label not in known]
    if registration.status == "unique" and missing:
        return f"the registration does not know marker {missing[0]}; register again"
    return None
