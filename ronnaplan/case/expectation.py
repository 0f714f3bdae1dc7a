"""What error is to be expected in a case: of its registration where there is one, of its markers otherwise."""

from __future__ import annotations

from ronnaplan.documents.agreement import disagreement
from ronnaplan.documents.fiducials import FiducialsDocument
from ronnaplan.documents.registration import RegistrationDocument
from ronnaplan.errors import InputError
from ronnaplan.planning import Plan
from ronnaplan.planning.uncertainty import Expectation, ExpectedPose
from ronnaplan.registration.flags import RegistrationFlag


def expectation(
    fiducials: FiducialsDocument | None,
    registration: RegistrationDocument | None,
    sigma_ct_mm: float,
    sigma_ots_mm: float,
) -> Expectation:
    """Return the error as registered and as planned; the sigmas (per axis) are those of the planned one.

    A registration that was refused, or made of other markers than there are now, does not count; a remark says why.
    Whatever makes either of the two doubtful is a remark, too.
    """
    refusal = _refusal(fiducials, registration)
    remarks = [] if refusal is None else [refusal]
    if registration is not None:
        told = (*registration.notes, *(registration.doubts if refusal is None else ()))
        remarks += [f"registration: {sentence}" for sentence in told]
    if fiducials is not None:
        remarks += fiducials.doubts
    planned = None
    if fiducials is not None and fiducials.fiducials:
        try:
            planned = ExpectedPose.planned(fiducials.points, sigma_ct_mm, sigma_ots_mm)
        except InputError as error:
            remarks.append(f"no error can be expected of these markers: {error}")
    if planned is not None and planned.is_loose:
        remarks.append(f"as planned: {RegistrationFlag.LOOSE_ROTATION}")
    registered = registration.expected if registration is not None and refusal is None else None
    return Expectation(registered, planned, tuple(remarks))


def errors_at_ends_mm(
    expected: Expectation, registration: RegistrationDocument | None, plan: Plan | None
) -> dict[str, float]:
    """Return the error (RMS) as registered at every end of the plan's trajectories, by name.

    Without a plan it is that at the targets that the registration was made for; empty where none counts.
    """
    if expected.registered is None or registration is None:
        return {}
    if plan is None:
        return {target.name: target.predicted_tre_rms for target in registration.targets}
    places = plan.points
    errors = expected.registered.tre_rms_mm(places.positions_mm).tolist() if len(places.labels) else []
    return dict(zip(places.labels, errors, strict=True))


def _refusal(fiducials: FiducialsDocument | None, registration: RegistrationDocument | None) -> str | None:
    """Return why the registration does not count, None where it does or there is none."""
    if registration is None:
        return None
    if registration.status != "unique":
        return f"the registration is {registration.status}: {registration.reason}"
    return disagreement(fiducials, registration) if fiducials is not None else None
