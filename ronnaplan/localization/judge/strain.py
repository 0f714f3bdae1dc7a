"""The ellipsoid that a fitted ball is: what a grid that is stretched or sheared a little makes of it.

Where every place x about the center stands at x + E x, an image changes by -grad f . E x, to first order, its blur
along with the ball. That is fitted to what the fit of a ball leaves over, beside all its parameters and a blur that has
other axes than the slices: it moves edges, they change how these look. It is fitted to what is left before shading,
which takes part of it.
"""

from __future__ import annotations

import numpy as np

from ronnaplan.geometry import FloatArray
from ronnaplan.localization.fit.algebra import inverse
from ronnaplan.localization.fit.parameters import CENTER, RADIUS, WIDTH, U, V, W
from ronnaplan.localization.judge.blur import Edge

WIDEST_SHARE = 0.5
"""A profile wider than this share of the radius hides how long a ball is across the slices, or whether it leans."""


def shape_of(edge: Edge, radius_mm: float) -> FloatArray:
    """Return the shape (3, 3), along u, v and w, of the ellipsoid that a ball of the stated ``radius_mm`` is.

    As in `scanwide.ellipsoid.Ellipsoid`. NaN where slices are too thick, or the scale's end hides how
    large the ball is.
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
