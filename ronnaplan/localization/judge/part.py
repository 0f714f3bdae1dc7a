"""What a part of a ball's voxels tells of its center, where something beside the ball bends what the others show."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ronnaplan.localization.fit.ball_fit import BallFit, fit_at
from ronnaplan.localization.fit.descent import descend
from ronnaplan.localization.fit.model import has_layer
from ronnaplan.localization.fit.neighbourhood import Neighbourhood
from ronnaplan.localization.fit.refine import LEAST_VOXELS

HALF_A_BALL = 1.5
"""A part of a ball tells its center less well than its residuals say: by so much for a soft and a sharp kernel (113
balls of glass and plastic on screws)."""


def is_plain(fit: BallFit) -> bool:
    """Whether a part can be held against the whole ball: metal, hollow and wrapped ones are bent by other things."""
    return fit.converged and not fit.may_be_metal and not has_layer(fit.theta)


def fit_by_part(fit: BallFit, around: Neighbourhood, part: NDArray[np.bool_]) -> BallFit | None:
    """Return the fit of a ball by a ``part`` (N,) of the voxels ``around`` alone; None where they are too few."""
    if np.count_nonzero(part) < LEAST_VOXELS * len(fit.theta):
        return None
    theta, converged = descend(around.select(part), fit.theta, fit.prior)
    slopes = fit.made_good_mm is None
    alone = fit_at(around, theta, fit.prior, fit.verdict, part, converged=converged, slopes=slopes)
    return alone if alone.converged else None
