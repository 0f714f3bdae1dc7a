"""The parameters of a fitted ball, ``theta`` (P,), by name.

Whatever takes or gives a ``theta`` means these: `PARAMETERS`, and after them those of `LAYER_PARAMETERS`,
`STREAK_PARAMETERS` and `SKIN_PARAMETERS` that the ball needs, in this order, so that P, 13 to 20, tells which there are
(`model.has_layer`, `has_streaks`, `has_skin`). Places are along u, v and w of the slices, in mm from the origin of the
voxels that were fitted (`neighbourhood`). Jacobians (N, P) and priors (P,) have the same order.
"""

from __future__ import annotations

import math

from ronnaplan.geometry import FloatArray

PARAMETERS = (
    *("u", "v", "w", "radius", "blur", "edge", "width", "shape", "contrast", "background"),
    *("slope_u", "slope_v", "slope_w"),
)
"""Order of the model's parameters: center, radius and in-plane blur (mm), how far the kernel enhances edges, the slice
profile's width (mm) and shape, contrast and background (HU), and the background's slope (HU/mm). The width is that of
the box with the profile's variance: its standard deviation times the root of 12."""

U, V, W, RADIUS, BLUR, EDGE, WIDTH, SHAPE, CONTRAST, BACKGROUND, SLOPE_U, SLOPE_V, SLOPE_W = range(13)
SHAPED = SHAPE + 1
"""So many parameters, the first ones, say what shape the blurred ball has."""

CENTER, SLOPES = slice(0, 3), slice(SLOPE_U, SLOPE_W + 1)
"""Places in the parameters, by name."""

LAYER_PARAMETERS = ("layer",)
"""One more where the marker is hollow or wrapped: the level (HU) of a second ball about the same center, below zero for
a cavity, above for what is wrapped around."""

STREAK_PARAMETERS = ("streak", "streak_diagonal")
"""Two more, after it, where the ball is metal: how bright its streaks are at the surface (HU) along the rows, which are
as dark down the columns, and the same on the diagonals."""

SKIN_PARAMETERS = ("skin", "skin_u", "skin_v", "skin_w")
"""Four more, the last ones, where the ball lies on skin: its level over the background (HU), and the vector g (1/mm)
that puts the skin nearest to the ball at g . x = 1, x from the ball's center; it fills the far side."""

SKIN_LEVEL_AT, SKIN_PLACE = -len(SKIN_PARAMETERS), slice(1 - len(SKIN_PARAMETERS), None)
"""Where the skin's level and the vector to it stand, where there is any."""

LEAST_SPREAD_MM2 = 0.01
"""Added to the variance of the blur across the slices, so that no edge is endlessly sharp however thin the slices."""

GAUSSIAN_QUARTILE, HALVINGS = 0.6744897501960817, 40
"""How far from its middle a Gaussian's edge passes a quartile, in terms of its standard deviation, and in how many
halvings of an interval that is found for other edges."""


def profile_half_mm(width_mm: float, shape: float) -> float:
    """Half the length over which a slice of this profile sees anything."""
    return 0.5 * width_mm * math.sqrt((2.0 * shape + 3.0) / 3.0)


def full_width_at_half_maximum_mm(width_mm: float, shape: float) -> float:
    """The profile's width as scanners state their slice thickness; a Gaussian is a tenth narrower."""
    half_mm = profile_half_mm(width_mm, shape)
    return 2.0 * half_mm * (math.sqrt(1.0 - 0.5 ** (1.0 / shape)) if shape > 0.0 else 1.0)


def profile_fwhm_mm(theta: FloatArray) -> float:
    """Full width at half maximum of the fitted slice profile; ``theta`` (P,)."""
    return full_width_at_half_maximum_mm(float(theta[WIDTH]), float(theta[SHAPE]))


def edge_variance_mm2(theta: FloatArray) -> float:
    """Variance of the blur within the slices: an ``edge`` takes part of the Gaussian's away, or adds to it."""
    return float(theta[BLUR] ** 2 * (1.0 - 2.0 * theta[EDGE]))


def softness_mm2(theta: FloatArray) -> float:
    """Variance of the Gaussian whose edge, within the slices, is as wide between its quartiles as this one.

    A kernel that falls steeply is fitted as well with an ``edge`` below zero as with one above: then the variances of
    the blur differ far, but the middle of the edge, which is what is seen, does not.
    """
    near, far = 0.0, 4.0  # in terms of the blur: the edge's middle, and beyond its quartile
    for _ in range(HALVINGS):
        middle = 0.5 * (near + far)
        risen = 0.5 * math.erf(middle / math.sqrt(2.0))
        risen += float(theta[EDGE]) * middle * math.exp(-0.5 * middle**2) / math.sqrt(2.0 * math.pi)
        near, far = (middle, far) if risen < 0.25 else (near, middle)
    return float((theta[BLUR] * near / GAUSSIAN_QUARTILE) ** 2)
