"""Balls that are sunk into the face of a bar or a plate: what they are attached to goes on beside them.

A rod, a capsule or a peg with a round end is no wider than its end, and skin is no plate: behind it there is a head.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ronnaplan.ct.volume import CTVolume
from ronnaplan.geometry import FloatArray, axes_across
from ronnaplan.localization.fit.ball_fit import BallFit
from ronnaplan.localization.fit.cells import cell_directions
from ronnaplan.localization.fit.directions import ATTACHED_SHARE
from ronnaplan.localization.fit.parameters import BACKGROUND, RADIUS
from ronnaplan.localization.fit.skin import face_hu
from ronnaplan.localization.search.nearest import sample_nearest

CLEAR_MM = 1.5
"""A face is looked for so far below where it seems to cut the ball, and so far beside the ball: clear of the blur."""

THICKEST_MM = 8.0
"""A bar or a plate ends so far behind that; a head does not."""

LINES, LEAST_LINES = 6, 2
"""Of so many lines through the ball along a face so many at least meet it on both sides: a bar is narrower than it."""


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
