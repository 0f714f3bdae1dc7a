"""Is it a marker? Small named tests; the first one that fails is the reason for a rejection."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ronnaplan.ct.volume import CTVolume
from ronnaplan.geometry import FloatArray
from ronnaplan.localization.descent import BLUR_BOUNDS_MM, MAX_WANDER
from ronnaplan.localization.detect import MIN_CONTRAST_HU
from ronnaplan.localization.guess import margin_mm
from ronnaplan.localization.model import has_streaks
from ronnaplan.localization.neighbourhood import cell_directions
from ronnaplan.localization.refine import BallFit
from ronnaplan.localization.uncertainty import center_covariance

DIAMETER_TOLERANCE = 0.06
"""A marker's fitted diameter lies within this share of the stated one ..."""

DIAMETER_TOLERANCE_MM = 0.25
"""... or within this, where that is more (small balls, whose blur and size look alike)."""

MIN_COVERAGE = 0.6
"""A marker shows at least this share of its surface: a capsule's end shows half a sphere, a post hides a fifth."""

MIN_ROUND = 0.58
ROUND_MISFIT = 2.0
"""A marker's edge is a sphere's in at least this share of the directions, and of those that the scan shows in more by
this many times its misfit: heads of screws and cones come near 0.6, but raggedly; metal in its own streaks does so
cleanly ..."""

MIN_METAL_ROUND = 0.66
"""... a ball of metal in at least this share of those that the scan shows: all that is bright beside it is fitted with
it, and its scale's end makes the head of a screw look clean ..."""

ROUND_LENGTH = 0.5
"""... and by this much of what its slices seem too thick or too thin by, as a share of the nominal thickness: the head
of a screw seen in thick slices has soft ends, a cone a sharp one."""

MAX_ATTACHED = 0.14
"""A post is attached to a small part of a marker's surface (a post of 4 mm to 3 % of one of 11.5 mm, skin that it lies
on to 10 %); a capsule or a rod goes on in far more of it."""

MIN_INFORMED = 0.3
"""With less of the surface free of neighbours the centre is not told in all directions."""

MAX_MISFIT = 0.06
"""Largest RMS residual on the surface, as a share of the contrast, beyond what noise explains."""

MAX_BLUR_MM = 1.1
MAX_BLUR_PIXELS = 1.5
MAX_BLUR_SHARE = 0.3
"""In-plane blur is no more than the softest kernels give, or this many pixels where these are large; and with more
than this share of the diameter there is no shape to recognize."""

THICKNESS_RATIO = 1.2
THICKNESS_MARGIN_MM = 0.35
"""The effective slice thickness exceeds the nominal one by no more: what looks longer along the slices is no ball."""

NOISE_MARGIN = 1.3
"""Noise differs between places by up to this factor: it was measured where it is least."""

MAX_NOISE = 0.2
"""Noise, as a share of the contrast, that is allowed for in the misfit; a noisier scan is not fit for use."""

MAX_STANDARD_ERROR = 0.03
"""Largest standard error of the centre, as a share of the diameter, that is still called a localization."""


@dataclass(frozen=True)
class Evidence:
    """All that the tests look at."""

    fit: BallFit
    diameter_mm: float
    thickness_mm: float
    pixel_mm: float
    noise_hu: float

    @cached_property
    def covariance_mm2(self) -> FloatArray:
        """Covariance (3, 3) of the centre in LPS."""
        return center_covariance(self.fit, self.noise_hu)


Test = Callable[[Evidence], str | None]
"""Returns None when the candidate passes, else the reason in words."""


def profile_share(volume: CTVolume, center_mm: FloatArray, diameter_mm: float, thickness_mm: float) -> float:
    """Share of directions in which the image falls from the ball's level to the surroundings' at its surface.

    A quick look at nearest voxels that spares most candidates the fit: the fit cannot cover more of the surface.
    """
    radius = diameter_mm / 2.0
    directions = cell_directions()
    axial = np.abs(directions @ volume.grid.normal)[:, np.newaxis]
    margin = margin_mm(0.0) + (margin_mm(thickness_mm) - margin_mm(0.0)) * axial
    inner = _samples(volume, center_mm + 0.5 * radius * directions)
    outer = _samples(volume, center_mm + (radius + 0.7 * margin) * directions)
    if not (np.isfinite(inner).any() and np.isfinite(outer).any()):
        return 0.0
    high, low = float(np.nanmedian(inner)), float(np.nanquantile(outer, 0.3))
    if high - low < MIN_CONTRAST_HU:
        return 0.0
    middle = (high + low) / 2.0
    return float(np.mean((inner > middle) & (outer < middle)))


def _samples(volume: CTVolume, places_mm: FloatArray) -> FloatArray:
    """Nearest voxel's value at each place (N, 3), NaN outside the scan."""
    indices = np.rint(volume.grid.indices(places_mm)).astype(np.intp)
    inside = np.all((indices >= 0) & (indices < volume.voxels_hu.shape), axis=1)
    values = np.full(len(indices), np.nan)
    values[inside] = volume.voxels_hu[tuple(indices[inside].T)]
    return values


def _converged(evidence: Evidence) -> str | None:
    return None if evidence.fit.converged else "the fit did not come to rest"


def _stayed(evidence: Evidence) -> str | None:
    moved = float(np.linalg.norm(evidence.fit.theta[:3]))
    if moved <= MAX_WANDER * evidence.diameter_mm / 2.0:
        return None
    return f"the fit wandered {moved:.1f} mm away"


def _contrast(evidence: Evidence) -> str | None:
    if evidence.fit.contrast_hu >= MIN_CONTRAST_HU:
        return None
    return f"contrast {evidence.fit.contrast_hu:.0f} HU, at least {MIN_CONTRAST_HU:.0f} expected"


def _blur(evidence: Evidence) -> str | None:
    sigma = evidence.fit.sigma_mm
    largest = min(max(MAX_BLUR_MM, MAX_BLUR_PIXELS * evidence.pixel_mm), MAX_BLUR_SHARE * evidence.diameter_mm)
    if BLUR_BOUNDS_MM[0] < sigma < largest:
        return None
    return f"its edge is blurred by {sigma:.2f} mm, {BLUR_BOUNDS_MM[0]} to {largest:.2f} mm expected"


def _thickness(evidence: Evidence) -> str | None:
    thickness = float(evidence.fit.theta[5])
    if thickness <= THICKNESS_RATIO * evidence.thickness_mm + THICKNESS_MARGIN_MM:
        return None
    return f"its ends are blurred over {thickness:.1f} mm, slices of {evidence.thickness_mm:.1f} mm expected"


def _diameter(evidence: Evidence) -> str | None:
    found, stated = evidence.fit.diameter_mm, evidence.diameter_mm
    tolerance = max(DIAMETER_TOLERANCE * stated, DIAMETER_TOLERANCE_MM)
    if abs(found - stated) <= tolerance:
        return None
    return f"diameter {found:.2f} mm, {stated:.2f} +- {tolerance:.2f} mm expected"


def _coverage(evidence: Evidence) -> str | None:
    fit = evidence.fit
    round_share = fit.verdict.round_share
    if round_share < MIN_ROUND:
        unseen = f", {fit.unseen:.0%} is outside the scan" if fit.unseen > 0 else ""
        return f"only {round_share:.0%} of its surface is a sphere's{unseen}, {MIN_ROUND:.0%} expected"
    ends_off = abs(float(fit.theta[5]) / evidence.thickness_mm - 1.0)
    least = MIN_METAL_ROUND if has_streaks(fit.theta) else MIN_ROUND
    expected = least + ROUND_MISFIT * fit.misfit + ROUND_LENGTH * ends_off
    of_seen = round_share / (1.0 - fit.unseen)
    if of_seen >= expected:
        return None
    return f"only {of_seen:.0%} of what is seen of its surface is a sphere's, {expected:.0%} expected"


def _free(evidence: Evidence) -> str | None:
    attached = evidence.fit.verdict.attached_share
    if attached <= MAX_ATTACHED:
        return None
    return f"{attached:.0%} of its surface is attached to something as bright, {MAX_ATTACHED:.0%} allowed"


def _informed(evidence: Evidence) -> str | None:
    if evidence.fit.coverage >= MIN_INFORMED:
        return None
    return f"only {evidence.fit.coverage:.0%} of its surface can be used, {MIN_INFORMED:.0%} expected"


def _roundness(evidence: Evidence) -> str | None:
    contrast = evidence.fit.contrast_hu
    limit = float(np.hypot(MAX_MISFIT, min(NOISE_MARGIN * evidence.noise_hu / contrast, MAX_NOISE)))
    if evidence.fit.misfit <= limit:
        return None
    return f"its surface departs from a sphere's by {evidence.fit.misfit:.1%} of its contrast, {limit:.1%} allowed"


def _certainty(evidence: Evidence) -> str | None:
    error = float(np.sqrt(np.trace(evidence.covariance_mm2)))
    limit = MAX_STANDARD_ERROR * evidence.diameter_mm
    return None if error <= limit else f"its centre is uncertain by {error:.2f} mm, {limit:.2f} mm allowed"


TESTS: dict[str, Test] = {
    "stayed": _stayed,
    "contrast": _contrast,
    "blur": _blur,
    "thickness": _thickness,
    "diameter": _diameter,
    "coverage": _coverage,
    "free": _free,
    "informed": _informed,
    "roundness": _roundness,
    "converged": _converged,
    "certainty": _certainty,
}


def failures(evidence: Evidence) -> Iterator[tuple[str, str]]:
    """Yield (name, reason) of each test that the candidate fails, in order."""
    for name, test in TESTS.items():
        reason = test(evidence)
        if reason is not None:
            yield name, reason
