"""The bent quadric between voxel centers inside and outside a label that leaves them on their sides.

A quadric is the zero set of a polynomial of second order; planes, spheres, ellipsoids and straight tubes are
quadrics. Bending it along its axis by a circle makes tori of straight tubes.
"""

from __future__ import annotations

import numpy as np

from ronnaplan.geometry import FloatArray
from ronnaplan.minimize import minimize

PARAMETERS = 12
"""Ten coefficients (1, x, y, z, xx, yy, zz, xy, xz, yz) and the two curvatures of the bend, towards x and y."""

COEFFICIENTS, BEND = slice(0, 10), slice(10, PARAMETERS)
"""Their places among the parameters."""

PRIOR = np.array([100.0] * 4 + [5.0] * 6 + [0.25] * 2)
"""Usual size of the parameters; lengths in units of the window's radius."""

MOST_STEPS = 100
FIRST_DAMPING = 1e-3
"""Of a fit: its steps at most, and the damping of the first one."""

LEAST_NATS = 1e-3
"""A fit ends when the next step promises less, in the log of the chance."""

FLAT = 1e-4
"""Added to the squared gradient, so that a distance stays finite where the polynomial is flat."""


def evaluate(parameters: FloatArray, points: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return of ``points`` (N, 3) the signed distances (N,), negative inside, and their derivatives.

    The distance is the polynomial over the length of its gradient (Taubin 1991): right to first order, and blind
    to the polynomial's scale. The derivatives are by the parameters (N, 12) and by the unbent place (N, 3).
    """
    bend = parameters[BEND]
    x, y, z = points.T
    # Polar angle and radius about the center of the bend, by the half angle: regular where nothing is bent.
    a = 1.0 - bend[0] * x - bend[1] * y
    g = np.sqrt(a * a + (bend @ bend) * z * z) + 1e-12
    d = a + g
    sag = z * z / d
    u, v, w = x - bend[0] * sag, y - bend[1] * sag, 2.0 * z / d
    terms = np.stack(_monomials(u, v, w))
    value, slope = parameters[COEFFICIENTS] @ terms, _slope(parameters, u, v, w)
    square = (slope**2).sum(axis=0) + FLAT
    length = np.sqrt(square)
    turn = _turn(slope, u, v, w)
    jacobian = np.empty((PARAMETERS, len(points)))
    jacobian[COEFFICIENTS] = (terms - value / square * turn) / length
    along = (bend @ slope[:2]) * sag - slope[2] * w
    for n, place in enumerate((x, y)):
        jacobian[BEND.start + n] = (
            along * ((bend[n] * z * z - a * place) / g - place) / d - slope[n] * sag
        ) / length
    return value / length, jacobian.T, (slope / length).T


def fit(local: FloatArray, sides: FloatArray, guess: FloatArray, blur: float) -> tuple[FloatArray, FloatArray]:
    """Return axes (3, 3) as rows and, along them, the most probable parameters (12,).

    ``local`` (N, 3) are centers in units of the window's radius, ``sides`` (N,) -1 inside and 1 outside, ``guess``
    (N,) rough signed distances, ``blur`` the width of the probit, all in those units.
    """
    axes = _axes(_polynomial(local, guess))
    local = local @ axes.T
    first = np.concatenate([_polynomial(local, guess), [0.0, 0.0]])
    return axes, _solve(first, local, sides, blur)


def _axes(polynomial: FloatArray) -> FloatArray:
    """Return rows x, y, z with z along the axis of a quadric (10,): where it is curved least."""
    _, _, _, _, xx, yy, zz, xy, xz, yz = polynomial
    sizes, ways = np.linalg.eigh(np.array([[2 * xx, xy, xz], [xy, 2 * yy, yz], [xz, yz, 2 * zz]]))
    least = int(np.abs(sizes).argmin())
    axes: FloatArray = ways.T[[(least + 1) % 3, (least + 2) % 3, least]]
    return axes


def _polynomial(local: FloatArray, distances: FloatArray) -> FloatArray:
    """Return the polynomial (10,) that comes nearest to ``distances`` (N,) at ``local`` (N, 3)."""
    found = np.linalg.lstsq(np.column_stack(_monomials(*local.T)), distances, rcond=None)[0]
    return np.asarray(found, dtype=np.float64)


def _solve(parameters: FloatArray, local: FloatArray, sides: FloatArray, blur: float) -> FloatArray:
    """Return the most probable parameters (12,)."""

    def equations(tried: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        values, jacobian, _ = evaluate(tried, local)
        unlikely, slopes, weights = _unlikelihood(values, sides, blur)
        gradient = jacobian.T @ slopes + tried / PRIOR**2
        hessian = (jacobian.T * weights) @ jacobian + np.diag(PRIOR**-2)
        return unlikely + 0.5 * float(((tried / PRIOR) ** 2).sum()), -gradient, hessian

    found = minimize(
        equations,
        parameters,
        lambda _step, promise, _cost: promise < LEAST_NATS,
        most_steps=MOST_STEPS,
        damping=FIRST_DAMPING,
    )
    return found.place


def _monomials(x: FloatArray, y: FloatArray, z: FloatArray) -> list[FloatArray]:
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


def _unlikelihood(values: FloatArray, sides: FloatArray, blur: float) -> tuple[float, FloatArray, FloatArray]:
    """Return minus the log of the chance of ``sides`` (N,; -1 inside, 1 outside) under a probit of width ``blur``.

    With it its first and second derivatives (N,) by ``values`` (N,).
    """
    from scipy.special import log_ndtr

    z = sides * values / blur
    logs = log_ndtr(z)
    mills = np.exp(-0.5 * z * z - logs) / np.sqrt(2.0 * np.pi)
    return -float(logs.sum()), -sides * mills / blur, np.maximum(mills * (z + mills), 0.0) / blur**2
