"""Was the logarithm taken before a slice's rays were summed, or after? The poles of its balls tell.

Every ball is fitted as it is and once more with what summing first would take of it made good
(`ronnaplan.localization.summed`). How far the residuals go along with that change says how much of it is in the scan:
none or all, but for what several rows to a slice leave, and for kernels and things beside a ball that bend its poles.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ronnaplan.localization.build import SOLID, Build
from ronnaplan.localization.descent import residuals_and_jacobian
from ronnaplan.localization.examine import Examined, Scan, distinct, fit_place, with_what_is_lost
from ronnaplan.localization.motion import LEAST_TOGETHER
from ronnaplan.localization.parameters import WIDTH
from ronnaplan.localization.parts import single_threaded_algebra
from ronnaplan.localization.summed import Summed
from ronnaplan.localization.uncertainty import robust_spread
from ronnaplan.threads import in_threads

THICK_MM = 1.5
"""Thinner slices hold too little of a head for its slope to displace a ball by more than 2 um."""

ASKED = 12
"""So many balls are asked, those that fit best: they tell the share to 0.1."""

SUMMED_SHARE = 0.5
"""A larger share of it is taken for all, a smaller one for none. Scans with the logarithm first showed up to 0.2, the
others 0.7 to 1.3."""

CLEAR = 2.0
"""A share says something where it is off `SUMMED_SHARE` by so many of its standard errors."""

SCATTER = 0.3
"""Single balls scatter by so much about the scan's share where their noise does not count: what touches them bends
their outline, too. A few that scatter by less than half of it do so by chance."""

MADE_GOOD = 0.3
"""What is made good is known to this share of it: beams harden, rows differ, and heads are not sloping planes."""

MEDIAN_LOSS = math.sqrt(math.pi / 2.0)
"""The standard error of a median, over that of a mean."""

Told = tuple[float, float]
"""What one ball says of the share: its numerator, and its denominator (the noise's variance is the unit of both)."""


def as_summed(scan: Scan, examined: Sequence[Examined], build: Build) -> Scan:
    """Return the scan with what its balls, among what was ``examined``, tell of how its rays were summed."""
    balls = asked(examined, build)
    with single_threaded_algebra():
        summed = summed_told(list(in_threads(lambda one: told_by(scan, one), balls)))
    return scan if summed is None else Scan(scan.volume, whole=scan, summed=summed)


def asked(examined: Sequence[Examined], build: Build) -> list[Examined]:
    """Return the markers that can tell of summing: solid, not clipped and in thick slices."""
    if build != SOLID:
        return []
    balls = distinct(one for one in examined if one.is_marker and not one.is_clipped)
    return [one for one in balls if one.parameters[WIDTH] >= THICK_MM][:ASKED]


def told_by(scan: Scan, one: Examined) -> Told | None:
    """Ask a ball how much of the change that making good brings to its residuals is in them."""
    plain = fit_place(scan, one.center_mm, one.stated_mm)
    if not plain.converged or plain.is_clipped:
        return None
    other, lost = with_what_is_lost(scan, plain, one.stated_mm)
    if not other.converged:
        return None
    around, used = plain.neighbourhood, plain.used
    brighter = replace(around, values_hu=around.values_hu + lost)
    before_hu, after_hu = (
        residuals_and_jacobian(voxels, fitted, plain.layer_mm, plain.ceiling_hu)[0][used]
        for voxels, fitted in ((around, plain.theta), (brighter, other.theta))
    )
    change_hu, noise_hu2 = after_hu - before_hu, float(after_hu @ after_hu) / len(after_hu)
    return -float(change_hu @ before_hu) / noise_hu2, float(change_hu @ change_hu) / noise_hu2


def summed_told(told: Sequence[Told | None]) -> Summed | None:
    """Return what the balls together say, by their weighted median; None where that is too little."""
    each = np.array([one for one in told if one is not None]).reshape(-1, 2)
    if len(each) < LEAST_TOGETHER:
        return None
    parts, wholes = each[np.argsort(each[:, 0] / each[:, 1])].T
    shares, weights = parts / wholes, 1.0 / (SCATTER**2 + 1.0 / wholes)
    share = float(shares[np.searchsorted(np.cumsum(weights), weights.sum() / 2.0)])
    error = MEDIAN_LOSS * max(robust_spread(shares), SCATTER / 2.0) / math.sqrt(len(shares))
    if abs(share - SUMMED_SHARE) <= CLEAR * error:
        return None
    is_first = share > SUMMED_SHARE
    return Summed(is_first, MADE_GOOD if is_first else math.hypot(share, error))
