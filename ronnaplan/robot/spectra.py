"""How noise that has a memory is spread over the frequencies of a recording: the family that `memory` weighs."""

from __future__ import annotations

from collections.abc import Sized
from functools import lru_cache

import numpy as np

from ronnaplan.geometry import FloatArray

WHITE_SHARES = (0.0, 0.01, 0.1, 0.3, 0.6)
MEMORIES = 16
"""Lengths of memory that are tried, from one pose to the whole recording."""
FILTER_MEMORY = 0.03
"""A filter's memory, and that of noise beside a steady drift, is at most so much of the recording: what is as smooth
and lasts longer is a steady drift, what wanders beside one is a walk."""
FILTER_POSES = 10
"""However short a recording is, a filter may remember so many poses: a second or less, as trackers report them."""
DRIFT_PRIOR = 0.1
"""Steady drifts are the rarer thing: a walk's first half-wave looks like one, and a walk's level errs far more."""
FIELD_MEMORIES = 3
"""So many memories, from one pose to those of a filter, are tried beside a field of errors by the robot's pose."""


@lru_cache(maxsize=4)
def spectra(count: int, drifting: bool) -> FloatArray:
    """Return the family's variances (M, count), one for each frequency, of mean one; white noise first.

    Beside a steady drift memories are short. All kinds of noise ask for the same ones; not to be written to.
    """
    short = FILTER_MEMORY * count
    longest, of_filter = (short, short) if drifting else (count, max(short, FILTER_POSES))
    family = [np.ones(count)]
    for memory in np.geomspace(1.0, count, MEMORIES):
        for order, limit in ((1, longest), (2, of_filter)):
            if memory > max(1.0, limit):
                continue
            with_memory = _remembering(memory, order, count)
            family += [white + (1 - white) * with_memory for white in WHITE_SHARES]
    variances = np.array(family)
    variances.setflags(write=False)
    return variances


def beside_a_field(count: int) -> list[FloatArray]:
    """Return the variances (count,) of what may lie beside a field of errors, of mean one; white noise first."""
    memories = np.geomspace(1.0, FILTER_POSES, FIELD_MEMORIES)
    return [np.ones(count), *(_remembering(memory, 1, count) for memory in memories)]


def log_priors(family: Sized) -> FloatArray:
    """Return how likely each of a ``family`` of M is beforehand (M,): white noise, the first, as all with a memory."""
    priors = np.zeros(len(family))
    priors[1:] -= np.log(len(family) - 1)
    return priors


def log_prior_of_drift(drifting: bool) -> float:
    """Return how likely a steady drift is beforehand, or that there is none."""
    return float(np.log(DRIFT_PRIOR if drifting else 1 - DRIFT_PRIOR))


def _remembering(memory: float, order: int, count: int) -> FloatArray:
    """Return the variances (count,), of mean one, of noise that remembers so many poses."""
    frequency = 2 * np.sin(np.pi * np.arange(count) / (2 * count))
    variances: FloatArray = (memory**-2 + frequency**2) ** -float(order)
    variances /= variances.mean()
    return variances
