"""What shades a ball a little: fitted to first order, after the descent has come to rest.

The side of a ball that faces the head is seen by a harder beam, so its contrast slopes, the more the denser the ball
is. And streaks are alike within a slice, not from slice to slice: each slice has a level and a contrast of its own.
The cavity of a hollow ball lies aside where its wall is not of one thickness, and the fit lies between its two centers.
All of these are random effects: each is believed only as far as it stands out from the residuals (C. Henderson,
Biometrics 31:423, 1975), so what a scan does not show does not disturb its fit. Where what a head does to the image
is made good (`scanner.hardened`), the contrast does not slope.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kernelcache import njit
from ronnaplan.geometry import FloatArray
from ronnaplan.localization.fit.algebra import inverse
from ronnaplan.localization.fit.descent import Prior, layer_jacobian
from ronnaplan.localization.fit.neighbourhood import Neighbourhood
from ronnaplan.localization.fit.parameters import BACKGROUND, CENTER, CONTRAST

SLOPE_PER_MM_HU = 1.5e-7
"""Standard deviation of the contrast's slope, as a share of the contrast in each mm and HU of contrast (physically
simulated patients, `docs/localization.md`)."""

SLICE_LEVEL_HU = 3.0
SLICE_CONTRAST = 0.003
"""Standard deviations of one slice's level, and of its contrast as a share of the ball's."""

UNEVEN = 0.15
"""A marker's cavity, or what is wrapped around it, lies off its center by this share of the layer's thickness, in any
direction: an assumption."""

QUANTIZATION_NOISE_HU = 12.0**-0.5
"""Standard deviation of rounding to whole HU: no scan has less noise than this."""

PLATEAU_SHARE = 0.9
"""Shading is only asked for where the scale reaches this share of the contrast: clipped metal hides it."""


@dataclass(frozen=True)
class Shading:
    """What shading does to a fit.

    ``shift_mm`` (3,) moves the center, from which a cavity lies ``aside_mm`` (3,); ``influence_mm_per_hu`` (N, 3) and
    ``residuals_hu`` (N,) are the fit's with it.
    """

    shift_mm: FloatArray
    aside_mm: FloatArray
    influence_mm_per_hu: FloatArray
    residuals_hu: FloatArray


def shaded(
    around: Neighbourhood,
    theta: FloatArray,
    residuals_hu: FloatArray,
    jacobian: FloatArray,
    used: NDArray[np.bool_],
    prior: Prior,
    *,
    slopes: bool,
) -> Shading:
    """Give a fit at rest the shading that its residuals show; ``slopes`` says whether the contrast may.

    So is it told where the cavity of a hollow ball lies: beside its center, which is that of its outer surface.
    """
    ball_hu = jacobian[:, CONTRAST] * theta[CONTRAST]
    is_hollow = prior.layer_mm < 0.0
    more = ball_hu[:, np.newaxis] * (around.offsets_mm - theta[CENTER])[:, : 3 * slopes]
    spread = [SLOPE_PER_MM_HU * theta[CONTRAST]] * more.shape[1]
    if is_hollow:
        more = np.hstack([more, layer_jacobian(around, theta, prior.layer_mm)])
        spread += [-UNEVEN * prior.layer_mm / np.sqrt(3.0)] * 3
    count = len(theta)
    kept = np.flatnonzero(used)
    own = np.hstack([jacobian.take(kept, axis=0), more.take(kept, axis=0)])
    own_residuals_hu = residuals_hu.take(kept)
    mean_square = max(float(np.mean(own_residuals_hu**2)), QUANTIZATION_NOISE_HU**2)
    firmness = mean_square / np.array([SLICE_LEVEL_HU, SLICE_CONTRAST]) ** 2
    freed, rest_hu = own.copy(), own_residuals_hu.copy()
    _free_slices(freed, rest_hu, ball_hu.take(kept), around.slices[kept], firmness)
    covariance = inverse(own.T @ freed + np.diag([*prior.weight, *(mean_square / np.square(spread))]))
    pull = own.T @ rest_hu
    pull[:count] -= own[:, :count].T @ own_residuals_hu  # without shading the fit is at rest
    believed = covariance @ pull
    moves, left_over = (
        np.zeros_like(around.offsets_mm),
        residuals_hu - jacobian @ believed[:count] - more @ believed[count:],
    )
    moves[kept], left_over[kept] = freed @ covariance[:, :3], rest_hu - freed @ believed
    return Shading(believed[:3], believed[-3:] if is_hollow else np.zeros(3), moves, left_over)


@njit(cache=True, error_model="numpy", nogil=True)
def _free_slices(
    freed: FloatArray, rest: FloatArray, ball: FloatArray, slices: NDArray[np.intp], firmness: FloatArray
) -> None:
    """Take from derivatives (N, Q) and residuals (N,) what level and contrast of each slice explain of them.

    These are many and each concerns one slice only: they are eliminated slice by slice, as which the voxels come. The
    ``ball`` (N,) is what a change of the contrast adds; level and contrast hold with ``firmness`` (2,).
    """
    last, size = 0, freed.shape[1]
    by_level, by_ball = np.empty(size + 1), np.empty(size + 1)
    while last < len(slices):
        first = last
        voxels = squares = shared = 0.0
        by_level[:], by_ball[:] = 0.0, 0.0
        while last < len(slices) and slices[last] == slices[first]:
            level = freed[last, BACKGROUND]  # none where the scale has ended
            voxels += level * level
            shared += level * ball[last]
            squares += ball[last] * ball[last]
            for p in range(size + 1):
                value = freed[last, p] if p < size else rest[last]
                by_level[p] += level * value
                by_ball[p] += ball[last] * value
            last += 1
        voxels, squares = voxels + firmness[0], squares + firmness[1]
        scale = 1.0 / (voxels * squares - shared * shared)
        for p in range(size + 1):
            level_share = scale * (squares * by_level[p] - shared * by_ball[p])
            ball_share = scale * (voxels * by_ball[p] - shared * by_level[p])
            by_level[p], by_ball[p] = level_share, ball_share
        for n in range(first, last):
            level = freed[n, BACKGROUND]
            for p in range(size):
                freed[n, p] -= level * by_level[p] + ball[n] * by_ball[p]
            rest[n] -= level * by_level[size] + ball[n] * by_ball[size]
