"""What error is to be expected in a case: of its registration where there is one, of its markers otherwise."""

from __future__ import annotations

from ronnaplan.documents.agreement import disagreement
from ronnaplan.documents.fiducials import FiducialsDocument
from ronnaplan.documents.registration import RegistrationDocument
from ronnaplan.errors import InputError
from ronnaplan.planning.uncertainty import Expectation, ExpectedPose


def expectation(
    fiducials: FiducialsDocument | None,
    registration: RegistrationDocument | None,
    sigma_ct_mm: float,
    sigma_ots_mm: float,
) -> Expectation:
    """Return the error as registered and as planned; the sigmas (per axis) are those of the planned one.

    A registration that was refused, or made of other markers than there are now, does not count; a remark says why.
    """
    refusal = _refusal(fiducials, registration)
    remarks = [] if refusal is None else [refusal]
    planned = None
    if fiducials is not None and fiducials.fiducials:
        try:
            planned = ExpectedPose.planned(fiducials.points, sigma_ct_mm, sigma_ots_mm)
        except InputError as error:
            remarks.append(f"no error can be expected of these markers: {error}")
    registered = registration.expected if registration is not None and refusal is None else None
    return Expectation(registered, planned, tuple(remarks))


def _refusal(fiducials: FiducialsDocument | None, registration: RegistrationDocument | None) -> str | None:
    """Return why the registration does not count, None where it does or there is none."""
    if registration is None:
        return None
    if registration.status != "unique":
        return f"the registration is {registration.status}: {registration.reason}"
    return disagreement(fiducials, registration) if fiducials is not None else None
