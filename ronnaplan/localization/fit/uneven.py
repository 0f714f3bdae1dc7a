"""Balls whose filling is uneven: what makes plastic show in a CT settles while it hardens.

One side of such a ball is brighter than the other, and a ball that is bright throughout is fitted nearer to that side:
by 0.03 to 0.1 mm where the brightness changes by a tenth from the center to the surface. The ball's own inside tells.
What hardened rays do to a ball is smaller by far (`fit.shading`), so nothing is asked of balls that could be even.
Edges may tell the like of even ones whose other side something hides: so what lies deep inside may contradict them.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ronnaplan.geometry import FloatArray
from ronnaplan.localization.fit.algebra import inverse
from ronnaplan.localization.fit.ball_fit import BallFit, covariance_by
from ronnaplan.localization.fit.depth import deep_inside, edge_depth
from ronnaplan.localization.fit.parameters import CENTER, CONTRAST, RADIUS, WIDTH
from ronnaplan.localization.fit.residuals import ALIKE_VOXELS

LEAST_UNEVEN = 0.04
"""A filling is uneven where the contrast changes by more than this share of it from the center to the surface,
within the slices. Balls of one density beside a head showed 0.025 at most; uneven ones 0.07 and more
(`docs/localization_figures.md`, twenty-eighth simulator)."""

STANDS_OUT = 6.0
"""... and by so many standard errors, for noise that is alike in `ALIKE_VOXELS` voxels. Along all axes balls of one
density showed 5.4 at most, uneven ones 7.5 and more."""

LEAST_SHOWN, SHOWN_ERRORS = 0.5, 2.0
"""What is deep inside contradicts that where it changes by less than this share of it, by so many of its own standard
errors: balls of aluminium on pegs as wide as they are, beside a head, would change by 0.08 by their edges, and hardly
change deep inside."""

LEAST_DEEP = 20
"""Fewer voxels deep inside contradict nothing."""

WIDEST_SHARE = 0.5
"""A slice profile wider than this share of the radius hides how a ball is filled."""


def uneven_hu(fit: BallFit) -> FloatArray | None:
    """By how much a ball's voxels (N,) differ from those of an even one; None where nothing says that they do.

    That is asked of solid balls whose contrast the scale shows. What changes from slice to slice only says nothing: a
    screw that crosses the slices of one pole makes it fainter (`judge.crossed`).
    """
    if not fit.converged or not fit.is_shaded or fit.prior.layer_mm != 0.0:
        return None
    if fit.theta[WIDTH] > WIDEST_SHARE * fit.theta[RADIUS]:
        return None
    ball_hu = fit.jacobian[:, CONTRAST] * fit.theta[CONTRAST]
    along_hu = ball_hu[:, np.newaxis] * (fit.neighbourhood.offsets_mm - fit.theta[CENTER])
    used = np.flatnonzero(fit.used)
    informed, rest_hu = np.column_stack([fit.jacobian, along_hu]).take(used, axis=0), fit.unshaded_hu.take(used)
    covariance = covariance_by(informed, fit.prior)
    pull = informed.T @ rest_hu
    pull[:-3] = 0.0  # with an even ball the fit is at rest
    told = covariance @ pull
    left_hu2 = float(np.mean((rest_hu - informed @ told) ** 2))
    slopes_per_mm, within = told[-3:], np.delete(np.arange(3), fit.neighbourhood.across)
    within_per_mm = slopes_per_mm[within]
    errors = within_per_mm @ inverse(covariance[-3:, -3:][np.ix_(within, within)]) @ within_per_mm
    is_sure = errors > STANDS_OUT**2 * ALIKE_VOXELS * left_hu2
    if not is_sure or float(np.linalg.norm(within_per_mm)) * float(fit.theta[RADIUS]) < LEAST_UNEVEN:
        return None
    if _is_even_deep_inside(fit, within, within_per_mm * fit.theta[CONTRAST]):
        return None
    differ_hu: FloatArray = along_hu @ slopes_per_mm
    return differ_hu


def _is_even_deep_inside(fit: BallFit, within: NDArray[np.intp], slopes_hu: FloatArray) -> bool:
    """Whether the voxels that no edge reaches contradict ``slopes_hu`` (2,), HU/mm along the axes ``within`` slices."""
    deep = np.flatnonzero(fit.used & deep_inside(*edge_depth(fit.neighbourhood.offsets_mm, fit.theta)))
    if len(deep) < LEAST_DEEP:
        return False
    offsets_mm = fit.neighbourhood.offsets_mm.take(deep, axis=0) - fit.theta[CENTER]
    squares_mm2 = np.sum(offsets_mm**2, axis=1)  # edges dim what is near them, on all sides alike
    known = np.column_stack([np.ones(len(deep)), squares_mm2, squares_mm2**2, offsets_mm])
    values_hu, covariance = fit.neighbourhood.values_hu.take(deep), np.linalg.pinv(known.T @ known)
    change = covariance @ (known.T @ values_hu)
    covariance *= ALIKE_VOXELS * float(np.mean((values_hu - known @ change) ** 2))
    towards, rows = slopes_hu / np.linalg.norm(slopes_hu), known.shape[1] - 3 + within
    error_hu = math.sqrt(towards @ covariance[np.ix_(rows, rows)] @ towards)
    shown_hu, least_hu = float(change[rows] @ towards), LEAST_SHOWN * float(np.linalg.norm(slopes_hu))
    return shown_hu + SHOWN_ERRORS * error_hu < least_hu
