"""How much a marker errs by what is usual in its scan: how outlines are bent, how panels lag, how diameters scatter."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ronnaplan.geometry import SD_PER_DEVIATION, FloatArray
from ronnaplan.localization.build import SIZE_TOLERANCE_MM
from ronnaplan.localization.judge.motion import LEAST_TOGETHER, Movement
from ronnaplan.localization.judge.uncertainty import LAG_MM, WEIGHTS, WITHIN, by_panel

MEDIAN_SHARE = 0.69
"""Median of a mean square of few normal values, as a share of its expectation (of two: ln 2)."""

NEAR = 5
"""So many markers of a cone beam, those nearest in height, tell what is usual at their height."""

UNUSUAL = 3.0
"""A diameter is unlike the others' where it is off their median by so many of their own standard deviations, or larger
than the smallest third by so many standard errors: it is told about as well as a center along one axis."""


def usual_odd_mm2(movements: Sequence[Movement], heights_mm: FloatArray | None = None) -> FloatArray | None:
    """What is usual in a scan of `Movement.odd_mm2`, (M, 3); None where there are fewer than `LEAST_TOGETHER` markers.

    Cone beams bend what stands higher or lower more: where ``heights_mm`` (M,) are given and those nearest show more,
    that is usual there.
    """
    if len(movements) < LEAST_TOGETHER:
        return None
    odd_mm2 = np.array([moved.odd_mm2 for moved in movements])
    usual_mm2 = np.tile(np.median(odd_mm2, axis=0) / MEDIAN_SHARE, (len(movements), 1))
    if heights_mm is None:
        return usual_mm2
    nearest = np.argsort(np.abs(heights_mm[:, np.newaxis] - heights_mm), axis=1)[:, :NEAR]
    most_mm2: FloatArray = np.maximum(usual_mm2, odd_mm2[nearest].mean(axis=1))
    return most_mm2


def with_usual(covariance_mm2: FloatArray, moved: Movement, usual_mm2: FloatArray, axes: FloatArray) -> FloatArray:
    """Return the covariance (3, 3) with the mean of its own odd bending and the usual (3,) in place of its own.

    Two to four amplitudes a marker tell little alone. ``axes`` (3, 3) are u, v, w in LPS.
    """
    change = WEIGHTS["odd"] * (usual_mm2 - moved.odd_mm2) / 2.0
    pooled: FloatArray = covariance_mm2 + axes.T @ np.diag(change) @ axes
    return pooled


def with_usual_lag(covariance_mm2: FloatArray, theta: FloatArray, usual: float, axes: FloatArray) -> FloatArray:
    """Return the covariance (3, 3) with what lag adds where the scan's markers are usually blurred by a panel.

    ``usual`` is the median of `by_panel`. Slices that are thin beside the blur tell little of their profile's shape.
    """
    more = max(usual - by_panel(theta), 0.0)
    added: FloatArray = covariance_mm2 + LAG_MM**2 * more * axes.T @ WITHIN @ axes
    return added


def beyond_usual_mm(excesses_mm: FloatArray, errors_mm: FloatArray) -> FloatArray:
    """By how much each diameter (M,) is off what the scan's markers have in common; 0 where that is no more than usual.

    A scanner's kernel makes all of them alike, to a few micrometres in thin slices, so this tells a film that is too
    thin to make a marker's diameter another than the stated one. What does make it so, is counted already. Films only
    add: what is larger than the smallest third by more than ``errors_mm`` (M,) tell, the errors of the centers along
    one axis, is not bare, however many there are of it. Where most are off the stated diameter, the others are not
    believed either.
    """
    plain = np.abs(excesses_mm) <= SIZE_TOLERANCE_MM
    if len(plain) >= LEAST_TOGETHER and 2 * np.count_nonzero(plain) <= len(plain):
        return np.where(plain, excesses_mm, 0.0)
    if np.count_nonzero(plain) < LEAST_TOGETHER:
        return np.zeros(len(plain))
    apart_mm = np.where(plain, excesses_mm - np.median(excesses_mm[plain]), 0.0)
    usual_mm = UNUSUAL * robust_spread(apart_mm[plain])
    apart_mm[np.abs(apart_mm) <= min(usual_mm, SIZE_TOLERANCE_MM)] = 0.0
    bare = max((int(plain.sum()) - 1) // 3, 1)  # not the very smallest, which noise may have made so
    larger_mm = np.where(plain, excesses_mm - np.sort(excesses_mm[plain])[bare], 0.0)
    larger_mm[larger_mm <= UNUSUAL * np.median(errors_mm[plain])] = 0.0
    return np.where(apart_mm == 0.0, larger_mm, apart_mm)


def robust_spread(values: FloatArray) -> float:
    """Standard deviation of ``values`` (N,) by their median absolute deviation: a minority does not disturb it."""
    return SD_PER_DEVIATION * float(np.median(np.abs(values - np.median(values))))
