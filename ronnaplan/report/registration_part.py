"""The report's registration: pairs and residuals, then the error to expect where it matters."""

from __future__ import annotations

from ronnaplan.case.expectation import errors_at_ends_mm
from ronnaplan.case.folder import Case
from ronnaplan.documents.agreement import disagreement
from ronnaplan.documents.registration import RegistrationDocument
from ronnaplan.documents.registration_text import FRE_WARNING
from ronnaplan.planning.rows import number
from ronnaplan.report.html import Part, element, table
from ronnaplan.text import chance, told_apart

TITLE = "Registration"


def registration_part(case: Case) -> Part:
    """List the pairs and predict the error at every planned end; a refused registration is a warning."""
    found = case.registration
    if found is None:
        return Part(TITLE)
    if found.ots_from_ct is None:
        refused = f"the registration is {found.status}: {found.reason}"
        return Part(TITLE, _rivals(found), [refused, *_warnings(case, found)])
    rows = [(pair.ct, pair.ots, number(pair.residual), number(pair.leave_one_out)) for pair in found.pairs]
    body = [
        table(("CT marker", "reading", "residual mm", "left out mm"), rows),
        element("p", f"FRE {number(found.fre_rms, 3)} mm RMS; pairing probability {chance(found.probability, 6)}"),
        element("p", FRE_WARNING, "note"),
    ]
    return Part(TITLE, body + _expected_errors(case), _warnings(case, found))


def _expected_errors(case: Case) -> list[str]:
    """Show the error at the ends of the plan's trajectories as they are now."""
    errors = errors_at_ends_mm(case.expected, case.registration, case.plan)
    if not errors:
        return []
    shown = told_apart(errors)
    rows = [(shown[name], f"{error:.3f}") for name, error in errors.items()]
    return [
        element("h3", "Expected error"),
        element("p", str(case.expected.registered)),
        table(("place", "expected error, mm RMS"), rows),
    ]


def _warnings(case: Case, found: RegistrationDocument) -> list[str]:
    outdated = disagreement(case.fiducials, found) if case.fiducials else None
    told = [f"registration: {sentence}" for sentence in (*found.notes, *found.doubts)]
    return [outdated, *told] if outdated else told


def _rivals(found: RegistrationDocument) -> list[str]:
    rows = [
        (", ".join(f"{pair.ct}={pair.ots}" for pair in rival.pairs), f"{rival.log_evidence_below:.1f}")
        for rival in found.rivals
    ]
    return [table(("rival pairing", "nats below the first"), rows)] if rows else []
