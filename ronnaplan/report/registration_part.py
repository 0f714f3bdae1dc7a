"""The report's registration: pairs and residuals, then the error to expect where it matters."""

from __future__ import annotations

from ronnaplan.case.folder import Case
from ronnaplan.documents.agreement import disagreement
from ronnaplan.documents.registration import RegistrationDocument
from ronnaplan.documents.registration_text import FRE_WARNING
from ronnaplan.planning import Plan
from ronnaplan.planning.uncertainty import ExpectedPose
from ronnaplan.registration.registration import RegistrationFlag
from ronnaplan.report.html import element, table
from ronnaplan.report.part import Part, number

TITLE = "Registration"


def registration_part(case: Case) -> Part:
    """List the pairs and predict the error at every planned end; a refused registration is a warning."""
    found = case.registration
    if found is None:
        return Part(TITLE)
    if found.ots_from_ct is None:
        return Part(TITLE, _rivals(found), [f"the registration is {found.status}: {found.reason}"])
    rows = [(pair.ct, pair.ots, number(pair.residual), number(pair.leave_one_out)) for pair in found.pairs]
    body = [
        table(("CT marker", "reading", "residual mm", "left out mm"), rows),
        element("p", f"FRE {number(found.fre_rms, 3)} mm RMS; pairing probability {number(found.probability, 6)}"),
        element("p", FRE_WARNING, "note"),
    ]
    if case.expected.registered is not None:
        body += _expected_errors(found, case.plan, case.expected.registered)
    return Part(TITLE, body, _warnings(case, found))


def _expected_errors(found: RegistrationDocument, plan: Plan | None, expected: ExpectedPose) -> list[str]:
    """Show the error at the targets of the document, and at the ends of the plan's trajectories as they are now."""
    errors = {target.name: target.predicted_tre_rms for target in found.targets}
    if plan is not None:
        places = plan.points
        errors |= dict(zip(places.labels, expected.tre_rms_mm(places.positions_mm).tolist(), strict=True))
    if not errors:
        return []
    rows = [(name, f"{error:.3f}") for name, error in errors.items()]
    return [
        element("h3", "Expected error"),
        element("p", str(expected)),
        table(("place", "expected error, mm RMS"), rows),
    ]


def _warnings(case: Case, found: RegistrationDocument) -> list[str]:
    known = RegistrationFlag.__members__
    outdated = disagreement(case.fiducials, found) if case.fiducials else None
    warnings = [outdated] if outdated else []
    warnings += [f"registration: {known.get(flag.upper(), flag)}" for flag in found.flags]
    if found.doubt:
        warnings.append(f"registration: {found.doubt}")
    for what, labels in (("CT markers", found.unpaired_ct), ("readings", found.unpaired_ots)):
        if labels:
            warnings.append(f"registration: {what} without a partner: {', '.join(labels)}")
    return warnings


def _rivals(found: RegistrationDocument) -> list[str]:
    rows = [
        (", ".join(f"{pair.ct}={pair.ots}" for pair in rival.pairs), f"{rival.log_evidence_below:.1f}")
        for rival in found.rivals
    ]
    return [table(("rival pairing", "nats below the first"), rows)] if rows else []
