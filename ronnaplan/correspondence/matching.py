"""`match_points`: the exact matcher, from raw points to an accepted pairing or a refusal with its rivals.

1. Points, their errors and what was told of them are checked (`inputs`, `told`) and make the `problem`.
2. Of small sets (`small`) every pairing whose distances agree (`graph`) is listed (`exact`) and weighed (`evidence`,
   `priors`, `anisotropic`); the best has to stand against mirror images, other orders (`rivals`) and other bodies
   (`another_body`).
3. Of others (`large`) poses are sought (`poses`) by triangles of the same sides (`seeds`, `lookup`), tried on other
   points (`trials`), fitted (`refining`) and weighed (`weighing`); the best has to stand against second `bodies` and
   mirror images, and each of its pairs against `chance` (`densities`) and `strays`.

`layout` tells before measuring how distinguishable markers are, `similarity` is the published algorithm, and `many`
matches small sets by the thousand.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Iterable
from dataclasses import replace
from numbers import Real

import numpy as np
from numpy.typing import ArrayLike

from ronnaplan.bounds import FARTHEST_POINT_MM
from ronnaplan.correspondence.evidence import filled_volume
from ronnaplan.correspondence.inputs import (
    check_probability,
    checked_errors,
    checked_known,
    checked_points,
    checked_told,
)
from ronnaplan.correspondence.large import match_large
from ronnaplan.correspondence.pairing import LEAST_PROBABILITY, LEFT_HANDED, Pairing
from ronnaplan.correspondence.priors import SPREAD_MM
from ronnaplan.correspondence.problem import Problem
from ronnaplan.correspondence.small import match_small
from ronnaplan.errors import InputError, check_type
from ronnaplan.sigmas import SIGMA_CT_MM, SIGMA_OTS_MM

LOG = logging.getLogger(__name__)

MOST_LISTED_POINTS = 16
FEW_POINTS = 6
MOST_NODES = 1600
"""Every pairing is listed, if that is soon done, of two sets of up to `MOST_LISTED_POINTS`, or of up to `FEW_POINTS`
against more, with `MOST_NODES` pairs of points at most. Of larger sets, or more regular ones, every pose is sought."""

SMALL_MM = 30.0
"""Markers on a head spread over 100 mm and more along some axis, 300 at most: where both sets are refused and spread
over less than this along each, it is said that they may be in cm."""

OR_CENTIMETRES = f"both sets spread over less than {SMALL_MM:g} mm: if they are in cm, convert them to millimetres"


def match_points(
    ct_points: ArrayLike,
    ots_points: ArrayLike,
    expected: int | None = None,
    sigma_ct_mm: ArrayLike = SIGMA_CT_MM,
    sigma_ots_mm: ArrayLike = SIGMA_OTS_MM,
    *,
    covariances_ct_mm2: ArrayLike | None = None,
    covariances_ots_mm2: ArrayLike | None = None,
    known_pairs: Iterable[tuple[int, int]] = (),
    at_least: int | None = None,
    least_probability: float = LEAST_PROBABILITY,
    field_radius_mm: float | None = None,
    spread_mm: float = SPREAD_MM,
) -> Pairing:
    """Pair CT points with tracker points, unordered, with outliers in both sets; be right or refuse.

    Parameters
    ----------
    ct_points, ots_points
        (n, 3) and (m, 3) in mm, each in its own frame.
    expected
        The number of markers that both sets should hold; None: inferred.  It is evidence, not a fact: a few markers
        less are given when these were knocked, misread or missed (see `told.UNUSABLE_MARKER`), more are refused.
    sigma_ct_mm, sigma_ots_mm
        Standard deviations per axis, one for all points or one a point.
    covariances_ct_mm2, covariances_ots_mm2
        (3, 3) for all points or one a point, (n, 3, 3) and (m, 3, 3), each in its own frame; they replace the sigma
        of that set.
    known_pairs
        (CT index, OTS index) of markers that were pointed at; every considered pairing holds them.
    at_least
        The number of markers that both sets hold at least; instead of ``expected``.
    least_probability
        The posterior at which a pairing is accepted, see `LEAST_PROBABILITY`; 0.9999 for a guarantee on each
        answer.
    field_radius_mm
        Outliers are uniform in a ball of this radius (their density); None: in one as wide as the sets themselves.
    spread_mm
        Standard deviation per axis of the markers about their center: 60 mm for a head.

    Returns
    -------
    Pairing
        The pairs, where its ``status`` is ``unique``; else none, and why, with the pairings that rival each other.

    Raises
    ------
    InputError
        For fewer than three points or more than 10,000, wrong shapes, NaN, units that cannot be mm, errors that are
        not positive, an expected number that is none of markers, or known pairs that name no points.

    """
    ct, ots = checked_points(ct_points, "CT points"), checked_points(ots_points, "OTS points")
    counts = (len(ct), len(ots))
    _check_settings(least_probability, field_radius_mm, spread_mm)
    problem = Problem(
        ct,
        ots,
        checked_errors(sigma_ct_mm, covariances_ct_mm2, len(ct), "CT points"),
        checked_errors(sigma_ots_mm, covariances_ots_mm2, len(ots), "OTS points"),
        checked_told(expected, at_least),
        checked_known(known_pairs, counts),
        filled_volume(ct, ots) if field_radius_mm is None else 4.0 / 3.0 * math.pi * field_radius_mm**3,
        spread_mm,
    )
    listed = is_small(counts)
    answer = match_small(problem, least_probability) if listed else None
    if answer is None:  # too large to be listed, or too regular
        answer = match_large(problem, least_probability)
        if listed and answer.status == "unmatched" and not answer.rivals and answer.reason != LEFT_HANDED:
            answer = _not_listed(problem)
    if answer.status != "unique" and max(float(np.ptp(points, axis=0).max()) for points in (ct, ots)) < SMALL_MM:
        answer = replace(answer, reason=f"{answer.reason}; {OR_CENTIMETRES}")
    LOG.info("paired %d CT with %d tracker points: %r", *counts, answer)
    for rival in answer.rivals:
        LOG.debug("a rival %.1f nats below: %s", rival.log_evidence_below, rival.pairs.tolist())
    return answer


def _not_listed(problem: Problem) -> Pairing:
    """Return the refusal of small sets that fit in too many ways, where no pose tells more."""
    reason = (
        f"too many pairings of {len(problem.ct)} CT points with {len(problem.ots)} readings fit almost equally "
        "well to list them all; have more of the markers read, or state pairs that are known"
    )
    return Pairing.ambiguous(reason)


def _check_settings(least_probability: float, field_radius_mm: float | None, spread_mm: float) -> None:
    check_probability(least_probability)
    check_type(spread_mm, Real, "spread_mm", "give a number")
    check_type(field_radius_mm, (Real, type(None)), "field_radius_mm", "give a number")
    field_is_sound = field_radius_mm is None or 0 < field_radius_mm <= FARTHEST_POINT_MM
    if not (field_is_sound and spread_mm > 0):
        raise InputError(
            f"field_radius_mm {field_radius_mm}, spread_mm {spread_mm}: expected positive lengths, the field's "
            f"{FARTHEST_POINT_MM:g} mm at most"
        )


def is_small(counts: tuple[int, int]) -> bool:
    """Tell whether every pairing of sets of these sizes can be listed, if they are not too regular."""
    few = min(counts) <= FEW_POINTS and counts[0] * counts[1] <= MOST_NODES
    return max(counts) <= MOST_LISTED_POINTS or few
