"""What a head does to the image of a ball that stands beside it, made good: hardened rays, and cells that add up.

Rays that pass the head are hardened by it, and lose less to the ball then: the more the head takes of them, up to a
share at which nothing is left to harden. So the ball's shadow is fainter in some directions than in others, which makes
dark sides towards the head and away from it and bright ones across (J. Barrett and N. Keat, RadioGraphics 24:1679,
2004). To a whole ball that is the same on either side; where a post hides one of them, it displaces the center of a
dense ball by up to 30 um towards the head. By how much the ball is fainter is told by its own image. Scatter behind a
head, of which flat panels receive much, fades a ball there likewise, and is told with it (`scanner.scattered`).

A detector's cell adds up what it receives before the logarithm is taken: that displaces each shadow towards where all
else takes more, by its slope over the cell times the variance of what is added up. Within the slices no image tells
that, but scanners hardly differ in it. Across them a cell is as high as its row, which may be the whole slice: where
the scan's balls tell that it is, this was made good before (`scanner.summed`), else for a usual row.
"""

from __future__ import annotations

import math
from dataclasses import replace
from enum import Enum

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from kernelcache import njit
from ronnaplan.ct.volume import CTVolume
from ronnaplan.geometry import FloatArray
from ronnaplan.localization.fit.ball_fit import BallFit, covariance_by
from ronnaplan.localization.fit.neighbourhood import first_of_each
from ronnaplan.localization.fit.parameters import BACKGROUND, BLUR, CENTER, RADIUS, WIDTH, U, V, W
from ronnaplan.localization.fit.refine import refit
from ronnaplan.localization.fit.residuals import ALIKE_VOXELS
from ronnaplan.localization.scanner.beside import VIEWS, Beside, all_beside
from ronnaplan.localization.scanner.summed import (
    WATER_PER_MM,
    chord_losses,
    kernel_passed,
    lost_to_summing_hu,
    profile_seen,
)

HARDENED_PER_HU = 4e-5
"""Standard deviation of the share by which a ball is fainter in hardened rays, for each HU of its contrast: 0.01 of
plastic, 0.1 of silicon nitride and alumina and 0.13 of glass were seen, with 1,300, 3,500, 4,100 and 3,100 HU."""

SCATTERED = 0.25
"""The same of what scatter fades, whatever the ball is made of, where voxels are those of a flat panel, which has no
septa: as much scatter as primary rays behind a head hides half of a ball's shadow there."""

MOST_OFF = 0.02
"""So much scatter is believed only where it makes a ball as large as stated, to this share: an oval passes for a
smaller ball that scatter fades. Eggs longer by up to 0.3 came out 0.03 to 0.06 too small, balls 0.015; those of them
that metal bends, too, and that lie 0.2 mm off, 0.03 and 0.04."""

APERTURE_MM2 = 0.035
"""Variance, at the center of rotation, of the rays that one cell adds up, within the slices: cells of 0.5 to 0.65 mm
and focal spots of 0.5 to 1 mm, which are half as wide there, make 0.025 to 0.05."""

ROW_MM2 = 0.05
"""The same across the slices, or the profile's variance, where that is less: rows of 0.5 to 1.25 mm, which are as high
there, make 0.02 to 0.13."""

ROUNDS, CLOSE = 4, 0.01
"""So many times at most what the head does is made good and the ball fitted anew: until the share changes by less than
this, which displaces no center by more than 2 um."""

LEAST_LOSS = 1.0
"""Where no ray through the ball loses more than this to all else, some 50 mm of water, there is no head beside it."""

VIEWS_AT_ONCE = 15
"""What is made good is summed up over so many directions at a time, whose shadows are held together."""

FREQUENCIES = 160
"""So many tell what the kernel passes."""


class MadeGood(Enum):
    """What is made good of what a head does to the image of a ball: all, all but what rows add up, or nothing."""

    ALL = "all"
    BUT_ROWS = "all but rows"
    NOTHING = "nothing"


def without_the_head(volume: CTVolume, fit: BallFit, wanted: MadeGood) -> BallFit:
    """Return the fit of a ball with what a head does to its image made good, as far as ``wanted``.

    As it is, where that is not known: of balls whose contrast the scale's end hides, and of metal or wrapped ones, as
    other things bend their image, too. What is clipped has been looked for as if it were metal. The contrast does not
    slope then (`fit.shading`), for why it does is given back.
    """
    if wanted is MadeGood.NOTHING or fit.may_be_metal or fit.prior.layer_mm > 0.0:
        return fit
    beside = all_beside(volume, fit)
    if beside.losses.max() < LEAST_LOSS:
        return fit
    rows_hu = (
        lost_to_rows_hu(volume, fit) if wanted is MadeGood.ALL else np.zeros(len(fit.neighbourhood.values_hu))
    )
    hardened = _made_good(fit, beside, rows_hu, 0.0)
    if not volume.grid.may_be_a_panels:
        return hardened
    faded = _made_good(fit, beside, rows_hu, SCATTERED)
    return faded if is_as_large(faded) and faded.misfit < hardened.misfit else hardened


def is_as_large(fit: BallFit) -> bool:
    """Whether a ball is as large as stated, to `MOST_OFF`."""
    radius_mm = float(fit.prior.mean[RADIUS])
    return abs(float(fit.theta[RADIUS]) - radius_mm) <= MOST_OFF * radius_mm


def _made_good(fit: BallFit, beside: Beside, rows_hu: FloatArray, scattered: float) -> BallFit:
    """Return the fit of a ball with what it has lost given back, ``rows_hu`` (N,) of it to rows."""
    seen, before_mm, share = fit.neighbourhood, fit.center_mm, 0.0
    for _ in range(ROUNDS):
        before = share
        whole_hu, share = _lost_hu(beside, fit, rows_hu, before, scattered)
        again = refit(fit, seen.given_back(whole_hu))
        if not again.converged:
            break
        fit = replace(again, made_good_mm=again.center_mm - before_mm)
        if abs(share - before) < CLOSE:
            break
    return fit


def _lost_hu(
    beside: Beside, fit: BallFit, rows_hu: FloatArray, before: float, scattered: float
) -> tuple[FloatArray, float]:
    """Return what the voxels (N,) of a fit have lost, ``rows_hu`` (N,) of it to rows, and the share of `_share`."""
    hardened_hu, pulled_hu = pictures_hu(beside, fit, by_scatter=scattered > 0.0)
    spread = math.hypot(HARDENED_PER_HU * fit.contrast_hu, scattered)
    share = _share(fit, hardened_hu, before, spread)
    return rows_hu - share * hardened_hu - APERTURE_MM2 * pulled_hu, share


def lost_to_rows_hu(volume: CTVolume, fit: BallFit) -> FloatArray:
    """HU (N,) by which the voxels of a ball's fit are darker as each row of the detector adds up over its height."""
    share = min(ROW_MM2 / (float(fit.theta[WIDTH]) ** 2 / 12.0), 1.0)
    return share * lost_to_summing_hu(volume, fit)


def _share(fit: BallFit, hardened_hu: FloatArray, before: float, spread: float) -> float:
    """Return by which share the ball is brighter in hardened rays, below zero, where ``before`` is made good.

    It is a random effect: it is believed as far as it stands out from the residuals.
    """
    used = np.flatnonzero(fit.used)
    jacobian, rest_hu = fit.jacobian.take(used, axis=0), fit.unshaded_hu.take(used)
    free, variance = free_share(fit, jacobian, rest_hu, hardened_hu.take(used))
    variance *= ALIKE_VOXELS * float(np.mean(rest_hu**2))
    believed = 1.0 / (1.0 + variance / spread**2)
    return believed * (before + free)


def free_share(
    fit: BallFit, jacobian: FloatArray, rest_hu: FloatArray, faded_hu: FloatArray
) -> tuple[float, float]:
    """Return how much of ``faded_hu`` (V,) is in what a fit leaves of some voxels, and its variance for noise of 1 HU.

    All that is fitted, (V, P) of ``jacobian``, is free to change with it, but for the prior.
    """
    is_measured = jacobian[:, BACKGROUND] != 0.0  # where the scale has ended nothing is
    informed = np.column_stack([jacobian, faded_hu * is_measured])
    covariance = covariance_by(informed, fit.prior)
    return float((covariance @ (informed.T @ rest_hu))[-1]), float(covariance[-1, -1])


def pictures_hu(beside: Beside, fit: BallFit, *, by_scatter: bool = False) -> tuple[FloatArray, FloatArray]:
    """Return what the two effects do to the voxels (N,) of a fit.

    The first is that of hardened rays, or ``by_scatter``, in HU for a share of 1, the second that of cells that add up
    rays, in HU for each mm^2 of the variance of these.
    """
    theta, around = fit.theta, fit.neighbourhood
    offsets_mm = around.offsets_mm - theta[CENTER]
    step_mm = max(0.5 * float(theta[BLUR]), float(theta[RADIUS]) / 64.0)
    farthest_mm = float(np.hypot(offsets_mm[:, U], offsets_mm[:, V]).max()) + step_mm
    across_mm = np.arange(-theta[RADIUS] - step_mm, theta[RADIUS] + 2.0 * step_mm, step_mm)
    places_mm = np.arange(-farthest_mm, farthest_mm + 2.0 * step_mm, step_mm)
    faded, slopes = _effects(beside, across_mm, step_mm, by_scatter=by_scatter)

    first = first_of_each(around.slices)
    heights_mm = offsets_mm[first, W]
    chords = _chords(theta, fit.prior.layer_mm, heights_mm, across_mm)[:, np.newaxis]
    rises, kernel = -_slopes(chords, step_mm), _kernel(theta, places_mm, across_mm).T
    numbers = np.searchsorted(around.slices[first], around.slices)
    pictures = np.zeros((2, len(offsets_mm)))
    for begin in range(0, VIEWS, VIEWS_AT_ONCE):
        some = slice(begin, begin + VIEWS_AT_ONCE)
        of_faded, of_slopes = (
            _between(one[:, some], beside.heights_mm, heights_mm, axis=0) for one in (faded, slopes)
        )
        filtered = np.stack([chords * of_faded, rises * of_slopes]) @ kernel
        _back_project(offsets_mm, numbers, filtered, places_mm, begin, pictures)
    pictures *= 1000.0 / WATER_PER_MM * math.pi / VIEWS
    return pictures[0], pictures[1]


def _effects(
    beside: Beside, across_mm: FloatArray, step_mm: float, *, by_scatter: bool
) -> tuple[FloatArray, FloatArray]:
    """How far rays (K, `VIEWS`, S) are faded, as a share of the most, and the slopes of what they lose, 1/mm.

    Scatter is spread evenly, so primary rays fade beside it the more the less of them is left, without an end.
    """
    lost = _between(beside.losses, beside.places_mm, across_mm, axis=2)
    if by_scatter:  # as much as primary rays where most is lost
        most = float(beside.losses.max())
        faded = 2.0 / (1.0 + np.exp(most - lost)) - 2.0 / (1.0 + np.exp(most))
    else:
        faded = 1.0 - np.exp(-lost)
    return faded, _slopes(lost, step_mm)


def _between(values: FloatArray, known: FloatArray, wanted: FloatArray, axis: int) -> FloatArray:
    """Return ``values``, which are ``known`` at places along an axis, at the ``wanted`` ones, straight in between."""
    at = np.interp(wanted, known, np.arange(len(known)))
    below = at.astype(np.intp)
    first, second = values.take(below, axis), values.take(np.minimum(below + 1, len(known) - 1), axis)
    told: FloatArray = first + (at - below).reshape(-1, *[1] * (values.ndim - 1 - axis)) * (second - first)
    return told


def _chords(theta: FloatArray, layer_mm: float, heights_mm: FloatArray, across_mm: FloatArray) -> FloatArray:
    """What rays across slices at these heights (K,) from the ball's center lose to it, (K, S)."""
    within_mm, weights = profile_seen(theta)
    above_mm = heights_mm[:, np.newaxis, np.newaxis] + within_mm
    losses: FloatArray = chord_losses(theta, layer_mm, across_mm[:, np.newaxis], above_mm) @ weights
    return losses


def _kernel(theta: FloatArray, places_mm: FloatArray, across_mm: FloatArray) -> FloatArray:
    """What filtered back-projection makes (T, S) of rays at ``across_mm`` (S,) in places (T,), 1/mm.

    Both are evenly spaced alike; the blur and the edge are those that were fitted.
    """
    frequencies, passed = kernel_passed(theta, FREQUENCIES)
    step_per_mm, step_mm, count = 2.0 * frequencies[0], across_mm[1] - across_mm[0], len(across_mm)
    apart_mm = places_mm[0] - across_mm[-1] + step_mm * np.arange(len(places_mm) + count - 1)
    told = np.cos(2.0 * np.pi * np.outer(apart_mm, frequencies)) @ (frequencies * passed) * 2.0 * step_per_mm
    response: FloatArray = sliding_window_view(told, count)[:, ::-1] * step_mm
    return response


def _slopes(values: FloatArray, step_mm: float) -> FloatArray:
    """How ``values`` (..., S), at places ``step_mm`` apart, rise from each to the next (..., S), 1/mm."""
    slopes: FloatArray = np.gradient(values, step_mm, axis=-1)
    return slopes


@njit(cache=True, nogil=True, fastmath={"contract", "reassoc", "arcp", "nsz"})
def _back_project(
    offsets: FloatArray,
    numbers: NDArray[np.intp],
    filtered: FloatArray,
    places: FloatArray,
    first: int,
    pictures: FloatArray,
) -> None:
    """Add to ``pictures`` (2, N), at ``offsets`` (N, 3), views ``filtered`` (2, K, V, T), known at ``places`` (T,).

    They are those from the ``first`` on; each of the offsets lies in the slice of its number (N,).
    """
    per_step, views = 1.0 / (places[1] - places[0]), filtered.shape[2]
    across_u, across_v = np.empty(views), np.empty(views)
    for view in range(views):
        angle = (first + view + 0.5) * math.pi / VIEWS
        across_u[view], across_v[view] = math.cos(angle) * per_step, math.sin(angle) * per_step
    begin = places[0] * per_step
    for n in range(len(offsets)):
        u, v, first_of, second_of = offsets[n, U], offsets[n, V], filtered[0, numbers[n]], filtered[1, numbers[n]]
        one, other = pictures[0, n], pictures[1, n]
        for view in range(views):
            at = u * across_u[view] + v * across_v[view] - begin
            low = int(at)
            share = at - low
            one += (1.0 - share) * first_of[view, low] + share * first_of[view, low + 1]
            other += (1.0 - share) * second_of[view, low] + share * second_of[view, low + 1]
        pictures[0, n], pictures[1, n] = one, other
