"""A bent quadric between voxel centres inside and outside a label: the compiled inner loops of `smooth`.

A quadric is the zero set of a polynomial of second order; planes, spheres, ellipsoids and straight tubes are
quadrics. Bending it along its axis by a circle makes tori of straight tubes.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

PARAMETERS = 12
"""Ten coefficients (1, x, y, z, xx, yy, zz, xy, xz, yz) and the two curvatures of the bend, towards x and y."""


@njit(cache=True, nogil=True, error_model="numpy")
def evaluate(parameters, points, values, jacobian, gradients):  # type: ignore[no-untyped-def]
    """Fill for each of ``points`` (N, 3) its signed distance (N,), negative inside, and derivatives.

    The distance is the polynomial over the length of its gradient (Taubin 1991): right to first order, and blind
    to the polynomial's scale. ``jacobian`` (N, 12) is by the parameters, ``gradients`` (N, 3) by the unbent place.
    """
    bend_x, bend_y = parameters[10], parameters[11]
    terms, slopes = np.empty(10), np.zeros((10, 3))
    for n in range(len(points)):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        # Polar angle and radius about the centre of the bend, by the half angle: regular where nothing is bent.
        a = 1.0 - bend_x * x - bend_y * y
        g = math.sqrt(a * a + (bend_x**2 + bend_y**2) * z * z) + 1e-12
        d = a + g
        sag = z * z / d
        u, v, w = x - bend_x * sag, y - bend_y * sag, 2.0 * z / d
        _terms(u, v, w, terms, slopes)
        value, slope_u, slope_v, slope_w = 0.0, 0.0, 0.0, 0.0
        for k in range(10):
            value += parameters[k] * terms[k]
            slope_u += parameters[k] * slopes[k, 0]
            slope_v += parameters[k] * slopes[k, 1]
            slope_w += parameters[k] * slopes[k, 2]
        square = slope_u**2 + slope_v**2 + slope_w**2 + 1e-4
        length = math.sqrt(square)
        values[n] = value / length
        gradients[n, 0], gradients[n, 1], gradients[n, 2] = slope_u / length, slope_v / length, slope_w / length
        for k in range(10):
            turn = slope_u * slopes[k, 0] + slope_v * slopes[k, 1] + slope_w * slopes[k, 2]
            jacobian[n, k] = (terms[k] - value * turn / square) / length
        along = slope_u * bend_x * sag + slope_v * bend_y * sag - slope_w * w
        d_x = -x + (bend_x * z * z - a * x) / g
        d_y = -y + (bend_y * z * z - a * y) / g
        jacobian[n, 10] = (-slope_u * sag + along * d_x / d) / length
        jacobian[n, 11] = (-slope_v * sag + along * d_y / d) / length


@njit(cache=True, nogil=True, error_model="numpy")
def _terms(u, v, w, terms, slopes):  # type: ignore[no-untyped-def]
    terms[0], terms[1], terms[2], terms[3] = 1.0, u, v, w
    terms[4], terms[5], terms[6] = u * u, v * v, w * w
    terms[7], terms[8], terms[9] = u * v, u * w, v * w
    slopes[1, 0], slopes[2, 1], slopes[3, 2] = 1.0, 1.0, 1.0
    slopes[4, 0], slopes[5, 1], slopes[6, 2] = 2.0 * u, 2.0 * v, 2.0 * w
    slopes[7, 0], slopes[7, 1] = v, u
    slopes[8, 0], slopes[8, 2] = w, u
    slopes[9, 1], slopes[9, 2] = w, v


@njit(cache=True, nogil=True, error_model="numpy")
def penalty(values, sides, blur, weights, slopes):  # type: ignore[no-untyped-def]
    """Return minus the log of the chance of ``sides`` (N,; -1 inside, 1 outside) under a probit of width ``blur``.

    Fills its first (``slopes``) and second (``weights``) derivatives by ``values`` (N,).
    """
    total = 0.0
    for n in range(len(values)):
        z = sides[n] * values[n] / blur
        if z > -5.0:
            share = 0.5 * math.erfc(-z / math.sqrt(2.0))
            mills = math.exp(-0.5 * z * z) / math.sqrt(2.0 * math.pi) / share
            total -= math.log(share)
        else:
            mills = -z - 1.0 / z
            total += 0.5 * z * z + math.log(-z * math.sqrt(2.0 * math.pi))
        slopes[n] = -sides[n] * mills / blur
        weights[n] = max(mills * (z + mills), 0.0) / blur**2
    return total
