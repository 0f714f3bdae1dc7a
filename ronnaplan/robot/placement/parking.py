"""How likely the robot, parked by hand near the place that was chosen, still serves everything."""

from __future__ import annotations

import numpy as np

from ronnaplan.geometry import FloatArray
from ronnaplan.robot.placement.room import Parking
from ronnaplan.robot.placement.search import Problem, serves

SAMPLES = 512
"""Of a Sobol sequence: in 13 places told within 1.1 percentage points of what eight times as many tell."""


def probability(
    problem: Problem, closer: Problem, place: FloatArray, parking: Parking, *, samples: int = SAMPLES
) -> float:
    """Return the share of true places about ``place`` (4,) from which all tasks are served.

    After parking, the base is measured and rolls and postures are chosen anew, as closely as then: the same tasks are
    asked of ``closer``, with more rolls, where ``problem`` finds none. Errors are normal and independent in x, y and
    turn, which the base makes about its own origin.
    """
    places = strayed(place, parking, samples)
    served = serves(problem, places)
    served[~served] = serves(closer, places[~served])
    return float(served.mean())


def strayed(place: FloatArray, parking: Parking, samples: int) -> FloatArray:
    """Return ``samples`` places (N, 4) where the robot may come to stand, evenly spread by their probability."""
    from scipy.stats.qmc import MultivariateNormalQMC

    spread = np.diag([parking.sigma_mm**2, parking.sigma_mm**2, parking.sigma_deg**2])
    errors = MultivariateNormalQMC(np.zeros(3), spread, rng=np.random.default_rng(0)).random(samples)
    moved = np.tile(place, (samples, 1))
    moved[:, [0, 1, 3]] += errors
    return moved
