"""What the edge of a fitted ball shows beside what was fitted: a blur of other axes, and an ellipsoid for a ball.

Both are fitted to the residuals, to first order.

- The fit has the slices' axes, and the blur may have others. A Gaussian's covariance changes an image by its second
  derivatives (the equation of heat).
- A grid that is stretched or sheared a little makes an ellipsoid of a ball. Where every place x about the center stands
  at x + E x, an image changes by -grad f . E x, its blur along with the ball.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ronnaplan.geometry import FloatArray
from ronnaplan.localization.fit.algebra import inverse, quantile
from ronnaplan.localization.fit.ball_fit import BallFit
from ronnaplan.localization.fit.cells import BACKGROUND_QUANTILE, cell_directions, cell_means, direction_cells
from ronnaplan.localization.fit.depth import deep_inside, edge_depth, within_reach
from ronnaplan.localization.fit.directions import near_any, unlike_inside
from ronnaplan.localization.fit.parameters import (
    BACKGROUND,
    CENTER,
    LEAST_SPREAD_MM2,
    RADIUS,
    WIDTH,
    U,
    V,
    W,
    edge_variance_mm2,
)
from ronnaplan.localization.fit.residuals import residuals_and_jacobian

BEYOND_MM = (0.3, 1.5)
STANDS_SHARE, STANDS_HU = 0.1, 120.0
CLEAR_DEG = 30.0
"""Something stands in a direction that is brighter by this share of the contrast so far beyond the blurred edge, where
the edge of a ball that moved does not reach, or by so much: a post of plastic, if thin, is less than that share beside
ceramic or metal. Directions closer than this angle are left out with it."""

STEP_MM = 0.05
"""Step of the second derivatives."""

WIDEST_SHARE = 0.5
"""A profile wider than this share of the radius hides how long a ball is across the slices, or whether it leans."""


@dataclass(frozen=True)
class Edge:
    """The edge of a fitted ball in all directions in which nothing stands."""

    fit: BallFit

    @cached_property
    def used(self) -> NDArray[np.intp]:
        """Which voxels (N,) of the fit's neighbourhood are of it, whether they informed the fit or not.

        A fit leaves out the directions that disagree: where a ball moved, those are half of it.
        """
        return np.flatnonzero(_unattached(self.fit))

    @cached_property
    def slanted(self) -> FloatArray:
        """What a blur whose axes are not those of the slices adds to these voxels, HU/mm^2 (N, 4).

        Along u and w, v and w, u and v, and half the difference of those along u and along v.
        """
        fit = self.fit
        changes, around = [], fit.neighbourhood.take(self.used)
        for axis in (U, V):
            step = np.zeros(len(fit.theta))
            step[axis] = STEP_MM
            ahead, behind = (
                residuals_and_jacobian(around, fit.theta + side * step, fit.prior.layer_mm)[1][
                    :, CENTER
                ].copy()  # the other columns are not held
                for side in (1.0, -1.0)
            )
            changes.append((ahead - behind) / (2.0 * STEP_MM))
        by_u, by_v = changes
        return np.column_stack([by_u[:, W], by_v[:, W], by_u[:, V], (by_u[:, U] - by_v[:, V]) / 2.0])

    @cached_property
    def explained(self) -> FloatArray:
        """What each of the ball's parameters (N, P), and such a blur, adds to these voxels (N, P + 4)."""
        return np.hstack([self.fit.jacobian.take(self.used, axis=0), self.slanted])


def blur_mm2(edge: Edge) -> FloatArray:
    """Covariance (3, 3) of a ball's blur in LPS, as the residuals of its edge show it beside what was fitted."""
    fit, used = edge.fit, edge.used
    explained = edge.explained
    (uw, vw, uv, oval) = (inverse(explained.T @ explained) @ (explained.T @ fit.residuals_hu[used]))[-4:]
    within, across = edge_variance_mm2(fit.theta), float(fit.theta[WIDTH]) ** 2 / 12.0 + LEAST_SPREAD_MM2
    axes = fit.neighbourhood.axes
    told: FloatArray = (
        axes.T @ np.array([[within + oval, uv, uw], [uv, within - oval, vw], [uw, vw, across]]) @ axes
    )
    return told


def shape_of(edge: Edge, radius_mm: float) -> FloatArray:
    """Return the shape (3, 3), along u, v and w, of the ellipsoid that a ball of the stated ``radius_mm`` is.

    As in `scanwide.ellipsoid.Ellipsoid`. It is told beside all the ball's parameters and its blur, by what is left
    before shading, which takes part of it. NaN where slices are too thick, or the scale's end hides how large the
    ball is.
    """
    fit, used = edge.fit, edge.used
    if fit.is_clipped or float(fit.theta[WIDTH]) > WIDEST_SHARE * float(fit.theta[RADIUS]):
        return np.full((3, 3), np.nan)
    along = fit.neighbourhood.offsets_mm.take(used, axis=0) - fit.theta[CENTER]
    by = edge.explained
    patterns = np.column_stack(
        [
            by[:, U] * along[:, U] - by[:, V] * along[:, V],
            by[:, U] * along[:, V] + by[:, V] * along[:, U],
            by[:, W] * along[:, W],
            by[:, U] * along[:, W],
            by[:, V] * along[:, W],
        ]
    )
    told = np.hstack([by, patterns])
    amounts = inverse(told.T @ told) @ (told.T @ fit.unshaded_hu[used])
    u_less_v, uv, ww, uw, vw = amounts[-patterns.shape[1] :]
    mapped = np.array([[1.0 + u_less_v, uv, uw], [uv, 1.0 - u_less_v, vw], [0.0, 0.0, 1.0 + ww]])
    size = (float(fit.theta[RADIUS]) + amounts[RADIUS]) / radius_mm
    shape: FloatArray = size**2 * mapped @ mapped.T
    return shape


def _with_dark_air(fit: BallFit) -> FloatArray:
    """Values (N,) of a fit's voxels, those at the scale's lower end as dark as the fit says what is around the ball is.

    Beside air that a scale shows too bright, a thin post seems too faint to be one, and what it does to the ball's edge
    is taken for motion.
    """
    around = fit.neighbourhood
    return np.where(around.is_cut_off, np.minimum(around.values_hu, fit.theta[BACKGROUND]), around.values_hu)


def _unattached(fit: BallFit) -> NDArray[np.bool_]:
    """Which of all voxels (N,) of a fit are of its edge where nothing stands."""
    around, theta = fit.neighbourhood, fit.theta
    depth, blur = edge_depth(around.offsets_mm, theta)
    cells = direction_cells(around.offsets_mm - theta[CENTER])
    beyond = (depth > 3.0 * blur + BEYOND_MM[0]) & (depth < 3.0 * blur + BEYOND_MM[1])
    outside_hu = cell_means(_with_dark_air(fit), cells, beyond)
    if np.isnan(outside_hu).all():
        return fit.used
    least_hu = min(STANDS_SHARE * fit.contrast_hu, STANDS_HU)
    stands = outside_hu - quantile(outside_hu, BACKGROUND_QUANTILE) > least_hu
    inside_hu = cell_means(fit.residuals_hu, cells, deep_inside(depth, blur))
    stands |= unlike_inside(inside_hu, fit.contrast_hu)
    unattached = ~(stands | near_any(cell_directions(), stands, math.cos(math.radians(CLEAR_DEG))))
    return within_reach(depth, blur) & (unattached[cells] | fit.used)
