"""To how much of its surface a ball may be attached, also one that is sunk into the face of a bar or a plate.

What such a ball is attached to goes on beside it. A rod, a capsule or a peg with a round end is no wider than its end,
and skin is no plate: behind it there is a head.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ronnaplan.ct.volume import CTVolume
from ronnaplan.geometry import FloatArray, axes_across
from ronnaplan.localization.fit.ball_fit import BallFit
from ronnaplan.localization.fit.cells import cell_directions
from ronnaplan.localization.fit.directions import ATTACHED_SHARE
from ronnaplan.localization.fit.parameters import BACKGROUND, RADIUS
from ronnaplan.localization.fit.skin import face_hu, share_on_skin
from ronnaplan.localization.search.nearest import sample_nearest

MAX_ATTACHED, SKIN_MARGIN = 0.14, 0.03
"""A post is attached to a small part of a marker's surface (a post of 4 mm to 3 % of one of 11.5 mm), skin that it lies
on to no more than a plane would be and this margin (to 12 % of one of 11.5 mm, to 23 % of one of 4 mm); a capsule or a
rod goes on in far more of it."""

MAX_SUNK = 0.3
"""... but for a bar or a plate that it is sunk into by up to a quarter of its diameter, which goes on beside it."""

SURELY = 0.05
"""What is attached to so much more of its surface than a ball may be stays so, whatever is made good of its image."""

CLEAR_MM = 1.5
"""A face is looked for so far below where it seems to cut the ball, and so far beside the ball: clear of the blur."""

THICKEST_MM = 8.0
"""A bar or a plate ends so far behind that; a head does not."""

LINES, LEAST_LINES = 6, 2
"""Of so many lines through the ball along a face so many at least meet it on both sides: a bar is narrower than it."""


def most_attached(volume: CTVolume, fit: BallFit, spare: float = 0.0) -> tuple[float, bool]:
    """Return to which share of its surface a ball may be attached, and whether that is as it is sunk into a face.

    With ``spare`` it may be sunk by as much more.
    """
    attached, excess_hu = fit.verdict.attached_share, fit.verdict.excess_hu
    # Of a ball that is at the scale's end itself nobody knows whether what it touches is brighter.
    end_hu = math.inf if fit.is_clipped else fit.ceiling_hu - float(fit.theta[BACKGROUND])
    bright_hu = face_hu(excess_hu, fit.contrast_hu, end_hu)
    allowed = max(MAX_ATTACHED, share_on_skin(fit.theta, bright_hu) + SKIN_MARGIN)
    is_sunk = allowed < attached <= MAX_SUNK + spare and lies_in_a_face(volume, fit, excess_hu)
    return (MAX_SUNK, True) if is_sunk else (allowed, False)


def is_surely_attached(volume: CTVolume, fit: BallFit) -> bool:
    """Whether a fit shows something that goes on in more of the surface than any ball's, by `SURELY`.

    That is not sure where scatter fades balls by half, as it does behind a head in a flat panel's pictures.
    """
    attached = fit.verdict.attached_share
    if not fit.converged or attached <= MAX_ATTACHED + SURELY or volume.grid.may_be_a_panels:
        return False
    return attached > most_attached(volume, fit, SURELY)[0] + SURELY


def lies_in_a_face(volume: CTVolume, fit: BallFit, excess_hu: FloatArray) -> bool:
    """Whether a ball is attached to a bar or a plate, by what is just outside it (C,) and farther out."""
    attached = excess_hu > ATTACHED_SHARE * fit.contrast_hu
    toward = cell_directions()[attached].sum(axis=0) @ fit.neighbourhood.axes
    length = float(np.linalg.norm(toward))
    if length == 0.0:
        return False
    toward = toward / length
    one, other = axes_across(toward)
    turns = np.pi / LINES * np.arange(LINES)[:, np.newaxis]
    radius_mm = float(fit.theta[RADIUS])
    aside_mm = (radius_mm + CLEAR_MM) * (np.cos(turns) * one + np.sin(turns) * other)
    below_mm = fit.center_mm + (radius_mm * (1.0 - 2.0 * float(attached.mean())) + CLEAR_MM) * toward
    middle_hu = float(fit.theta[BACKGROUND]) + face_hu(excess_hu, fit.contrast_hu) / 2.0

    def is_bright(places_mm: FloatArray) -> NDArray[np.bool_]:
        bright: NDArray[np.bool_] = sample_nearest(volume, places_mm) > middle_hu
        return bright

    meets = np.ones(LINES, dtype=np.bool_)
    for side in (1.0, -1.0):
        places_mm = below_mm + side * aside_mm
        meets &= is_bright(places_mm) & ~is_bright(places_mm + THICKEST_MM * toward)
    return int(np.count_nonzero(meets)) >= LEAST_LINES
