"""Is it a marker? Small named tests; the first one that fails is the reason for a rejection."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Set

import numpy as np

from ronnaplan.geometry import rms_mm
from ronnaplan.localization.fit.descent import BLUR_BOUNDS_MM, MAX_CONTRAST_HU, MAX_WANDER
from ronnaplan.localization.fit.directions import MAX_RAGGED
from ronnaplan.localization.fit.model import has_streaks
from ronnaplan.localization.fit.parameters import BACKGROUND, CENTER, WIDTH
from ronnaplan.localization.judge.evidence import Evidence
from ronnaplan.localization.judge.pasted import LEAST_ROUND, PUT_BACK, left_out_hu
from ronnaplan.localization.judge.sunk import most_attached
from ronnaplan.localization.judge.whole import what_is_missing
from ronnaplan.localization.search.detect import MIN_CONTRAST_HU

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
it, and its scale's end makes the head of a screw look clean."""

ALIKE_ROUND, ALIKE_INFORMED = 0.5, 0.25
"""What is as large as the balls of a scan that makes them ragged (`Evidence.is_alike`) has to be a sphere's, and to be
used, in no more of its surface."""

ROUND_WIDTH, THIN_SHARE = 0.3, 0.25
"""Slices blur what tells a sphere from other things: the share that is needed grows by this many times the slice
profile's width beyond this share of the diameter, of what is not attached to skin. In 5 mm slices, markers of 11.5 mm
on posts show 0.89 and more."""

SUNK_RAGGED = 0.09
"""Of a ball that is sunk into a bar or a plate (`judge.sunk`) all the rest is round, but for this share: balls show
0.08, studs with round ends 0.10 and more."""

POST_SHARE, RAGGED_WIDTH = 0.08, 0.1
"""What is attached to more of a marker's surface than the first is thicker than any post; if skin, all the rest is
round, but for `MAX_RAGGED`, which grows by the second times what the slice profile's width is beyond `THIN_SHARE`, for
it smears the skin into the edge around. In 3 mm slices computed aslant balls of 10 mm show 0.07 to 0.21."""

MIN_INFORMED = 0.3
"""With less of the surface free of neighbours the center is not told in all directions."""

MAX_MISFIT = 0.06
"""Largest RMS residual on the surface, as a share of the contrast, beyond what noise explains."""

MAX_BLUR_MM = 1.6
MAX_BLUR_PIXELS = 1.5
MAX_BLUR_SHARE = 0.3
"""In-plane blur is no more than the softest kernels give, or this many pixels where these are large; and with more
than this share of the diameter there is no shape to recognize."""

PASTED_PIXELS, PASTED_THICKNESS = 0.5, 0.1
"""Clipped balls whose edge is blurred by less than this many pixels, and their ends over less than this share of the
slices' thickness, end from one voxel to the next in all directions, as no scanner shows them: metal artifact reduction
cut them out and put them back in. What is left of their surface is where its threshold lay."""

WIDTH_RATIO = 2.0
WIDTH_MARGIN_SHARE = 0.2
"""The slice profile is no wider than the nominal thickness by this factor and this share of the diameter. Tags hold the
width of the voxel or of the detector row, or nothing, and helical and interpolated profiles are broader; but a profile
that is wide beside the ball makes a ball of anything, unless all balls of the scan show it (`usual.usual_of`)."""

METAL_WIDTH_SHARE = 0.5
"""Of metal, whose inside is clipped and whose streaks hide an oval, the profile alone tells a ball from what is longer
along the slices' normal: an ellipsoid longer by a third seems blurred by 0.7 of its diameter more. Its profile is no
wider than the nominal thickness and this share of the diameter (added as variances), unless others show it, too."""

MAX_HIDDEN = 0.35
"""Slices leave no more of a ball unseen between two of them than this share of its diameter. As if slices of 2 mm were
ten times as thin, each cut of a rod of 1.8 mm looks like a ball of 3 mm, of which the next slices show nothing. Of some
2,200 balls of 3 to 11.5 mm, also in slices with gaps of a third, 0.33 are hidden at most; of nearly all rods 0.5."""

NO_AIR_HU = -600.0
"""A scale that begins above this shows no air. Of what is cut off at its other end, too, the edge alone is seen in
passing: balls of metal came out 0.1 mm off, and nothing told."""

NOISE_MARGIN = 1.3
"""Noise differs between places by up to this factor: it was measured where it is least."""

MAX_NOISE = 0.2
"""Noise, as a share of the contrast, that is allowed for in the misfit; a noisier scan is not fit for use."""

MAX_STANDARD_ERROR = 0.03
"""Largest standard error of the center, as a share of the diameter, that is still called a localization."""

Test = Callable[[Evidence], str | None]
"""Returns None when the candidate passes, else the reason in words."""


def _converged(evidence: Evidence) -> str | None:
    return None if evidence.fit.converged else "the fit did not come to rest"


def _stayed(evidence: Evidence) -> str | None:
    moved = float(np.linalg.norm(evidence.fit.theta[CENTER]))
    if moved <= MAX_WANDER * evidence.diameter_mm / 2.0:
        return None
    return f"the fit wandered {moved:.1f} mm away"


def _contrast(evidence: Evidence) -> str | None:
    contrast = evidence.fit.contrast_hu
    if contrast >= MAX_CONTRAST_HU:  # what is larger than it should be, and clipped, looks ever brighter instead
        return (
            f"contrast {MAX_CONTRAST_HU:.0f} HU or more: it is larger than stated, or absorbs more than zirconia"
        )
    if evidence.fit.is_clipped:
        floor_hu = float(evidence.fit.neighbourhood.floors_hu.min())
        if evidence.fit.theta[BACKGROUND] <= floor_hu and floor_hu > NO_AIR_HU:
            return f"the scale shows neither itself nor what is around it, for it begins at {floor_hu:.0f} HU"
    if contrast >= MIN_CONTRAST_HU:
        return None
    return f"contrast {contrast:.0f} HU, at least {MIN_CONTRAST_HU:.0f} expected"


def _blur(evidence: Evidence) -> str | None:
    sigma, pixel_mm = evidence.fit.sigma_mm, evidence.fit.neighbourhood.pixel_mm
    largest = min(max(MAX_BLUR_MM, MAX_BLUR_PIXELS * pixel_mm), MAX_BLUR_SHARE * evidence.diameter_mm)
    is_steep = (
        sigma < PASTED_PIXELS * pixel_mm and evidence.fit.theta[WIDTH] < PASTED_THICKNESS * evidence.thickness_mm
    )
    if evidence.fit.is_clipped and is_steep:
        return f"it ends from one voxel to the next, {PUT_BACK}"
    if BLUR_BOUNDS_MM[0] < sigma < largest:
        return None
    return f"its edge is blurred by {sigma:.2f} mm, {BLUR_BOUNDS_MM[0]} to {largest:.2f} mm expected"


def _thickness(evidence: Evidence) -> str | None:
    width = float(evidence.fit.theta[WIDTH])
    by_the_tag = WIDTH_RATIO * evidence.thickness_mm + WIDTH_MARGIN_SHARE * evidence.diameter_mm
    if has_streaks(evidence.fit.theta):
        by_the_tag = min(by_the_tag, math.hypot(evidence.thickness_mm, METAL_WIDTH_SHARE * evidence.diameter_mm))
    widest = max(by_the_tag, evidence.thickness_mm + evidence.usual.broadening_mm)
    if width <= widest:
        return None
    return f"its ends are blurred over {width:.1f} mm, {widest:.1f} mm at most expected"


def _hidden(evidence: Evidence) -> str | None:
    unseen_mm = evidence.gap_mm - float(evidence.fit.theta[WIDTH])
    most_mm = MAX_HIDDEN * evidence.diameter_mm
    if unseen_mm <= most_mm:
        return None
    return (
        f"the slices seem to leave {unseen_mm:.1f} mm unseen between them, {most_mm:.1f} mm of it at most allowed"
    )


def _diameter(evidence: Evidence) -> str | None:
    found, stated = evidence.fit.diameter_mm, evidence.diameter_mm
    tolerance = max(DIAMETER_TOLERANCE * stated, DIAMETER_TOLERANCE_MM)
    if abs(found - stated) <= tolerance:
        return None
    return f"diameter {found:.2f} mm, {stated:.2f} +- {tolerance:.2f} mm expected"


def _thickness_beyond(evidence: Evidence) -> float:
    """By how much the slice profile is wider than that of thin slices, as a share of the diameter."""
    return max(float(evidence.fit.theta[WIDTH]) / evidence.diameter_mm - THIN_SHARE, 0.0)


def _coverage(evidence: Evidence) -> str | None:
    fit = evidence.fit
    of_seen = evidence.verdict.round_share
    of_all = of_seen * (1.0 - evidence.unseen) * (1.0 - fit.neighbourhood.ending_share)
    least = ALIKE_ROUND if evidence.is_alike else MIN_ROUND
    if of_all < least:
        return f"only {of_all:.0%} of its surface is a sphere's{_outside(evidence)}, {least:.0%} expected"
    if has_streaks(fit.theta):
        least = MIN_METAL_ROUND
    least += ROUND_MISFIT * evidence.own_misfit
    blurred = ROUND_WIDTH * _thickness_beyond(evidence)
    attached = evidence.verdict.attached_share
    free = 1.0 - attached if attached > POST_SHARE else 1.0
    expected = min(max(least, (least + blurred) * free), 1.0)
    if of_seen >= expected:
        return None
    return f"only {of_seen:.0%} of what is seen of its surface is a sphere's, {expected:.0%} expected"


def _free(evidence: Evidence) -> str | None:
    verdict = evidence.verdict
    attached = verdict.attached_share
    if attached <= POST_SHARE:
        return None
    allowed, is_sunk = most_attached(evidence.volume, evidence.fit)
    if attached > allowed:
        return f"{attached:.0%} of its surface is attached to something as bright, {allowed:.0%} allowed"
    ragged = SUNK_RAGGED if is_sunk else MAX_RAGGED
    ragged += RAGGED_WIDTH * _thickness_beyond(evidence)
    if verdict.ragged_share <= ragged:
        return None
    return (
        f"it goes on into something as bright, and {verdict.ragged_share:.0%} of its surface beside that is no "
        f"sphere's, {ragged:.0%} allowed"
    )


def _informed(evidence: Evidence) -> str | None:
    informed = evidence.fit.coverage * (1.0 - evidence.unseen)
    least = ALIKE_INFORMED if evidence.is_alike else MIN_INFORMED
    if informed >= least:
        return None
    return f"only {informed:.0%} of its surface can be used{_outside(evidence)}, {least:.0%} expected"


def _outside(evidence: Evidence) -> str:
    """Say how much of a ball the scan does not reach, which is why less of its surface counts."""
    return f", {evidence.unseen:.0%} is outside the scan" if evidence.unseen > 0 else ""


def _roundness(evidence: Evidence) -> str | None:
    noise = NOISE_MARGIN * evidence.noise_hu / evidence.fit.contrast_hu
    limit, found = float(np.hypot(MAX_MISFIT, min(noise, MAX_NOISE))), evidence.fit.misfit
    if evidence.own_misfit <= limit:
        return None
    if math.isinf(found):
        return "nothing of its surface can be used"
    allowed = float(np.hypot(limit, evidence.excused_misfit))
    return f"its surface departs from a sphere's by {found:.1%} of its contrast, {allowed:.1%} allowed"


def _pasted(evidence: Evidence) -> str | None:
    if evidence.verdict.round_share < LEAST_ROUND:
        return None
    around = evidence.fit.neighbourhood
    gap_hu = left_out_hu(evidence.volume, evidence.fit.center_mm, evidence.diameter_mm, around.axes)
    if gap_hu is None:
        return None
    return f"no voxel at its edge lies between {gap_hu[0]:.0f} and {gap_hu[1]:.0f} HU, {PUT_BACK}"


def _certainty(evidence: Evidence) -> str | None:
    error = float(rms_mm(evidence.covariance_mm2))
    limit = MAX_STANDARD_ERROR * evidence.diameter_mm
    return None if error <= limit else f"its center is uncertain by {error:.2f} mm, {limit:.2f} mm allowed"


TESTS: dict[str, Test] = {
    "stayed": _stayed,
    "contrast": _contrast,
    "blur": _blur,
    "thickness": _thickness,
    "hidden": _hidden,
    "diameter": _diameter,
    "coverage": _coverage,
    "free": _free,
    "informed": _informed,
    "roundness": _roundness,
    "whole": what_is_missing,
    "converged": _converged,
    "certainty": _certainty,
}


def failures(evidence: Evidence, but: Set[str] = frozenset()) -> Iterator[tuple[str, str]]:
    """Yield (name, reason) of each test that the candidate fails, in order; those named in ``but`` are not asked.

    How certain it is, is asked of what passes all others: hundreds of candidates need no covariance. What fails any,
    and was put back in by artifact reduction, is ``pasted`` first: neither the size nor the shape it shows is its own.
    """
    passes = True
    for name, test in TESTS.items():
        if name in but or (name == "certainty" and not passes):
            continue
        reason = test(evidence)
        if reason is None:
            continue
        pasted = _pasted(evidence) if passes else None
        if pasted is not None:
            yield "pasted", pasted
        passes = False
        yield name, reason
