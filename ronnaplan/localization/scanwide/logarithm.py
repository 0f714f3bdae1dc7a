"""Was the logarithm taken before a slice's rays were summed, or after? The poles of its balls tell.

What summing first would take of a ball (`scanner.summed`) is compared with what its fit leaves over,
both without what a ball of other parameters would show as well. How far they go along says how much of it is in the
scan: none or all, but for what several rows to a slice leave, and for kernels and things beside a ball that bend its
poles.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ronnaplan.geometry import robust_spread
from ronnaplan.localization.build import SOLID, Build
from ronnaplan.localization.examine import LEAST_TOGETHER, Examined, distinct, fit_place
from ronnaplan.localization.fit.parameters import WIDTH
from ronnaplan.localization.fit.residuals import ALIKE_VOXELS, residuals_and_jacobian
from ronnaplan.localization.scanner.hardened import MadeGood
from ronnaplan.localization.scanner.scan import Scan
from ronnaplan.localization.scanner.summed import Summed, lost_to_summing_hu
from ronnaplan.threads import in_threads, single_threaded_algebra

THICK_MM = 1.2
"""Thinner slices hold too little of a head for its slope to displace a ball by more than 2 um, 6 on its top."""

ASKED = 12
"""So many balls are asked, those that fit best: they tell the share to 0.1."""

SUMMED_SHARE = 0.4
"""A larger share of it is taken for all, a smaller one for none. Scans with the logarithm first showed up to 0.2, the
others 0.6 to 1.7: the balls of these scatter more than twice as far, so that the line lies nearer to none."""

CLEAR = 1.5
"""A share says something where it is off `SUMMED_SHARE` by so many of its standard errors. Drawn from 112 scans, 3 to
12 balls then tell it wrongly in at most 1 of 100 draws."""

SCATTER = 0.3
"""Single balls scatter by so much about the scan's share where their noise does not count: what touches them bends
their outline, too. A few that scatter by less than half of it and their noise do so by chance."""

KNOWN_TO = 0.2
"""What summing does is known to this share of it: beams harden, rows differ, heads are not sloping planes, and one scan
in some thirty is told wrongly."""

MEDIAN_LOSS = math.sqrt(math.pi / 2.0)
"""The standard error of a median, over that of a mean."""

Told = tuple[float, float]
"""What one ball says of the share: its numerator, and its denominator (the noise's variance is the unit of both)."""


def as_summed(scan: Scan, examined: Sequence[Examined], build: Build) -> Scan:
    """Return the scan with what its balls, among what was ``examined``, tell of how its rays were summed."""
    summed = summed_seen([(scan, examined)], build)
    return scan if summed is None else Scan(scan.volume, whole=scan, summed=summed)


def summed_seen(parts: Sequence[tuple[Scan, Sequence[Examined]]], build: Build) -> Summed | None:
    """Return what the balls of a scan tell of how its rays were summed, each among what was examined in its part."""
    balls = [(scan, one) for scan, examined in parts for one in _asked(examined, build)]
    with single_threaded_algebra():
        return summed_told(list(in_threads(lambda ball: told_by(*ball), balls)))


def _asked(examined: Sequence[Examined], build: Build) -> list[Examined]:
    """Return the markers that can tell of summing: solid, not clipped and in thick slices."""
    if build != SOLID:
        return []
    balls = distinct(one for one in examined if one.is_marker and not one.is_clipped)
    return [one for one in balls if one.parameters[WIDTH] >= THICK_MM][:ASKED]


def told_by(scan: Scan, one: Examined) -> Told | None:
    """Ask a ball how much of what summing first would take of it is in the residuals of its fit."""
    fit = fit_place(scan, one.center_mm, one.stated_mm, made_good=MadeGood.BUT_ROWS)
    if not fit.converged or fit.is_clipped:
        return None
    residuals_hu, jacobian = residuals_and_jacobian(fit.neighbourhood, fit.theta, fit.prior.layer_mm)
    seen = np.column_stack([lost_to_summing_hu(scan.volume, fit), residuals_hu])[fit.used]
    by_other_balls = jacobian[fit.used]
    # The model is all but linear in so little; a second fit would leave other directions out, which changes more.
    lost, rest = (seen - by_other_balls @ np.linalg.lstsq(by_other_balls, seen)[0]).T
    part, whole = -float(lost @ rest), float(lost @ lost)
    if whole == 0.0:  # nothing beside the ball takes anything of its rays
        return None
    noise = rest + part / whole * lost
    noise_hu2 = float(noise @ noise) / len(noise)
    if noise_hu2 == 0.0:  # nothing tells how sure it is
        return None
    return part / noise_hu2, whole / noise_hu2


def summed_told(told: Sequence[Told | None]) -> Summed | None:
    """Return what the balls together say, by their weighted median; None where that is too little."""
    each = np.array([one for one in told if one is not None]).reshape(-1, 2)
    if len(each) < LEAST_TOGETHER:
        return None
    parts, wholes = each[np.argsort(each[:, 0] / each[:, 1])].T
    shares, noises = parts / wholes, ALIKE_VOXELS / wholes
    weights = 1.0 / (SCATTER**2 + noises)
    share = float(shares[np.searchsorted(np.cumsum(weights), weights.sum() / 2.0)])
    scattered = robust_spread((shares - share) * np.sqrt(weights)) / math.sqrt(weights.sum())
    by_chance = float(np.sum(1.0 / ((SCATTER / 2.0) ** 2 + noises))) ** -0.5
    error = MEDIAN_LOSS * max(scattered, by_chance)
    if abs(share - SUMMED_SHARE) <= CLEAR * error:
        return None
    return Summed(share > SUMMED_SHARE, KNOWN_TO)
