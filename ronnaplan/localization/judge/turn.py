"""What a displacement that differs with the direction of view does to the image of a ball that one turn has made.

Each view tells of one direction n within the slices, at all frequencies: where it saw the ball displaced by B along n,
the image's Fourier transform there is multiplied by 1 - 2 pi i f B, to first order. A B of the m-th harmonic of the
direction turns the ball's transform f(k) within a slice into the image of e^(i m phi) times the integral of
k^2 f(k) J_m(k s) over k, s from the axis. For m = 1 that is the derivative along n: a shift. Beyond, the recurrences of
Bessel functions leave the same derivative, which bends the edge, and moments of the ball within s (NIST Digital Library
of Mathematical Functions, section 10.6): streaks that fall off outside as slowly as 1 / s^3. Beside an edge that is
blurred over an eighth of the ball these are as bright as what the edge itself shows.
"""

from __future__ import annotations

import math

import numpy as np

from kernelcache import njit
from ronnaplan.geometry import FloatArray
from ronnaplan.localization.fit.ball import discs
from ronnaplan.localization.fit.model import evaluate, has_layer
from ronnaplan.localization.fit.parameters import BACKGROUND, CENTER, LAYER_PARAMETERS, PARAMETERS, SLOPES, W

HEIGHTS, RADII = 16, 40
"""The streaks are worked out at so many heights above the center and distances from the axis."""

THIRD, FIFTH, ACROSS_SLICES = range(3)
"""Streaks of the third and the fifth harmonic within the slices, and of the second across them."""


def streaks(theta: FloatArray, layer_mm: float, offsets_mm: FloatArray) -> FloatArray:
    """What 1 mm of each harmonic adds (N, 3) beside the displaced edges, HU, at ``offsets_mm`` (N, 3) from the center.

    As large as it is along the harmonic's own cosine.
    """
    ball = theta[: len(PARAMETERS) + len(LAYER_PARAMETERS) * has_layer(theta)].copy()
    ball[BACKGROUND], ball[CENTER], ball[SLOPES] = 0.0, 0.0, 0.0
    top_mm = float(np.abs(offsets_mm[:, W]).max(initial=1.0))
    rim_mm = float(np.hypot(offsets_mm[:, 0], offsets_mm[:, 1]).max(initial=1.0))
    heights, radii = np.linspace(0.0, top_mm, HEIGHTS), np.linspace(0.0, rim_mm, RADII)
    places = np.zeros((HEIGHTS, RADII, 3))
    places[..., 0], places[..., W] = radii, heights[:, np.newaxis]
    values, jacobian = evaluate(places.reshape(-1, 3), ball, layer_mm, *discs(ball))
    table = _table(values.reshape(HEIGHTS, RADII), jacobian[:, W].reshape(HEIGHTS, RADII), radii)
    return _looked_up(table, top_mm / (HEIGHTS - 1), rim_mm / (RADII - 1), offsets_mm)


def _table(ball: FloatArray, by_w: FloatArray, radii: FloatArray) -> FloatArray:
    """Return the streaks (H, S, 3) of a ``ball`` (H, S) and of its derivative, from their moments within ``radii``."""
    with np.errstate(invalid="ignore"):
        mean, fourth = _within(ball, radii, 2), _within(ball, radii, 4)
        third = -4.0 * (mean - ball) / radii
        fifth = (24.0 * (mean - fourth) - 12.0 * (mean - ball)) / radii
        across = -_within(by_w, radii, 2)
    table = np.stack([third, fifth, across], axis=-1)
    table[:, 0, :ACROSS_SLICES], table[:, 0, ACROSS_SLICES] = 0.0, -by_w[:, 0]
    return table


def _within(values: FloatArray, radii: FloatArray, power: int) -> FloatArray:
    """Mean of ``values`` (H, S) within each of ``radii`` (S,), weighed by ``power - 2`` powers of the distance."""
    shells = np.diff(radii**power)
    sums = np.cumsum((values[:, 1:] + values[:, :-1]) / 2.0 * shells, axis=1)
    return np.pad(sums, ((0, 0), (1, 0))) / radii**power


@njit(cache=True, error_model="numpy", nogil=True)
def _looked_up(table: FloatArray, height_step: float, radius_step: float, offsets: FloatArray) -> FloatArray:
    """Interpolate the ``table`` at ``offsets`` (N, 3); what is across the slices is odd in the height."""
    found = np.empty((len(offsets), 3))
    for n in range(len(offsets)):
        h, s = abs(offsets[n, W]) / height_step, math.hypot(offsets[n, 0], offsets[n, 1]) / radius_step
        i, j = min(int(h), HEIGHTS - 2), min(int(s), RADII - 2)
        a, b = h - i, s - j
        for p in range(3):
            low = table[i, j, p] + b * (table[i, j + 1, p] - table[i, j, p])
            high = table[i + 1, j, p] + b * (table[i + 1, j + 1, p] - table[i + 1, j, p])
            found[n, p] = low + a * (high - low)
        if offsets[n, W] < 0.0:
            found[n, ACROSS_SLICES] = -found[n, ACROSS_SLICES]
    return found
