"""A disc behind a Gaussian blur: what share of it a place sees, and how that changes, in a table.

A disc blurred by a circular Gaussian is a non-central chi-square probability with two degrees of freedom (Marcum's Q
function, J. Marcum, IRE Trans. IT-6, 1960). It and its derivatives are integrals over half the disc's rim, where they
are smooth, so that a Gauss sum over the part that the blur reaches tells them to twelve digits. SciPy has these
functions, too, but takes ten times as long to load as the table to make.
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np

from kernelcache import njit
from ronnaplan.geometry import FloatArray
from ronnaplan.threads import in_parts

EDGE_REACH = 5.0
"""Distance from the edge, in units of sigma, beyond which a blurred disc is 0 or 1 to within 1e-6."""

EDGE_STEPS = 200
CURVATURE_STEPS = 128
"""Steps of the table over the distance from the edge, and over its curvature."""
COLUMNS = 8
"""Seven of the disc's figures, and one to fill up a line of the processor's cache."""

RIM_NODES, RIM_REACH = 24, 8.5
"""So many places on the rim tell its integrals, out to so many sigma along it, where the blur is 1e-16."""


@cache
def disc_table() -> FloatArray:
    """Tabulate the blurred unit disc and its derivatives over (curvature, signed edge distance), in units of sigma.

    Row m holds radius position r = 2 / t - 2 with t = m / steps (so that row 0 is the straight edge), column n
    the distance a - r of the disc's edge from -`EDGE_REACH` to `EDGE_REACH`. The last axis (of 8) has the disc D, its
    derivative by a over a, by r, and along both, E = a D_a + r D_r, which is what the edge parameter adds; then E's
    derivatives in the same order.
    """
    table = np.zeros((CURVATURE_STEPS + 1, EDGE_STEPS + 1, COLUMNS))
    nodes, weights = np.polynomial.legendre.leggauss(RIM_NODES)
    rim = (nodes + 1.0) / 2.0, weights / 2.0
    in_parts(lambda first, end: _fill(table[first:end], first, *rim), len(table))
    return table


@njit(cache=True, nogil=True)
def _fill(rows: FloatArray, first: int, nodes: FloatArray, weights: FloatArray) -> None:
    for m in range(len(rows)):
        for n in range(EDGE_STEPS + 1):
            distance = EDGE_REACH * (2.0 * n / EDGE_STEPS - 1.0)
            if first + m == 0:
                _fill_straight(rows[m, n], distance)
            else:
                r = 2.0 * CURVATURE_STEPS / (first + m) - 2.0
                _fill_curved(rows[m, n], max(r + distance, 0.0), r, nodes, weights)


@njit(cache=True, nogil=True)
def _fill_straight(told: FloatArray, distance: float) -> None:
    normal = math.exp(-0.5 * distance * distance) / math.sqrt(2.0 * math.pi)
    turned = (1.0 - distance * distance) * normal
    told[0], told[2], told[3] = share_below(distance), -normal, distance * normal
    told[5], told[6] = -turned, distance * turned


@njit(cache=True, nogil=True)
def _fill_curved(told: FloatArray, a: float, r: float, nodes: FloatArray, weights: FloatArray) -> None:
    """Fill ``told`` with the figures of a disc of radius ``a``, seen from ``r`` beside its center.

    Over the rim's angle, 0 where it is nearest: the blur's density times 1 and the cosine (which are Bessel functions,
    scaled), and what is seen along the line across the disc there.
    """
    z, square, i0, i1, disc = r * a, a * a + r * r, 0.0, 0.0, 0.0
    far = 2.0 * math.asin(min(0.5 * RIM_REACH / max(math.sqrt(z), 1e-9), 1.0))
    half = math.asin(min(RIM_REACH / max(a, 1e-9), 1.0))
    for k in range(len(nodes)):
        sine = math.sin(0.5 * far * nodes[k])
        density = weights[k] * far / math.pi * math.exp(-0.5 * (a - r) ** 2 - 2.0 * z * sine * sine)
        i0 += density
        i1 += density * (1.0 - 2.0 * sine * sine)
        up, across = a * math.sin(half * nodes[k]), a * math.cos(half * nodes[k])
        seen = share_below(across - r) - share_below(-across - r)
        disc += 2.0 * weights[k] * half * across * seen * math.exp(-0.5 * up * up) / math.sqrt(2.0 * math.pi)
    along_by_a = (2.0 - square) * i0 + 2.0 * z * i1
    along_by_r = a * (square * i1 - 2.0 * z * i0)
    told[0], told[1], told[2], told[3] = disc, i0, -a * i1, a * a * i0 - z * i1
    told[4], told[5], told[6] = along_by_a, along_by_r, a * a * along_by_a + r * along_by_r


@njit(cache=True, nogil=True)
def share_below(x: float) -> float:
    """Return the share of a normal distribution that lies below ``x``."""
    return 0.5 * math.erfc(-x * math.sqrt(0.5))
