"""The fit of a blurred ball to the voxels about a candidate.

Least squares (Levenberg-Marquardt) over center, radius, blur, slice thickness, contrast, background and the
background's slope; where the ball lies on skin, that is fitted with it. Directions in which
anything else touches the marker are left out, and the fit is repeated until the choice is stable. Clipped voxels
inform only as far as the model stays below the top of the scale.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ronnaplan.geometry import FloatArray
from ronnaplan.localization.ball_fit import BallFit, fit_at
from ronnaplan.localization.build import Build
from ronnaplan.localization.descent import (
    BEGIN,
    FIRST_DAMPING,
    LOOK,
    MAX_WANDER,
    REST,
    Prior,
    cavity_moved_hu,
    descend,
    go_on,
    is_no_marker,
    residuals_and_jacobian,
)
from ronnaplan.localization.directions import MAX_RAGGED, Verdict, edge_depth, judge, within_reach
from ronnaplan.localization.guess import ball_prior, first_guess, first_guesses, frozen, margin_mm, steady
from ronnaplan.localization.neighbourhood import Neighbourhood
from ronnaplan.localization.parameters import BACKGROUND, BLUR, CENTER, CONTRAST, EDGE, RADIUS, SLOPES, WIDTH
from ronnaplan.localization.skin import is_skin, lies_on_something, with_skin

FIRST_LOOK_VOXELS = 1500
"""The first descents use about this many of the voxels: enough to see that most candidates are no balls."""

FIRST_LOOK_MISFIT = 0.35
"""With size and blur held at their first guesses, a good direction disagrees by no more than this share of the
contrast."""

ENHANCED_ROUND = 0.2
ENHANCED_EDGE = 2.5
OVERSHOOT = 1.4
"""A ball that does not look like one, but is round in this share of its directions, is looked at once more as if the
kernel enhanced its edges strongly, so that they reach up to this many contrasts."""

ASTRAY_SLOPE_PER_MM, LEAST_AGREEING = 0.03, 0.2
"""What stands on one side of a ball, skin or a cap's electrode, looks to all voxels like a background that slopes, and
leads a first look astray: by 0.05 to 0.1 of the contrast in each mm, streaks and cupping by 0.005. Where it slopes by
more than the first and no ball was fitted, a look is taken that neither knows of slopes nor of what is beside, if more
directions than the second share agree with the first guess (of balls that were led astray 0.26 and more)."""

HOPELESS_MISFIT = 0.15
"""A first fit whose median direction disagrees by more than this share of the contrast is not pursued."""

HOPELESS_ROUND = 0.45
"""Nor is a fit that, once its directions were chosen, is round in less than this share of them: markers are in 0.6 and
most in 0.8 of them, posts in 0.3 to 0.5."""

HOPELESS_SOON = 0.35
"""Nor one that, after the first steps of its first descent, is not at rest and round in less than this share: of 1,600
fits of markers, in 60 scans of all kinds, none was in less than 0.49, of all 2,000 that came to rest none in 0.42."""

LOOKS_ROUND = 0.75
"""What is round in this share of its directions at a look needs no other one: most markers are in 0.8 to 1."""

SKIN_MISFIT = 1.4
"""Where a post stands between ball and skin, a fit with skin alone misfits by two thirds more at the median than one
that leaves the skin out, and is drawn to it by 10 to 30 um, where the other is off by 2 to 5; without a post, by a
fifth."""

LONG_TAILS, OVERSHOOTING, SHARP_MM = -0.3, 0.8, 1.0
"""An edge that comes to rest below the first may be that of a kernel which overshoots. It is tried from the second,
too, if the blur is no larger than the third then: softer ones do not overshoot, and what is wrapped around a ball makes
long tails indeed."""

CAVITY_ROUNDS, CAVITY_CLOSE_MM = 3, 0.001
"""A hollow ball is fitted anew so many times at most, until its cavity is told to lie, so nearly, where it was put."""

MAX_ROUNDS = 8
"""Rounds of leaving directions out and fitting again; real markers settle in two to four."""

Judged = tuple[Verdict, NDArray[np.bool_]]
"""What the directions say, and which voxels (N,) of a neighbourhood are those of the directions that agree."""


def fit_ball(
    around: Neighbourhood, diameter_mm: float, build: Build, thickness_mm: float, ceiling_hu: float
) -> BallFit:
    """Fit a ball of about ``diameter_mm`` to the voxels ``around`` a candidate.

    ``thickness_mm`` is the nominal slice thickness, ``ceiling_hu`` the value at which the scan clips (infinite
    where it does not).
    """
    start = first_guess(around, diameter_mm, build, thickness_mm, ceiling_hu)
    prior = ball_prior(start, build, is_clipped=start[CONTRAST] + start[BACKGROUND] > ceiling_hu)
    # What is brighter than the ball (an insert, a screw) must not draw the first fit to itself.
    dimmed = replace(around, values_hu=np.minimum(around.values_hu, start[CONTRAST] + start[BACKGROUND]))
    few = _thinned(len(around.values_hu))
    looks = [
        _first_look(dimmed.select(few), around, guess, prior, ceiling_hu)
        for guess in first_guesses(start, around.pixel_mm)
    ]
    look = min(looks, key=lambda look: look[1][0].usual_rms_hu)
    fit = _from_look(dimmed, around, few, start, prior, ceiling_hu, look)
    if fit.converged or np.linalg.norm(look[0][SLOPES]) <= ASTRAY_SLOPE_PER_MM * look[0][CONTRAST]:
        return fit
    steady_look = _steady_look(dimmed, around, few, start, prior, ceiling_hu)
    if steady_look is None:
        return fit
    again = _from_look(dimmed, around, few, start, prior, ceiling_hu, steady_look)
    return again if again.converged else fit


def _from_look(
    dimmed: Neighbourhood,
    around: Neighbourhood,
    few: NDArray[np.bool_],
    start: FloatArray,
    prior: Prior,
    ceiling_hu: float,
    look: tuple[FloatArray, Judged],
) -> BallFit:
    """Fit a ball to the voxels ``around`` from a first ``look`` that held its shape."""
    theta, (verdict, used) = look
    is_poor = verdict.usual_rms_hu > HOPELESS_MISFIT * theta[CONTRAST]
    if is_poor and verdict.round_share >= ENHANCED_ROUND:
        enhanced = theta.copy()
        enhanced[EDGE] = ENHANCED_EDGE
        enhanced, (other, agreeing) = _first_look(dimmed.select(few), around, enhanced, prior, ceiling_hu)
        if other.usual_rms_hu < verdict.usual_rms_hu:
            theta, verdict, used = enhanced, other, agreeing
            dimmed = replace(
                around, values_hu=np.minimum(around.values_hu, start[BACKGROUND] + OVERSHOOT * start[CONTRAST])
            )
    if verdict.usual_rms_hu <= FIRST_LOOK_MISFIT * theta[CONTRAST]:
        theta, (verdict, used) = _free_look(dimmed, around, few, theta, prior, ceiling_hu, (verdict, used))
    if _is_hopeless(theta, verdict, prior):
        return fit_at(around, theta, prior, verdict, few, ceiling_hu, converged=False)
    near = _near(around, theta)
    plain = _settle(around.select(near), theta, prior, ceiling_hu, (verdict, used[near]))
    plain = _of_either_kernel(plain, around)
    if plain.verdict.round_share < HOPELESS_ROUND or not lies_on_something(theta, verdict):
        return _about_its_own_center(plain)
    around = around.select(near)
    on_skin = _settle_on_skin(around, *with_skin(theta, prior, verdict, around), ceiling_hu)
    return _about_its_own_center(on_skin if is_skin(on_skin.theta) and _tells_more(on_skin, plain) else plain)


def refit(fit: BallFit, around: Neighbourhood) -> BallFit:
    """Fit a ball anew, from where ``fit`` came to rest, to voxels to which is given back why its contrast sloped."""
    return _settle(around, fit.theta, fit.prior, fit.ceiling_hu, (fit.verdict, fit.used), slopes=False)


def _about_its_own_center(fit: BallFit) -> BallFit:
    """Fit a hollow ball anew, to what it would show if the cavity that its shading tells aside were about its center.

    The first order leaves a tenth of how far that draws the center, and goes without directions that are the ball's.
    """
    seen, aside_mm = fit.neighbourhood, np.zeros(3)
    for _ in range(CAVITY_ROUNDS):
        if float(np.linalg.norm(fit.aside_mm)) < CAVITY_CLOSE_MM:
            break
        aside_mm = aside_mm + fit.aside_mm
        moved_hu = cavity_moved_hu(seen, fit.theta, fit.prior.layer_mm, aside_mm)
        again = _settle(seen.given_back(-moved_hu, fit.ceiling_hu), fit.theta, fit.prior, fit.ceiling_hu)
        if not again.converged:
            break
        fit = again
    return fit


def _of_either_kernel(fit: BallFit, around: Neighbourhood) -> BallFit:
    """Return the better of a ``fit`` whose edges have long tails and of one from edges as steep that overshoot instead.

    Both are minima where the kernel is sharp, and in the wrong one the fit does without directions that are the ball's.
    """
    theta = fit.theta.copy()
    theta[EDGE] = OVERSHOOTING
    theta[BLUR] *= (1.0 + OVERSHOOTING) / (1.0 + fit.theta[EDGE])  # a straight edge's slope is (1 + edge) / blur
    if not fit.converged or fit.theta[EDGE] > LONG_TAILS or theta[BLUR] > SHARP_MM:
        return fit
    other = _settle(around.select(_near(around, theta)), theta, fit.prior, fit.ceiling_hu)
    return other if other.converged and _is_nearer(other, fit, around) else fit


def _is_nearer(one: BallFit, other: BallFit, around: Neighbourhood) -> bool:
    """Whether ``one`` leaves less over than the ``other`` where either sees the ball's edge.

    By its own directions alone, a fit that does without those it cannot explain would seem the better.
    """
    thetas, layer_mm, ceiling_hu = (one.theta, other.theta), one.prior.layer_mm, one.ceiling_hu
    told = np.any([_judged(around, theta, layer_mm, ceiling_hu)[1] for theta in thetas], axis=0)
    seen = around.select(told)
    left = [residuals_and_jacobian(seen, theta, layer_mm, ceiling_hu)[0] for theta in thetas]
    return bool(left[0] @ left[0] < left[1] @ left[1])


def _near(around: Neighbourhood, theta: FloatArray) -> NDArray[np.bool_]:
    """Which voxels (N,) are of a ball's edge, or beside it."""
    is_near: NDArray[np.bool_] = (
        np.abs(edge_depth(around.offsets_mm, theta)[0]) < margin_mm(theta[WIDTH], theta[BLUR]) + 1.0
    )
    return is_near


def _tells_more(on_skin: BallFit, plain: BallFit) -> bool:
    """Whether the skin explains directions that ``plain`` leaves out, about as well as that explains the others."""
    if not on_skin.converged or not plain.converged:
        return on_skin.converged
    return on_skin.coverage > plain.coverage and on_skin.misfit <= SKIN_MISFIT * plain.misfit


def _first_look(
    dimmed: Neighbourhood, around: Neighbourhood, theta: FloatArray, prior: Prior, ceiling_hu: float
) -> tuple[FloatArray, Judged]:
    """Let the center find its place with the shape held; ``dimmed`` are a few of ``around``, none brighter than it."""
    theta, _ = descend(dimmed, theta, frozen(prior, theta), ceiling_hu, LOOK)
    return theta, _judged(around, theta, prior.layer_mm, ceiling_hu)


def _steady_look(
    dimmed: Neighbourhood,
    around: Neighbourhood,
    few: NDArray[np.bool_],
    start: FloatArray,
    prior: Prior,
    ceiling_hu: float,
) -> tuple[FloatArray, Judged] | None:
    """Look first by the directions alone that agree with the guess ``start``, before an even background.

    Returns None where that shows no ball.
    """
    verdict, agreeing = _judged(around.select(few), start, prior.layer_mm, ceiling_hu)
    if verdict.usual_rms_hu > HOPELESS_MISFIT * start[CONTRAST] or np.mean(verdict.state == 1) < LEAST_AGREEING:
        return None
    theta, _ = descend(dimmed.select(few).select(agreeing), start, steady(prior, start), ceiling_hu, LOOK)
    verdict, agreeing = _judged(around, theta, prior.layer_mm, ceiling_hu)
    return (theta, (verdict, agreeing)) if verdict.round_share >= HOPELESS_ROUND else None


def _free_look(
    dimmed: Neighbourhood,
    around: Neighbourhood,
    few: NDArray[np.bool_],
    held: FloatArray,
    prior: Prior,
    ceiling_hu: float,
    judged: Judged,
) -> tuple[FloatArray, Judged]:
    """Free the shape, which was ``held`` when directions were ``judged``; a wrong shape leaves out too many of them.

    So all voxels are looked at. Where that makes a look worse, or does not show a ball yet, what stands beside one may
    have led it astray, as skin does: then those of the directions that agreed are looked at alone, too. That is
    believed, if it is rounder or the other was worse, where most directions had agreed or it shows a ball on skin.
    """

    def freed(voxels: NDArray[np.bool_]) -> tuple[FloatArray, Judged]:
        theta, _ = descend(dimmed.select(voxels), held, prior, ceiling_hu, LOOK)
        is_given_up = is_no_marker(theta, prior.mean)  # then what was told last will do
        return theta, judged if is_given_up else _judged(around, theta, prior.layer_mm, ceiling_hu)

    theta, told = freed(few)
    before = judged[0].usual_rms_hu / held[CONTRAST]
    is_better = told is not judged and told[0].usual_rms_hu <= before * theta[CONTRAST]
    if before > HOPELESS_MISFIT or (is_better and told[0].round_share >= LOOKS_ROUND):
        return theta, told
    other, other_told = freed(few & judged[1])
    is_ball = judged[0].round_share >= HOPELESS_ROUND or other_told[0].ragged_share <= MAX_RAGGED
    is_rounder = not is_better or other_told[0].round_share > told[0].round_share
    return (other, other_told) if other_told is not judged and is_ball and is_rounder else (theta, told)


def _settle(
    around: Neighbourhood,
    theta: FloatArray,
    prior: Prior,
    ceiling_hu: float,
    judged: Judged | None = None,
    *,
    slopes: bool = True,
) -> BallFit:
    """Leave out the directions that disagree and fit again, until the choice is stable.

    The first choice is ``judged``, or that of ``theta``.
    """
    verdict, used = judged or _judged(around, theta, prior.layer_mm, ceiling_hu)
    previous = np.empty(0, dtype=np.int8)
    converged = True
    for number in range(MAX_ROUNDS):
        if number > 0:
            verdict, used = _judged(around, theta, prior.layer_mm, ceiling_hu)
        is_no_ball = number > 0 and verdict.round_share < HOPELESS_ROUND
        if is_no_ball or _is_hopeless(theta, verdict, prior) or used.sum() < 3 * len(theta):
            converged = False
        if not converged or np.array_equal(verdict.state, previous):
            break
        previous = verdict.state
        some = around.select(used)
        if number > 0:
            theta, converged = descend(some, theta, prior, ceiling_hu)
        else:
            theta, converged = _first_descent(around, some, theta, prior, ceiling_hu)
    return fit_at(around, theta, prior, verdict, used, ceiling_hu, converged=converged, slopes=slopes)


def _first_descent(
    around: Neighbourhood, some: Neighbourhood, theta: FloatArray, prior: Prior, ceiling_hu: float
) -> tuple[FloatArray, bool]:
    """Descend by ``some`` of the voxels ``around``, no farther than the beginning where that shows no ball."""
    soon, is_at_rest, damping = go_on(some, theta, FIRST_DAMPING, prior, ceiling_hu, BEGIN)
    if is_at_rest or _judged(around, soon, prior.layer_mm, ceiling_hu)[0].round_share < HOPELESS_SOON:
        return soon, is_at_rest
    return go_on(some, soon, damping, prior, ceiling_hu, REST)[:2]


def _settle_on_skin(around: Neighbourhood, theta: FloatArray, prior: Prior, ceiling_hu: float) -> BallFit:
    """Settle on a guessed skin, whose level and place are fitted before directions are judged by them."""
    near = around.select(within_reach(*edge_depth(around.offsets_mm, theta)))
    theta, _ = descend(near, theta, prior, ceiling_hu)
    return _settle(around, theta, prior, ceiling_hu)


def _thinned(count: int) -> NDArray[np.bool_]:
    """Mark about `FIRST_LOOK_VOXELS` of ``count`` voxels, spread evenly without a pattern (golden ratio)."""
    spread = np.arange(count) * 0.6180339887498949
    marked: NDArray[np.bool_] = spread - np.floor(spread) < FIRST_LOOK_VOXELS / max(count, 1)
    return marked


def _is_hopeless(theta: FloatArray, verdict: Verdict, prior: Prior) -> bool:
    wandered = float(np.linalg.norm(theta[CENTER])) > MAX_WANDER * prior.mean[RADIUS]
    ragged = bool(verdict.usual_rms_hu > HOPELESS_MISFIT * theta[CONTRAST])
    return wandered or ragged or is_no_marker(theta, prior.mean)


def _judged(around: Neighbourhood, theta: FloatArray, layer_mm: float, ceiling_hu: float) -> Judged:
    """Judge every direction by the voxels within reach; returns which voxels (N,) those that agree are."""
    verdict, cells = judge(around, theta, layer_mm, ceiling_hu)
    return verdict, (cells >= 0) & (verdict.state[cells] == 1)
