"""A registration as tables that a person can read: residuals first, then the error to expect at the targets."""

from __future__ import annotations

import numpy as np

from ronnaplan.documents.registration import RegistrationDocument
from ronnaplan.registration.radius import radius_95_mm
from ronnaplan.sigmas import MISFIT_PROBABILITY
from ronnaplan.text import chance, columns, filled

FRE_WARNING = (
    "FRE and residuals tell how well the markers agree; they do not measure the error at a target.\n"
    "The expected error (TRE) follows from the stated marker errors and the markers' layout; it leaves out\n"
    "whatever moves the target itself, such as brain shift."
)
FIT = (
    f"how often errors as stated leave residuals as large; below {MISFIT_PROBABILITY:g} or above "
    f"{1 - MISFIT_PROBABILITY:g} is a warning"
)
CENTROID = "markers' centroid"
LEAST_COLUMNS = 10
"""Of a terminal, for the label of a marker or a reading."""


def registration_text(document: RegistrationDocument) -> str:
    """Return the pairs, the fit and the expected errors as text; if refused, the rivals (the reason is the error's)."""
    if document.ots_from_ct is None:
        return _refusal(document)
    ct, ots = (
        max(LEAST_COLUMNS, *map(columns, labels))
        for labels in zip(*((pair.ct, pair.ots) for pair in document.pairs), strict=True)
    )
    lines = [f"{'CT marker':<{ct}} {'reading':<{ots}} residual  left out", f"{'mm':>{ct + ots + 10}}        mm"]
    for pair in document.pairs:
        out = "       -" if pair.leave_one_out is None else f"{pair.leave_one_out:8.2f}"
        lines.append(f"{filled(pair.ct, ct)} {filled(pair.ots, ots)} {pair.residual:8.2f}  {out}")
    lines.append(f"FRE {document.fre_rms:.3f} mm RMS; pairing probability {chance(document.probability, 6)}")
    lines += [f"fit probability {fits:.3g}: {FIT}" for fits in [document.fit_probability] if fits is not None]
    lines += [f"warning: {doubt}" for doubt in document.doubts]
    lines += ["", FRE_WARNING]
    errors = _expected_errors(document)
    width = max(map(columns, errors))
    lines += ["", f"expected error {document.expected}"]
    lines += [f"{'place':<{width}}    mm RMS   95 % within mm"]
    lines += [f"{filled(name, width)}  {rms:8.2f}  {radius:15.2f}" for name, (rms, radius) in errors.items()]
    return "\n".join(lines)


def _expected_errors(document: RegistrationDocument) -> dict[str, tuple[float, float]]:
    """Return the RMS error, and the radius that holds it with 95 %, at the markers' centroid and at the targets.

    At the centroid the error is about least.
    """
    centroid_mm = np.mean([pair.center for pair in document.pairs], axis=0, keepdims=True)
    rms_mm = [float(document.expected.tre_rms_mm(centroid_mm)[0])]
    rms_mm += [target.predicted_tre_rms for target in document.targets]
    targets_mm2 = [np.array(target.covariance) for target in document.targets]
    radii_mm = radius_95_mm([document.expected.covariances_mm2(centroid_mm)[0], *targets_mm2]).tolist()
    names = [CENTROID, *(target.name for target in document.targets)]
    return dict(zip(names, zip(rms_mm, radii_mm, strict=True), strict=True))


def _refusal(document: RegistrationDocument) -> str:
    lines = [f"no registration: the pairing is {document.status}"]
    for number, rival in enumerate(document.rivals, start=1):
        pairs = ", ".join(f"{pair.ct}={pair.ots}" for pair in rival.pairs)
        lines.append(f"rival {number}: {pairs} ({rival.log_evidence_below:.1f} nats below the first)")
    return "\n".join(lines)
