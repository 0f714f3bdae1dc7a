"""The rim of a socket shines into directions beside those that are left out, and draws the center towards it.

A post that is thin beside its ball meets it steeply, and what is left out with it is all that it blurs into. A cup or a
stem nearly as wide as the ball leaves it at a grazing angle. Beside the last direction that is seen to be touched, the
ball's edge is blurred together with the rim's. That looks like a larger ball that lies farther in, by up to 50 um. So
the ball is fitted by the directions that are clear of the touched ones, too. They alone are believed where they put the
center elsewhere, by more than they may err. Whether the ball moved is told by the fit of all of them.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from ronnaplan.geometry import FloatArray
from ronnaplan.localization.fit.algebra import inverse
from ronnaplan.localization.fit.ball_fit import BallFit
from ronnaplan.localization.fit.cells import cell_directions, direction_cells
from ronnaplan.localization.fit.directions import near_any
from ronnaplan.localization.fit.parameters import CENTER, RADIUS
from ronnaplan.localization.judge.part import HALF_A_BALL, fit_by_part, is_plain
from ronnaplan.localization.judge.uncertainty import WEIGHTS, by_slices

CLEAR_DEG = 35.0
"""Directions are clear of those that are left out where they are farther from them than this angle."""

SURE = 2.8
"""The clear directions are believed where they move the center by so many standard errors of their own: out of their
95 % ellipsoid."""

LEAST_DRAWN_MM = 0.01
"""A rim that moves the center by less is let be. Haze at one side of a ball, and what hardens its rays, make the two
fits differ by 5 to 8 um, and there the clear directions are no better; what is stated holds so much."""

MOST_DRAWN_MM = 0.1
"""No rim draws by more, which is twice what any did. In 5 mm slices clear directions put a ball 120 um elsewhere whose
whole was 6 um off: few slices show how its poles end."""

LEAST_CLEAR = 0.4
"""Clear directions tell a center if they are so many of all: of balls in sockets 0.48 to 0.78 are, of one that jumped
while it was scanned less than 0.1, and they put it anywhere."""

TOWARDS_DEG = 50.0
"""A rim draws the center towards itself, within this angle (43 at most in 14 sockets). What moves it otherwise is none:
a jump while the ball was scanned, or the profile of thick slices."""

STILL_DRAWN = 0.3
"""So much of how far the rim had drawn the center is stated: 0.22 of it was left at the root mean square of 49 balls of
plastic and glass, 5 to 11.5 mm, in sockets and on posts, in slices of 0.6 to 2 mm, whatever it was moved by."""


def without_the_rim(fit: BallFit, diameter_mm: float) -> BallFit:
    """Return the fit of a ball by the directions that are clear of what touches it, where the others draw it aside.

    As it is, where they do not, are too few, or show a ball that is less like one of ``diameter_mm``, as the sides of
    one do that jumped while it was scanned. That is not asked of metal, hollow or wrapped balls, nor of those whose
    slices a screw crosses, which other things bend.
    """
    if not is_plain(fit) or fit.by_part_mm2 is not None:
        return fit
    is_left_out = fit.verdict.state == 0
    is_clear = ~near_any(cell_directions(), is_left_out, math.cos(math.radians(CLEAR_DEG)))
    if not is_left_out.any() or np.mean(is_clear) < LEAST_CLEAR:
        return fit
    clear = fit.used & is_clear[direction_cells(fit.neighbourhood.offsets_mm - fit.theta[CENTER])]
    alone = fit_by_part(fit, fit.neighbourhood, clear)
    if alone is None:
        return fit
    moved_mm = alone.theta[CENTER] - fit.theta[CENTER]
    if not _was_drawn(moved_mm, cell_directions()[is_left_out].sum(axis=0)):
        return fit
    off_mm, off_alone_mm = (abs(2.0 * float(one.theta[RADIUS]) - diameter_mm) for one in (fit, alone))
    if off_alone_mm > off_mm + LEAST_DRAWN_MM:
        return fit
    told_mm2 = WEIGHTS["slices"] * by_slices(alone)
    noise_mm2 = HALF_A_BALL**2 * told_mm2 + WEIGHTS["least"] * np.eye(3)
    if moved_mm @ inverse(noise_mm2) @ moved_mm < SURE**2:
        return fit
    left_mm = STILL_DRAWN * moved_mm
    more_mm2 = (HALF_A_BALL**2 - 1.0) * told_mm2 + np.outer(left_mm, left_mm)
    return replace(alone, made_good_mm=fit.made_good_mm, by_part_mm2=more_mm2, drawn=fit)


def _was_drawn(moved_mm: FloatArray, rim: FloatArray) -> bool:
    """Tell whether a center to be ``moved_mm`` (3,) had been drawn towards a ``rim`` (3,), as far as rims do."""
    far_mm, away = float(np.linalg.norm(moved_mm)), -float(moved_mm @ rim)
    straight = far_mm * float(np.linalg.norm(rim))
    return LEAST_DRAWN_MM <= far_mm <= MOST_DRAWN_MM and away > math.cos(math.radians(TOWARDS_DEG)) * straight
