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
from ronnaplan.localization.build import Build, is_off_size
from ronnaplan.localization.fit.ball_fit import BallFit, fit_at
from ronnaplan.localization.fit.depth import edge_depth, margin_mm, within_reach
from ronnaplan.localization.fit.descent import (
    BEGIN,
    FIRST_DAMPING,
    MAX_WANDER,
    REST,
    Prior,
    descend,
    go_on,
    is_no_marker,
)
from ronnaplan.localization.fit.directions import Judged, Verdict, judge_directions
from ronnaplan.localization.fit.embedded import within_its_holder
from ronnaplan.localization.fit.model import has_layer, shown_hu
from ronnaplan.localization.fit.neighbourhood import Neighbourhood
from ronnaplan.localization.fit.parameters import BLUR, CENTER, CONTRAST, EDGE, RADIUS, WIDTH
from ronnaplan.localization.fit.residuals import cavity_moved_hu, residuals_and_jacobian
from ronnaplan.localization.fit.skin import is_mount, is_skin, lies_on_something, with_skin
from ronnaplan.localization.fit.starts import (
    HOPELESS_MISFIT,
    HOPELESS_ROUND,
    Candidate,
    Look,
    candidate_of,
    is_astray,
)
from ronnaplan.localization.fit.uneven import uneven_hu

HOPELESS_SOON = 0.35
"""A fit is not pursued that, after the first steps of its first descent, is not at rest and round in less than this
share: of 1,600 fits of markers, in 60 scans of all kinds, none was in less than 0.49, of all 2,000 that came to rest
none in 0.42."""

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

FILLING_ROUNDS = 3
"""A ball is fitted anew so many times at most, until its filling is even beside what its own image tells."""

BESIDE_MM = 1.0
"""What lies farther out than a ball's blur is seen, by more than this, is no part of its fit."""

LEAST_VOXELS = 3
"""Voxels a parameter, with fewer of which nothing is fitted."""

MAX_ROUNDS = 8
"""Rounds of leaving directions out and fitting again; real markers settle in two to four."""


def fit_ball(around: Neighbourhood, diameter_mm: float, build: Build, thickness_mm: float) -> BallFit:
    """Fit a ball of about ``diameter_mm`` to the voxels ``around`` a candidate, in slices nominally so thick."""
    around = within_its_holder(around, diameter_mm, build.layer_mm)
    candidate = candidate_of(around, diameter_mm, build, thickness_mm)
    look = candidate.first_look()
    fit = _fitted(candidate, look)
    if fit.converged or not is_astray(look):
        return fit
    steady = candidate.steady_look()
    if steady is None:
        return fit
    # Domes of pegs are fitted so, too, most as larger balls.
    again = _fitted(candidate, steady)
    return again if again.converged and not is_off_size(again.diameter_mm - diameter_mm) else fit


def evenly_filled(fit: BallFit) -> BallFit:
    """Fit a ball anew as if its filling were even, where its inside shows that it is not.

    In a flat panel's pictures scatter shades balls likewise.
    """
    before_mm = fit.center_mm
    for _ in range(FILLING_ROUNDS):
        differ_hu = uneven_hu(fit)
        if differ_hu is None:
            break
        again = _settle(fit.neighbourhood.given_back(-differ_hu), fit.theta, fit.prior)
        if not again.converged or again.misfit >= fit.misfit:
            break
        even = replace(again.neighbourhood, evened_mm=again.center_mm - before_mm)
        fit = replace(again, neighbourhood=even)
    return fit


def _fitted(candidate: Candidate, look: Look) -> BallFit:
    """Fit a ball to a candidate's voxels from a ``look`` that held its shape."""
    around, prior = candidate.around, candidate.prior
    theta, (verdict, used) = candidate.free_look(look)
    if _is_hopeless(theta, verdict, prior):
        return fit_at(around, theta, prior, verdict, candidate.few, converged=False)
    near = _near(around, theta)
    plain = _settle(around.select(near), theta, prior, (verdict, used[near]))
    plain = _of_either_kernel(plain, around)
    if plain.verdict.round_share < HOPELESS_ROUND or not lies_on_something(theta, verdict):
        return _about_its_own_center(plain)
    around = around.select(near)
    on_skin = _settle_on_skin(around, *with_skin(theta, prior, verdict, around))
    if not (is_skin(on_skin.theta) and _tells_more(on_skin, plain)):
        return _about_its_own_center(plain)
    if has_layer(theta):
        return _about_its_own_center(on_skin)
    # Only now, for a post would be taken for skin that is bent enough.
    bent = _settle(around, on_skin.theta, on_skin.prior, (on_skin.verdict, on_skin.used))
    return bent if bent.converged else on_skin


def refit(fit: BallFit, around: Neighbourhood) -> BallFit:
    """Fit a ball anew, from where ``fit`` came to rest, to voxels to which is given back why its contrast sloped."""
    return _settle(around, fit.theta, fit.prior, (fit.verdict, fit.used), slopes=False)


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
        again = _settle(seen.given_back(-moved_hu), fit.theta, fit.prior)
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
    other = _settle(around.select(_near(around, theta)), theta, fit.prior)
    return other if other.converged and _is_nearer(other, fit, around) else fit


def _is_nearer(one: BallFit, other: BallFit, around: Neighbourhood) -> bool:
    """Whether ``one`` leaves less over than the ``other`` where either sees the ball's edge.

    By its own directions alone, a fit that does without those it cannot explain would seem the better.
    """
    thetas, layer_mm = (one.theta, other.theta), one.prior.layer_mm
    told = np.any([judge_directions(around, theta, layer_mm)[1] for theta in thetas], axis=0)
    seen = around.select(told)
    left = [residuals_and_jacobian(seen, theta, layer_mm)[0] for theta in thetas]
    return bool(left[0] @ left[0] < left[1] @ left[1])


def _near(around: Neighbourhood, theta: FloatArray) -> NDArray[np.bool_]:
    """Which voxels (N,) are of a ball's edge, or beside it."""
    is_near: NDArray[np.bool_] = (
        np.abs(edge_depth(around.offsets_mm, theta)[0]) < margin_mm(theta[WIDTH], theta[BLUR]) + BESIDE_MM
    )
    return is_near


def _tells_more(on_skin: BallFit, plain: BallFit) -> bool:
    """Whether the skin explains directions that ``plain`` leaves out, about as well as that explains the others.

    It must explain them better where a mount would: plastic pegs under clipped metal, 0.8 as wide, were fitted as skin,
    and drew the ball by 35 um.
    """
    if not on_skin.converged or not plain.converged:
        return on_skin.converged
    seen_hu = shown_hu(on_skin.theta, on_skin.ceiling_hu)
    misfit_allowed = 1.0 if is_mount(on_skin.verdict, plain.verdict, seen_hu) else SKIN_MISFIT
    return on_skin.coverage > plain.coverage and on_skin.misfit <= misfit_allowed * plain.misfit


def _settle(
    around: Neighbourhood,
    theta: FloatArray,
    prior: Prior,
    judged: Judged | None = None,
    *,
    slopes: bool = True,
    bends: bool = True,
) -> BallFit:
    """Leave out the directions that disagree and fit again, until the choice is stable.

    The first choice is ``judged``, or that of ``theta``.
    """
    verdict, used = judged or judge_directions(around, theta, prior.layer_mm)
    previous = np.empty(0, dtype=np.int8)
    converged = True
    for number in range(MAX_ROUNDS):
        if number > 0:
            verdict, used = judge_directions(around, theta, prior.layer_mm)
        is_no_ball = number > 0 and verdict.round_share < HOPELESS_ROUND
        if is_no_ball or _is_hopeless(theta, verdict, prior) or used.sum() < LEAST_VOXELS * len(theta):
            converged = False
        if not converged or np.array_equal(verdict.state, previous):
            break
        previous = verdict.state
        some = around.select(used)
        if number > 0:
            theta, converged = descend(some, theta, prior)
        else:
            theta, converged = _first_descent(around, some, theta, prior)
    return fit_at(around, theta, prior, verdict, used, converged=converged, slopes=slopes, bends=bends)


def _first_descent(
    around: Neighbourhood, some: Neighbourhood, theta: FloatArray, prior: Prior
) -> tuple[FloatArray, bool]:
    """Descend by ``some`` of the voxels ``around``, no farther than the beginning where that shows no ball."""
    soon, is_at_rest, damping = go_on(some, theta, FIRST_DAMPING, prior, BEGIN)
    if is_at_rest or judge_directions(around, soon, prior.layer_mm)[0].round_share < HOPELESS_SOON:
        return soon, is_at_rest
    return go_on(some, soon, damping, prior, REST)[:2]


def _settle_on_skin(around: Neighbourhood, theta: FloatArray, prior: Prior) -> BallFit:
    """Settle on a guessed skin, whose level and place are fitted before directions are judged by them."""
    near = around.select(within_reach(*edge_depth(around.offsets_mm, theta)))
    theta, _ = descend(near, theta, prior)
    return _settle(around, theta, prior, bends=False)


def _is_hopeless(theta: FloatArray, verdict: Verdict, prior: Prior) -> bool:
    wandered = float(np.linalg.norm(theta[CENTER])) > MAX_WANDER * prior.mean[RADIUS]
    ragged = bool(verdict.usual_rms_hu > HOPELESS_MISFIT * theta[CONTRAST])
    return wandered or ragged or is_no_marker(theta, prior.mean)
