"""A registration as tables that a person can read: residuals first, then the error to expect at the targets."""

from __future__ import annotations

from ronnaplan.documents.registration import RegistrationDocument

FRE_WARNING = (
    "FRE and residuals tell how well the markers agree; they do not measure the error at a target.\n"
    "The expected error (TRE) below follows from the stated marker errors and the markers' layout; it leaves out\n"
    "whatever moves the target itself, such as brain shift."
)


def registration_text(document: RegistrationDocument) -> str:
    """Return the pairs, the fit and the expected errors as text; if refused, the reason and the rivals."""
    if document.ots_from_ct is None:
        return _refusal(document)
    lines = ["CT marker  reading    residual  left out", "                             mm        mm"]
    for pair in document.pairs:
        out = "       -" if pair.leave_one_out is None else f"{pair.leave_one_out:8.2f}"
        lines.append(f"{pair.ct:<10} {pair.ots:<10} {pair.residual:8.2f}  {out}")
    lines.append(f"FRE {document.fre_rms:.3f} mm RMS; pairing probability {document.probability:.6f}")
    lines += [f"warning: {doubt}" for doubt in document.doubts]
    lines += ["", FRE_WARNING]
    if document.targets:
        width = max(8, *(len(target.name) for target in document.targets))
        lines += ["", f"expected error {document.expected}"]
        lines.append(f"{'target':<{width}}  expected error, mm RMS")
        lines += [f"{target.name:<{width}}  {target.predicted_tre_rms:8.2f}" for target in document.targets]
    return "\n".join(lines)


def _refusal(document: RegistrationDocument) -> str:
    lines = [f"no registration: the pairing is {document.status}", document.reason]
    for number, rival in enumerate(document.rivals, start=1):
        pairs = ", ".join(f"{pair.ct}={pair.ots}" for pair in rival.pairs)
        lines.append(f"rival {number}: {pairs} ({rival.log_evidence_below:.1f} nats below the first)")
    return "\n".join(lines)
