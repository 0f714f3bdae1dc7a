"""From a candidate to the start of its fit: looks by few of its voxels, first with the shape held, then freed.

Most candidates are no balls, which few voxels and a few steps tell. What stands beside a ball may lead a look
astray: so several are taken, and the best is kept.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ronnaplan.geometry import FloatArray
from ronnaplan.localization.build import Build
from ronnaplan.localization.fit.descent import LOOK, Prior, descend, is_no_marker
from ronnaplan.localization.fit.directions import MAX_RAGGED, Judged, judge_directions
from ronnaplan.localization.fit.guess import ball_prior, first_guess, first_guesses, frozen, steady
from ronnaplan.localization.fit.neighbourhood import Neighbourhood
from ronnaplan.localization.fit.parameters import BACKGROUND, CONTRAST, EDGE, SLOPES

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
more than the first, a look may be taken that neither knows of slopes nor of what is beside, if more directions than the
second share agree with the first guess (of balls that were led astray 0.26 and more)."""

HOPELESS_MISFIT = 0.15
"""A fit whose median direction disagrees by more than this share of the contrast is not pursued."""

HOPELESS_ROUND = 0.45
"""Nor is a fit that, once its directions were chosen, is round in less than this share of them: markers are in 0.6 and
most in 0.8 of them, posts in 0.3 to 0.5."""

LOOKS_ROUND = 0.75
"""What is round in this share of its directions at a look needs no other one: most markers are in 0.8 to 1."""

Look = tuple[FloatArray, Judged]
"""Parameters (P,) of a ball, and how they were judged by all voxels around."""


@dataclass(frozen=True)
class Candidate:
    """What may be a ball: the voxels ``around`` it (N,), a ``start`` (P,) for its parameters, and their ``prior``.

    ``dimmed`` are the same voxels, none brighter than the ball may be, and ``few`` (N,) marks those that tell first.
    """

    around: Neighbourhood
    dimmed: Neighbourhood
    few: NDArray[np.bool_]
    start: FloatArray
    prior: Prior

    @cached_property
    def glimpse(self) -> Neighbourhood:
        """The few, none brighter than the ball may be."""
        return self.dimmed.select(self.few)

    def first_look(self) -> Look:
        """Let the center find its place with the shape held, from every guess."""
        looks = [self._held_look(guess) for guess in first_guesses(self.start, self.around.pixel_mm)]
        return min(looks, key=lambda look: look[1][0].usual_rms_hu)

    def steady_look(self) -> Look | None:
        """Look by the directions alone that agree with the first guess, before an even background; None if no ball."""
        start, prior = self.start, self.prior
        verdict, agreeing = judge_directions(self.around.select(self.few), start, prior.layer_mm)
        if (
            verdict.usual_rms_hu > HOPELESS_MISFIT * start[CONTRAST]
            or np.mean(verdict.state == 1) < LEAST_AGREEING
        ):
            return None
        theta, _ = descend(self.glimpse.select(agreeing), start, steady(prior, start), LOOK)
        told = judge_directions(self.around, theta, prior.layer_mm)
        return (theta, told) if told[0].round_share >= HOPELESS_ROUND else None

    def free_look(self, look: Look) -> Look:
        """Free the shape that a ``look`` held, if it may be a ball's; try before whether its kernel enhances edges."""
        theta, (verdict, _) = look
        candidate = self
        if verdict.usual_rms_hu > HOPELESS_MISFIT * theta[CONTRAST] and verdict.round_share >= ENHANCED_ROUND:
            enhanced = theta.copy()
            enhanced[EDGE] = ENHANCED_EDGE
            other = self._held_look(enhanced)
            if other[1][0].usual_rms_hu < verdict.usual_rms_hu:
                look = other
                candidate = replace(self, dimmed=_dimmed(self.around, self.start, OVERSHOOT))
        theta, (verdict, _) = look
        is_hopeless = verdict.usual_rms_hu > FIRST_LOOK_MISFIT * theta[CONTRAST]
        return look if is_hopeless else candidate._freed_look(look)

    def _held_look(self, theta: FloatArray) -> Look:
        theta, _ = descend(self.glimpse, theta, frozen(self.prior, theta), LOOK)
        return theta, judge_directions(self.around, theta, self.prior.layer_mm)

    def _freed_look(self, look: Look) -> Look:
        """Free the shape, which a ``look`` held; a wrong shape leaves out too many directions.

        So all voxels are looked at. Where that makes a look worse, or does not show a ball yet, what stands beside one
        may have led it astray, as skin does: then those of the directions that agreed are looked at alone, too. That is
        believed, if it is rounder or the other was worse, where most directions had agreed or it shows a ball on skin.
        """
        held, before = look

        def freed(voxels: Neighbourhood) -> Look:
            theta, _ = descend(voxels, held, self.prior, LOOK)
            is_given_up = is_no_marker(theta, self.prior.mean)  # then what was told last will do
            return theta, before if is_given_up else judge_directions(self.around, theta, self.prior.layer_mm)

        theta, told = freed(self.glimpse)
        misfit = before[0].usual_rms_hu / held[CONTRAST]
        is_better = told is not before and told[0].usual_rms_hu <= misfit * theta[CONTRAST]
        if misfit > HOPELESS_MISFIT or (is_better and told[0].round_share >= LOOKS_ROUND):
            return theta, told
        other, other_told = freed(self.dimmed.select(self.few & before[1]))
        is_ball = before[0].round_share >= HOPELESS_ROUND or other_told[0].ragged_share <= MAX_RAGGED
        is_rounder = not is_better or other_told[0].round_share > told[0].round_share
        return (other, other_told) if other_told is not before and is_ball and is_rounder else (theta, told)


def candidate_of(around: Neighbourhood, diameter_mm: float, build: Build, thickness_mm: float) -> Candidate:
    """Return what may be a ball of about ``diameter_mm`` in the voxels ``around``, as `refine.fit_ball` is told."""
    start = first_guess(around, diameter_mm, build, thickness_mm)
    prior = ball_prior(start, build, is_clipped=start[CONTRAST] + start[BACKGROUND] > around.ceiling_hu)
    few = _thinned(len(around.values_hu))
    # What is brighter than the ball (an insert, a screw) must not draw the first fit to itself.
    return Candidate(around, _dimmed(around, start, 1.0), few, start, prior)


def is_astray(look: Look) -> bool:
    """Whether what stands beside a ball may have led a ``look`` astray: its background slopes steeply."""
    theta = look[0]
    return bool(np.linalg.norm(theta[SLOPES]) > ASTRAY_SLOPE_PER_MM * theta[CONTRAST])


def _dimmed(around: Neighbourhood, start: FloatArray, contrasts: float) -> Neighbourhood:
    """Return the voxels with none brighter than so many ``contrasts`` of the ``start``."""
    brightest_hu = start[BACKGROUND] + contrasts * start[CONTRAST]
    return replace(around, values_hu=np.minimum(around.values_hu, brightest_hu))


def _thinned(count: int) -> NDArray[np.bool_]:
    """Mark about `FIRST_LOOK_VOXELS` of ``count`` voxels, spread evenly without a pattern (golden ratio)."""
    spread = np.arange(count) * 0.6180339887498949
    marked: NDArray[np.bool_] = spread - np.floor(spread) < FIRST_LOOK_VOXELS / max(count, 1)
    return marked
