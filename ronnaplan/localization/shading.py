"""What shades a ball a little: fitted to first order, after the descent has come to rest.

The side of a ball that faces the head is seen by a harder beam, so its contrast slopes, the more the denser the ball
is. And streaks are alike within a slice, not from slice to slice: each slice has a level and a contrast of its own.
All of these are random effects: each is believed only as far as it stands out from the residuals (C. Henderson,
Biometrics 31:423, 1975), so what a scan does not show does not disturb its fit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ronnaplan.geometry import FloatArray
from ronnaplan.localization.descent import Prior
from ronnaplan.localization.neighbourhood import Neighbourhood
from ronnaplan.localization.parameters import BACKGROUND, CENTER, CONTRAST

SLOPE_PER_MM_HU = 1.5e-7
"""Standard deviation of the contrast's slope, as a share of the contrast in each mm and HU of contrast (physically
simulated patients, `docs/localization.md`)."""

SLICE_LEVEL_HU = 3.0
SLICE_CONTRAST = 0.003
"""Standard deviations of one slice's level, and of its contrast as a share of the ball's."""

QUANTIZATION_NOISE_HU = 12.0**-0.5
"""Standard deviation of rounding to whole HU: no scan has less noise than this."""

PLATEAU_SHARE = 0.9
"""Shading is only asked for where the scale reaches this share of the contrast: clipped metal hides it."""


@dataclass(frozen=True)
class Shading:
    """What shading does to a fit.

    ``shift_mm`` (3,) moves the center; ``influence_mm_per_hu`` (N, 3) and ``residuals_hu`` (N,) are the fit's with it.
    """

    shift_mm: FloatArray
    influence_mm_per_hu: FloatArray
    residuals_hu: FloatArray


def shaded(
    around: Neighbourhood,
    theta: FloatArray,
    residuals_hu: FloatArray,
    jacobian: FloatArray,
    used: NDArray[np.bool_],
    prior: Prior,
) -> Shading:
    """Give a fit at rest the shading that its residuals show."""
    ball_hu = jacobian[:, [CONTRAST]] * theta[CONTRAST]
    informed = np.hstack([jacobian, ball_hu * (around.offsets_mm - theta[CENTER])])
    own, own_residuals_hu = informed[used], residuals_hu[used]
    of_slice = np.column_stack([own[:, BACKGROUND], ball_hu[used]])
    mean_square = max(float(np.mean(own_residuals_hu**2)), QUANTIZATION_NOISE_HU**2)
    firmness = mean_square / np.array([SLICE_LEVEL_HU, SLICE_CONTRAST]) ** 2
    # The slices' effects are many and each concerns one slice only: they are eliminated slice by slice.
    freed, rest_hu = own.copy(), own_residuals_hu.copy()
    for voxels in _slices(around.indices[used, 0]):
        effect = of_slice[voxels]
        both = np.column_stack([own[voxels], own_residuals_hu[voxels]])
        explained = effect @ np.linalg.solve(effect.T @ effect + np.diag(firmness), effect.T @ both)
        freed[voxels] -= explained[:, :-1]
        rest_hu[voxels] -= explained[:, -1]
    tilt_weight = mean_square / (SLOPE_PER_MM_HU * theta[CONTRAST]) ** 2
    inverse = np.linalg.pinv(own.T @ freed + np.diag([*prior.weight, *[tilt_weight] * 3]), hermitian=True)
    pull = own.T @ rest_hu
    pull[:-3] -= own[:, :-3].T @ own_residuals_hu  # without shading the fit is at rest
    believed = inverse @ pull
    moves, left_over = np.zeros_like(around.offsets_mm), residuals_hu - informed @ believed
    moves[used], left_over[used] = freed @ inverse[:, :3], rest_hu - freed @ believed
    return Shading(believed[:3], moves, left_over)


def _slices(numbers: NDArray[np.intp]) -> list[slice]:
    """The voxels of each slice, by their slices' ``numbers`` (N,); a neighbourhood holds them slice by slice."""
    starts = np.flatnonzero(np.diff(numbers, prepend=-1))
    return [slice(a, b) for a, b in zip(starts, [*starts[1:], len(numbers)], strict=True)]
