"""When a registration is doubted, and why."""

from __future__ import annotations

from enum import StrEnum

LOOSE_ROTATION_DEG = 8.0
"""Standard deviation of a rotation above which the layout is flagged: 14 mm at 100 mm. The error of a fit is right
within 2 % at 5 degrees and within 5 % at 10 (docs/registration.md); 8 is between."""

MIRROR_GAIN = 5.0
"""A mirrored fit with an FRE this many times smaller than the rigid one tells that one point set is left-handed."""


class RegistrationFlag(StrEnum):
    """Reasons to doubt a registration.

    `MISFIT` stands where `Registration.fit_probability` is below `MISFIT_PROBABILITY` (0.001), `TOO_GOOD` above 0.999,
    `LOOSE_ROTATION` beyond `LOOSE_ROTATION_DEG`, as it says; `STRETCHED` where `Registration.stretch` tells one.
    """

    THREE_MARKERS = "only three pairs: one bad marker cannot be told from the others"
    ERRORS_FROM_RESIDUALS = "no marker errors were stated, so they are estimated from few residuals"
    LOOSE_ROTATION = (
        f"the markers' layout leaves a rotation uncertain by more than {LOOSE_ROTATION_DEG:g} degrees, so expected "
        "errors are unreliable"
    )
    MISFIT = "the residuals are larger than the stated marker errors explain"
    TOO_GOOD = "the residuals are far smaller than the stated marker errors; the stated errors may be too large"
    MIRRORED = "the points fit a mirror image far better; one set may be left-handed"
    STRETCHED = (
        "the pairs agree far better where one side is stretched; check the scan's pixel size and slice distance, and "
        "the tracker's scale"
    )
    UNSETTLED = "the fit did not settle, as the pairs contradict each other far beyond their stated errors"
