"""A bent quadric between voxel centres inside and outside a label.

A quadric is the zero set of a polynomial of second order; planes, spheres, ellipsoids and straight tubes are
quadrics. Bending it along its axis by a circle makes tori of straight tubes.
"""

from __future__ import annotations

import numpy as np

from ronnaplan.geometry import FloatArray

PARAMETERS = 12
"""Ten coefficients (1, x, y, z, xx, yy, zz, xy, xz, yz) and the two curvatures of the bend, towards x and y."""

FLAT = 1e-4
"""Added to the squared gradient, so that a distance stays finite where the polynomial is flat."""


def evaluate(parameters: FloatArray, points: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return of ``points`` (N, 3) the signed distances (N,), negative inside, and their derivatives.

    The distance is the polynomial over the length of its gradient (Taubin 1991): right to first order, and blind
    to the polynomial's scale. The derivatives are by the parameters (N, 12) and by the unbent place (N, 3).
    """
    bend = parameters[10:]
    x, y, z = points.T
    # Polar angle and radius about the centre of the bend, by the half angle: regular where nothing is bent.
    a = 1.0 - bend[0] * x - bend[1] * y
    g = np.sqrt(a * a + (bend @ bend) * z * z) + 1e-12
    d = a + g
    sag = z * z / d
    u, v, w = x - bend[0] * sag, y - bend[1] * sag, 2.0 * z / d
    terms = np.stack(monomials(u, v, w))
    value, slope = parameters[:10] @ terms, _slope(parameters, u, v, w)
    square = (slope**2).sum(axis=0) + FLAT
    length = np.sqrt(square)
    turn = _turn(slope, u, v, w)
    jacobian = np.empty((PARAMETERS, len(points)))
    jacobian[:10] = (terms - value / square * turn) / length
    along = (bend @ slope[:2]) * sag - slope[2] * w
    for n, place in enumerate((x, y)):
        jacobian[10 + n] = (along * ((bend[n] * z * z - a * place) / g - place) / d - slope[n] * sag) / length
    return value / length, jacobian.T, (slope / length).T


def monomials(x: FloatArray, y: FloatArray, z: FloatArray) -> list[FloatArray]:
    """Return the ten terms (N,) of a polynomial of second order."""
    return [np.ones_like(x), x, y, z, x * x, y * y, z * z, x * y, x * z, y * z]


def _slope(parameters: FloatArray, x: FloatArray, y: FloatArray, z: FloatArray) -> FloatArray:
    """Return the gradient (3, N) of the polynomial."""
    _, p_x, p_y, p_z, xx, yy, zz, xy, xz, yz, *_ = parameters
    return np.stack(
        [
            p_x + 2.0 * xx * x + xy * y + xz * z,
            p_y + 2.0 * yy * y + xy * x + yz * z,
            p_z + 2.0 * zz * z + xz * x + yz * y,
        ]
    )


def _turn(slope: FloatArray, x: FloatArray, y: FloatArray, z: FloatArray) -> FloatArray:
    """Return the slope (10, N) of each term along the gradient ``slope`` (3, N) of the polynomial."""
    p, q, r = slope
    rows = [
        np.zeros_like(x),
        p,
        q,
        r,
        2.0 * p * x,
        2.0 * q * y,
        2.0 * r * z,
        p * y + q * x,
        p * z + r * x,
        q * z + r * y,
    ]
    return np.stack(rows)


def unlikelihood(values: FloatArray, sides: FloatArray, blur: float) -> tuple[float, FloatArray, FloatArray]:
    """Return minus the log of the chance of ``sides`` (N,; -1 inside, 1 outside) under a probit of width ``blur``.

    With it its first and second derivatives (N,) by ``values`` (N,).
    """
    from scipy.special import log_ndtr

    z = sides * values / blur
    logs = log_ndtr(z)
    mills = np.exp(-0.5 * z * z - logs) / np.sqrt(2.0 * np.pi)
    return -float(logs.sum()), -sides * mills / blur, np.maximum(mills * (z + mills), 0.0) / blur**2
