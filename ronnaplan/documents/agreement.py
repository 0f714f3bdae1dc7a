"""Whether a registration was made of the markers as they are now."""

from __future__ import annotations

import numpy as np

from ronnaplan.documents.fiducials import FiducialsDocument
from ronnaplan.documents.registration import RegistrationDocument

SAME_CENTRE_MM = 1e-6
"""Round-off of a written centre."""


def disagreement(fiducials: FiducialsDocument, registration: RegistrationDocument) -> str | None:
    """Return in words how the registration's markers differ from ``fiducials``, None where they are the same."""
    centres = {one.label: one.center for one in fiducials.fiducials}
    known = {pair.ct for pair in registration.pairs} | set(registration.unpaired_ct)
    for pair in registration.pairs:
        if pair.ct not in centres:
            return f"the registration uses marker {pair.ct}, which is no longer there; register again"
        if not np.allclose(pair.center, centres[pair.ct], rtol=0.0, atol=SAME_CENTRE_MM):
            return f"the registration has marker {pair.ct} at another place; register again"
    missing = [label for label in centres if label not in known]
    if registration.status == "unique" and missing:
        return f"the registration does not know marker {missing[0]}; register again"
    return None
