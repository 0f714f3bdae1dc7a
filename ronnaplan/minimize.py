"""Least squares and likelihoods of a few parameters: damped Gauss-Newton steps (Levenberg and Marquardt).

The one such loop of the house but for the localizer's: its parameters have bounds that they may stand at, and a fit
that wanders off its candidate is given up on the way, so it has a loop of its own (`localization.fit.descent`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ronnaplan.geometry import FloatArray

Equations = Callable[[FloatArray], tuple[FloatArray | float, FloatArray, FloatArray]]
"""Of a place: its cost (...), minus the cost's gradient (..., P), and its curvature (..., P, P)."""

DAMPING = 1e-2
"""Added to the curvature's diagonal, as a share of it, after the first step that would raise the cost; ten times more
after each further one, ten times less after one that did not."""

ROUND_OFF = 1e-12
"""A cost that rises by no more, as a share and at all, has not risen."""


@dataclass(frozen=True, eq=False)
class Minimum:
    """Where a cost is least, and its ``cost`` (...) and ``curvature`` (..., P, P) there.

    ``settled`` (...) tells whether the steps came to rest.
    """

    place: FloatArray
    cost: FloatArray
    curvature: FloatArray
    settled: NDArray[np.bool_]


def minimize(
    equations: Equations,
    start: FloatArray,
    at_rest: Callable[[FloatArray, FloatArray, FloatArray], NDArray[np.bool_]],
    *,
    most_steps: int,
    moved: Callable[[FloatArray, FloatArray], FloatArray] = np.add,
    damping: float = 0.0,
) -> Minimum:
    """Descend from ``start`` (..., axes of one place) until every one of the stack is at rest.

    Leading axes ``...``, as those of the cost, are independent problems. ``moved`` takes a step (..., P) from a place;
    ``at_rest(step, promise, cost)`` tells which ones need not go on: ``promise`` (...) is twice what the step gains
    where the cost is a parabola. ``damping`` is that of the first step.
    """
    place = start
    cost, descent, curvature = _stacked(equations(place))
    dampings, settled = np.full(cost.shape, damping), np.zeros(cost.shape, dtype=np.bool_)
    for _ in range(most_steps):
        diagonal = curvature * np.eye(curvature.shape[-1])
        damped = curvature + dampings[..., None, None] * diagonal
        step = _solved(damped, descent)
        settled |= at_rest(step, (step * descent).sum(axis=-1), cost)
        if settled.all():
            break
        trial = moved(place, step)
        there, ahead, bend = _stacked(equations(trial))
        better = there <= cost * (1.0 + ROUND_OFF) + ROUND_OFF
        place = np.where(_like(better, trial), trial, place)
        cost, descent = np.where(better, there, cost), np.where(better[..., None], ahead, descent)
        curvature = np.where(better[..., None, None], bend, curvature)
        dampings = np.where(better, dampings / 10.0, np.maximum(10.0 * dampings, DAMPING))
    return Minimum(place, cost, curvature, settled)


def _solved(damped: FloatArray, descent: FloatArray) -> FloatArray:
    """Return the step (..., P); where the cost does not tell a direction (points on a line), there is none along it."""
    try:
        step = np.linalg.solve(damped, descent[..., None])
    except np.linalg.LinAlgError:
        step = np.linalg.pinv(damped, hermitian=True) @ descent[..., None]
    return np.asarray(step[..., 0], dtype=np.float64)


def _stacked(
    found: tuple[FloatArray | float, FloatArray, FloatArray],
) -> tuple[FloatArray, FloatArray, FloatArray]:
    return np.asarray(found[0], dtype=np.float64), found[1], found[2]


def _like(flags: NDArray[np.bool_], places: FloatArray) -> NDArray[np.bool_]:
    """Return ``flags`` (...) with further axes, so that each counts for the whole of its place."""
    return flags.reshape(flags.shape + (1,) * (places.ndim - flags.ndim))
