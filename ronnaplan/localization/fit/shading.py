"""What shades a ball a little: fitted to first order, after the descent has come to rest.

The side of a ball that faces the head is seen by a harder beam, so its contrast slopes, the more the denser the ball
is. And streaks are alike within a slice, not from slice to slice: each slice has a level and a contrast of its own.
The skin that a ball lies on is curved more or less than a head is.
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
from ronnaplan.localization.fit.descent import Prior
from ronnaplan.localization.fit.model import has_layer, has_skin
from ronnaplan.localization.fit.neighbourhood import Neighbourhood, first_of_each
from ronnaplan.localization.fit.parameters import BACKGROUND, CENTER, CONTRAST
from ronnaplan.localization.fit.residuals import layer_jacobian
from ronnaplan.localization.fit.skin import CURVATURE_SPREAD_PER_MM, bent

SLOPE_PER_MM_HU = 1.5e-7
"""Standard deviation of the contrast's slope, as a share of the contrast in each mm and HU of contrast (physically
simulated patients, `docs/localization.md`)."""

SLICE_LEVEL_HU = 3.0
SLICE_CONTRAST = 0.003
"""Standard deviations of one slice's level, and of its contrast as a share of the ball's: chosen, fitted to nothing."""

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
    bends: bool,
) -> Shading:
    """Give a fit at rest the shading that its residuals show; ``slopes`` and ``bends`` say what may.

    So is it told where the cavity of a hollow ball lies: beside its center, which is that of its outer surface.
    """
    ball_hu, along_mm = jacobian[:, CONTRAST] * theta[CONTRAST], around.offsets_mm - theta[CENTER]
    is_hollow = prior.layer_mm < 0.0
    more = ball_hu[:, np.newaxis] * along_mm[:, : 3 * slopes]
    spread = [SLOPE_PER_MM_HU * theta[CONTRAST]] * more.shape[1]
    if bends and has_skin(theta) and not has_layer(theta):  # what is wrapped around a ball may look like skin
        more = np.column_stack([more, bent(along_mm, theta, jacobian)])
        spread.append(CURVATURE_SPREAD_PER_MM)
    if is_hollow:
        more = np.hstack([more, layer_jacobian(around, theta, prior.layer_mm)])
        spread += [-UNEVEN * prior.layer_mm / np.sqrt(3.0)] * 3
    count, kept = len(theta), np.flatnonzero(used)
    own = _rows(kept, jacobian, more, residuals_hu)
    products = own.T @ own
    at_rest = products[:count, -1].copy()  # without shading the fit is at rest
    mean_square = max(products[-1, -1] / len(kept), QUANTIZATION_NOISE_HU**2)
    firmness = mean_square / np.array([SLICE_LEVEL_HU, SLICE_CONTRAST]) ** 2
    first, own_ball_hu = first_of_each(around.slices[kept]), ball_hu.take(kept)
    by_slice = _free_slices(own, own_ball_hu, first, firmness, products)
    covariance = inverse(products[:-1, :-1] + np.diag([*prior.weight, *(mean_square / np.square(spread))]))
    pull = products[:-1, -1].copy()
    pull[:count] -= at_rest
    believed = covariance @ pull
    # Of derivatives and residuals: what moves the center, and what is left over.
    told = np.vstack([np.column_stack([covariance[:, :3], -believed]), [0.0, 0.0, 0.0, 1.0]])
    moves = np.zeros_like(around.offsets_mm)
    left_over = residuals_hu - jacobian @ believed[:count] - more @ believed[count:]
    _tell(kept, own, own_ball_hu, first, by_slice @ told, told, moves, left_over)
    return Shading(believed[:3], believed[-3:] if is_hollow else np.zeros(3), moves, left_over)


@njit(cache=True, nogil=True)
def _rows(kept: NDArray[np.intp], jacobian: FloatArray, more: FloatArray, residuals: FloatArray) -> FloatArray:
    """Return derivatives, more of them, and residuals of the voxels that are ``kept`` (M,), side by side (M, Q)."""
    count, size = jacobian.shape[1], jacobian.shape[1] + more.shape[1]
    rows = np.empty((len(kept), size + 1))
    for m in range(len(kept)):
        n = kept[m]
        for p in range(count):
            rows[m, p] = jacobian[n, p]
        for p in range(count, size):
            rows[m, p] = more[n, p - count]
        rows[m, size] = residuals[n]
    return rows


@njit(cache=True, error_model="numpy", nogil=True)
def _free_slices(
    own: FloatArray, ball: FloatArray, first: NDArray[np.intp], firmness: FloatArray, products: FloatArray
) -> FloatArray:
    """Return what level and contrast of each slice explain (2, S, Q) of derivatives and residuals ``own`` (N, Q).

    That is taken from their ``products`` (Q, Q). These effects are many and each concerns one slice only: they are
    eliminated slice by slice, the ``first`` (S,) voxel of each being told. The ``ball`` (N,) is what a change of the
    contrast adds; level and contrast hold with ``firmness`` (2,).
    """
    size = own.shape[1]
    by_slice = np.empty((2, len(first), size))
    by_level, by_ball = np.empty(size), np.empty(size)
    for s in range(len(first)):
        last = first[s + 1] if s + 1 < len(first) else len(own)
        voxels, squares, shared = firmness[0], firmness[1], 0.0
        by_level[:], by_ball[:] = 0.0, 0.0
        for n in range(first[s], last):
            level = own[n, BACKGROUND]  # none where the scale has ended
            voxels += level * level
            shared += level * ball[n]
            squares += ball[n] * ball[n]
            for p in range(size):
                by_level[p] += level * own[n, p]
                by_ball[p] += ball[n] * own[n, p]
        scale = 1.0 / (voxels * squares - shared * shared)
        for p in range(size):
            by_slice[0, s, p] = scale * (squares * by_level[p] - shared * by_ball[p])
            by_slice[1, s, p] = scale * (voxels * by_ball[p] - shared * by_level[p])
        for p in range(size):
            for q in range(size):
                products[p, q] -= by_level[p] * by_slice[0, s, q] + by_ball[p] * by_slice[1, s, q]
    return by_slice


@njit(cache=True, nogil=True)
def _tell(
    kept: NDArray[np.intp],
    own: FloatArray,
    ball: FloatArray,
    first: NDArray[np.intp],
    told_by_slice: FloatArray,
    told: FloatArray,
    moves: FloatArray,
    left_over: FloatArray,
) -> None:
    """Fill ``moves`` (N, 3) and ``left_over`` (N,) of the voxels ``kept`` (M,) with ``own`` (M, Q) @ ``told``.

    What level and contrast of their slices explain of that, ``told_by_slice`` (2, S, 4), is left out.
    """
    seen, s = np.empty(4), -1
    for m in range(len(kept)):
        if s + 1 < len(first) and m == first[s + 1]:
            s += 1
        for a in range(4):
            seen[a] = -own[m, BACKGROUND] * told_by_slice[0, s, a] - ball[m] * told_by_slice[1, s, a]
        for q in range(own.shape[1]):
            for a in range(4):
                seen[a] += own[m, q] * told[q, a]
        moves[kept[m]], left_over[kept[m]] = seen[:3], seen[3]
