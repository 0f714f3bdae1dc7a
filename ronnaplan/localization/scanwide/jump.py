"""Did the head jump between two slices? What markers show of it at one height, and those above and below do not.

Each marker that a jump passes through shows it at its own place, perhaps too little to be sure of by itself. Those that
lie beyond are whole and show nothing, but stand where the head was before the jump, or after it: none has its place in
one frame with all the others.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ronnaplan.geometry import FloatArray
from ronnaplan.localization.judge.motion import JUMPS, PATTERN_ERRORS_MM, Movement

REACH = 0.6
"""A marker tells a jump no farther from its middle than this share of its radius."""

LEAST_CROSSED, LEAST_SHOWN = 2, 1.5
"""So many markers show the jump to the same side, by so many standard errors each: one alone may touch something."""

AXES = 3
SHARES = np.array(JUMPS)


def jump_at_one_height(heights_mm: FloatArray, radii_mm: FloatArray, movements: Sequence[Movement]) -> float:
    """Return the largest jump, in standard errors, that markers at ``heights_mm`` (N,) along the normal show together.

    It is held against what the markers beyond show in the same places of theirs: slices with a lopsided profile look
    like a jump along their normal in every ball. 0 where no two markers share a height, or none is beyond.
    """
    count = len(JUMPS) * AXES
    shape = len(movements), len(JUMPS), AXES
    amplitudes = np.array([one.amplitudes_mm[:count] for one in movements]).reshape(shape)
    noise = np.array([one.errors_mm[:count] for one in movements]).reshape(shape)
    errors = np.hypot(noise, PATTERN_ERRORS_MM[:count].reshape(shape[1:]))
    shown = 0.0
    for jump_mm in (heights_mm[:, np.newaxis] + radii_mm[:, np.newaxis] * SHARES).ravel():
        shares = (jump_mm - heights_mm) / radii_mm
        crossed, beyond = np.abs(shares) <= REACH, np.abs(shares) > 1.0
        if np.count_nonzero(crossed) < LEAST_CROSSED:
            continue
        at = np.abs(shares[crossed, np.newaxis] - SHARES).argmin(axis=1)
        for axis in range(AXES):
            told = amplitudes[..., axis], errors[..., axis]
            there_mm, there_errors = _mean(*(one[beyond] for one in told))
            here_mm, here_errors = (np.take_along_axis(one[crossed], at[:, np.newaxis], 1)[:, 0] for one in told)
            shown = max(shown, _together(here_mm, here_errors, there_mm[at], there_errors[at]))
    return shown


def _mean(amplitudes_mm: FloatArray, errors_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return what markers (N, J) show in each place of theirs (J,), and its standard error; NaN where none tells."""
    known = np.isfinite(amplitudes_mm + errors_mm)
    weights = np.where(known, errors_mm, np.inf) ** -2.0
    total = weights.sum(axis=0)
    total = np.where(total > 0.0, total, np.nan)
    return np.sum(weights * np.nan_to_num(amplitudes_mm), axis=0) / total, total**-0.5


def _together(
    shown_mm: FloatArray, errors_mm: FloatArray, usual_mm: FloatArray, usual_errors_mm: FloatArray
) -> float:
    """Return in standard errors by how much more than is usual markers (N,) show on average, all to one side."""
    known = np.isfinite(shown_mm + errors_mm + usual_mm)
    if np.count_nonzero(known) < LEAST_CROSSED:
        return 0.0
    shown_mm, errors_mm, usual_mm = shown_mm[known], errors_mm[known], usual_mm[known]
    weights = errors_mm**-2.0
    jump_mm = float(np.average(shown_mm - usual_mm, weights=weights))
    side = math.copysign(1.0, jump_mm)
    least = np.minimum(side * shown_mm, side * (shown_mm - usual_mm)) / errors_mm
    if np.sort(least)[-LEAST_CROSSED] < LEAST_SHOWN:
        return 0.0
    return abs(jump_mm) / math.hypot(float(weights.sum()) ** -0.5, float(usual_errors_mm[known].max()))
