"""Errors that depend on the robot's pose: joints whose zero is off, links that bend, a tracker that errs by place.

No number of poses averages them out, and most of such an error looks like another pose of base or tool: little of it
is left. So they are taken for a field over the poses, of which what is left tells how large it is; what it does to the
estimate follows. As every other kind of noise a field is weighed by its restricted likelihood (`memory`), beside noise
in the tracker's axes or the tool's that is alike in all directions or not: beside the wrong noise it would lose to the
right one without a field. So it would beside steadiness where the tracker drifts. There are four:

- of any cause: its six components are linear in the numbers of the robot's pose, all of one variance;
- of an arm that bends, or whose lengths are off: in its upright plane, linear in how far out and how high it reaches.
  That has few numbers, which tell sooner that there is something. How far such errors go is told by the first kind;
- of a tracker whose distances are all wrong by one share (or of a robot's that are);
- of a tracker, or a robot, that is late: what it adds goes with how fast the tool moves.

Late poses are often wrong by place, too: where a delay is likelier than the others these are weighed beside it as well.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from enum import StrEnum
from itertools import product
from typing import NamedTuple

import numpy as np

from ronnaplan.geometry import FloatArray
from ronnaplan.robot.spectra import DRIFT_PROBABILITY, beside_a_field

SHARES = (1.0, 10.0, 100.0)
"""Variances of the field, in those of the noise beside it: some hundredths of it are left."""
ONE_CAUSE = 0.1
"""So likely beforehand is each of the fields that have one cause, in parts of that which may have any."""
ROUNDS = 3
"""Each weighs rotations and places by the noise that the one before it tells."""
SHAPE_ROUNDS = 4
"""So many more tell the noise's whole shape."""
LEAST_SHARE = 1e-4
"""No component of the noise has less of its variance: of noise about one axis alone, what rounds left of the other two
would be judged, and a field of errors be told by it."""
LEAST_VARIANCE = 1e-12
"""Of the noise, in equations in which it is about one: of poses without any, round-off is left, of either sign."""


class Cause(StrEnum):
    """What makes poses err by where they are."""

    ANY = "any"
    BENDING = "an arm that bends"
    SCALE = "a scale"
    DELAY = "a delay"


OF_ONE_NUMBER = (Cause.SCALE, Cause.DELAY)
"""Fields that are all as they are modelled: what is left tells their size, and what they do to the estimate."""


class Weighed(NamedTuple):
    """How likely a field is, or several, and the estimate's covariance (p, p) with it."""

    log_weight: float
    covariance: FloatArray
    sizes: Mapping[Cause, tuple[float, float]]
    """Of the first unknown of each field that is in it, in its units, with its variance."""


class Suspicion(NamedTuple):
    """How likely errors depend on the robot's pose at all, and because of a scale or a delay, of which size."""

    of_any: float = 0.0
    of_scale: float = 0.0
    scale: float = 0.0
    """In the unit of the column that `fields` has of it, as is the delay."""
    scale_sd: float = 0.0
    of_delay: float = 0.0
    delay: float = 0.0
    delay_sd: float = 0.0


UNSUSPECTED = Suspicion()


def suspicion(likely: FloatArray, weighed: list[Weighed]) -> Suspicion:
    """Return what fields tell that were ``weighed``, each ``likely`` (N,) beside all other kinds of noise."""
    told = (number for cause in OF_ONE_NUMBER for number in _size(cause, likely, weighed))
    return Suspicion(float(likely.sum()), *told)


def _size(cause: Cause, likely: FloatArray, weighed: list[Weighed]) -> tuple[float, float, float]:
    """Return how likely a field of one number is, how large, and with which standard error."""
    ours = np.array([cause in one.sizes for one in weighed], dtype=bool)
    share = float(likely[ours].sum())
    if not share > 0:
        return 0.0, 0.0, 0.0
    each = likely[ours] / share
    sizes, variances = np.array([one.sizes[cause] for one in weighed if cause in one.sizes]).T
    size = float(each @ sizes)
    return share, size, float(np.sqrt(each @ (variances + (sizes - size) ** 2)))


class ByFrequency(NamedTuple):
    """Equations of N vectors by frequency, and what least squares make of them."""

    design: FloatArray
    """(N, c, p): how the unknowns change what is left."""
    left: FloatArray
    """(N, c): what is left, but for drifts: these are in it."""
    known: FloatArray
    """(p, p): what is known of the unknowns beforehand, of drifts alone."""
    bread: FloatArray
    """(p, p): the covariance of the unknowns for noise of unit variance."""
    drifts: slice
    """Which unknowns are a steady drift in the axes of the equations."""


def judged(equations: ByFrequency, fields: Mapping[Cause, FloatArray], count: int, unlike: bool) -> list[Weighed]:
    """Return what ``fields`` (N, 6, s) are worth beside noise, white or as a filter leaves it, that drifts or not.

    The first ``count`` frequencies are judged. The noise's components are alike, or also ``unlike``.
    """
    steady = _of_causes((), equations, fields, count, unlike)
    late = [_rarer(one) for one in _of_cause((Cause.DELAY,), equations, fields, count, unlike)]
    if max(one.log_weight for one in late) < max(one.log_weight for one in steady):
        return steady + late
    return steady + late + [_rarer(one) for one in _of_causes((Cause.DELAY,), equations, fields, count, unlike)]


def _of_causes(
    beside: tuple[Cause, ...], equations: ByFrequency, fields: Mapping[Cause, FloatArray], count: int, unlike: bool
) -> list[Weighed]:
    """Return what fields by place are worth, ``beside`` others, as `judged` does."""
    found = list(_of_cause((Cause.ANY, *beside), equations, fields, count, unlike))
    weights = np.array([one.log_weight for one in found])
    weights = np.exp(weights - weights.max())
    wide = np.einsum("m,mij->ij", weights / weights.sum(), np.array([one.covariance for one in found]))
    bent = _of_cause((Cause.BENDING, *beside), equations, fields, count, unlike)
    found += [_rarer(one)._replace(covariance=wide) for one in bent]
    return found + [_rarer(one) for one in _of_cause((Cause.SCALE, *beside), equations, fields, count, unlike)]


def _rarer(one: Weighed) -> Weighed:
    return one._replace(log_weight=one.log_weight + np.log(ONE_CAUSE))


def _of_cause(
    causes: tuple[Cause, ...], equations: ByFrequency, fields: Mapping[Cause, FloatArray], count: int, unlike: bool
) -> Iterator[Weighed]:
    """Yield what a field is worth in each of its variances, and beside each noise, as `judged` does.

    Of ``causes`` the first is the field's; any other's is as large as it may be.
    """
    design, left, known, bread, drifts = equations
    constant = np.diag(known) == 0
    widths = [fields[cause].shape[2] for cause in causes]
    field = np.concatenate([fields[cause] for cause in causes], axis=2)
    constants, of_drifts = int(constant.sum()), np.diag(known)[drifts]
    firsts = constants + np.cumsum([0, *widths[:-1]])
    joined = np.concatenate([design[..., constant], field, design[..., drifts], left[..., None]], axis=2)
    undrifting = np.r_[: constants + field.shape[2], joined.shape[2] - 1]
    carried = np.einsum("kci,kcs->is", design, field)
    for i, spectrum in enumerate(beside := beside_a_field(len(design))):
        deviations = np.sqrt(spectrum)[:, None, None]
        prior = np.log(len(beside) - 1) if i else 0.0  # white noise is as likely beforehand as all others
        volume = 0.5 * joined.shape[1] * np.log(spectrum[:count]).sum()
        drifting = _products((joined / deviations)[:count])
        still = drifting[:, :, undrifting[:, None], undrifting].copy()
        for share, drifts_too in product(SHARES, (False, True)):
            variances = np.repeat([share, SHARES[-1]], [widths[0], sum(widths[1:])])
            precision = np.append(np.zeros(constants), 1 / variances)
            products, probability = still, 1 - DRIFT_PROBABILITY
            if drifts_too:
                products, probability = drifting, DRIFT_PROBABILITY
                precision = np.append(precision, of_drifts)
            for found in _judge(products, precision, count, unlike):
                covariance = np.zeros_like(known)
                if causes[0] in OF_ONE_NUMBER:
                    covariance[np.ix_(constant, constant)] = found.second_moment[:constants, :constants]
                else:
                    scores = np.einsum("kai,ab->kbi", design, np.linalg.cholesky(found.noise)) * deviations
                    spread = np.einsum("kci,kcj->ij", scores, scores)
                    spread += carried @ _moment(found, constants, widths[0], variances) @ carried.T
                    spread += np.diag(found.noise).mean() * known
                    covariance += bread @ spread @ bread
                sizes = {cause: found.size(first) for cause, first in zip(causes, firsts, strict=True)}
                yield Weighed(found.log_weight - volume - prior + np.log(probability), covariance, sizes)


def _products(columns: FloatArray) -> FloatArray:
    """Return (c, c, q, q): of each component with each the sums over ``columns`` (N, c, q), each times each."""
    flat = columns.reshape(len(columns), -1)
    return np.asarray((flat.T @ flat).reshape(*columns.shape[1:], *columns.shape[1:]).swapaxes(1, 2).copy())


def _moment(found: _Judged, constants: int, width: int, variances: FloatArray) -> FloatArray:
    """Return the second moment (s, s) of a field of ``variances`` (s,), and of fields of one number from ``width`` on.

    These are as they are modelled, and as large as what is left tells.
    """
    moment = np.diag(found.variance * variances)
    ends = slice(constants + width, constants + len(variances))
    moment[width:, width:] = found.second_moment[ends, ends]
    return moment


def of_volume_one(covariance: FloatArray) -> FloatArray:
    """Return a shape (c, c), of determinant one, for noise of ``covariance`` (c, c)."""
    size = len(covariance)
    shape = covariance + LEAST_SHARE * np.trace(covariance) / size * np.eye(size)
    return np.asarray(shape / np.exp(np.linalg.slogdet(shape)[1] / size))


class _Judged(NamedTuple):
    """How likely a field is, and how large it and the noise beside it are."""

    log_weight: float
    variance: float
    """Of the noise, beside which shares are those of fields."""
    noise: FloatArray
    """(6, 6): covariance of the noise."""
    solution: FloatArray
    """(p,): by how much the fit's constants are off, the field's unknowns, and those of a drift."""
    second_moment: FloatArray
    """(p, p), of what these may be."""

    def size(self, at: int) -> tuple[float, float]:
        """Return how large an unknown is, and its variance."""
        size = float(self.solution[at])
        return size, float(self.second_moment[at, at]) - size**2


def _judge(products: FloatArray, precision: FloatArray, count: int, unlike: bool) -> Iterator[_Judged]:
    """Yield what a field is worth of which ``precision`` (p,), for noise of unit variance, is known beforehand.

    ``products`` (6, 6, p + 1, p + 1) are, of each component with each, the sums over ``count`` frequencies of how the
    fit's constants, of which nothing is known, the field's unknowns and those of a drift change the residual, and of
    that itself, each times each. The noise has about one variance; its components are alike, within rotations and
    within places, then, if asked for, ``unlike``: its shape is what is expected of it with the field (as in `memory`),
    as one that was told without is the field's.
    """
    size, random = len(products), precision > 0
    freedom = count * size - np.count_nonzero(~random)
    volume = np.log(precision[random]).sum()
    after, last = np.eye(size), ROUNDS + (SHAPE_ROUNDS if unlike else 0) - 1
    for done in range(last + 1):
        shape = after
        summed = np.tensordot(np.linalg.inv(shape), products, axes=2)
        normal, score = summed[:-1, :-1] + np.diag(precision), summed[:-1, -1]
        inverse = np.linalg.inv(normal)
        left = np.append(inverse @ score, -1.0)
        misfit = max(float(summed[-1, -1] - score @ left[:-1]), freedom * LEAST_VARIANCE)
        variance = misfit / freedom
        second_moment = np.outer(left, left)
        second_moment[:-1, :-1] += variance * inverse
        if done in (ROUNDS - 1, last):
            numbers = size // 3 - 1 if done < ROUNDS else size * (size + 1) // 2 - 1
            unexplained = freedom * np.log(misfit) + np.linalg.slogdet(normal)[1] - volume
            log_weight = -0.5 * (unexplained + numbers * np.log(count))  # Schwarz's penalty
            yield _Judged(log_weight, variance, shape * variance, left[:-1], second_moment[:-1, :-1])
        after = np.tensordot(products, second_moment, axes=2)
        if done < ROUNDS - 1:
            after = np.diag(np.repeat(np.diag(after).reshape(-1, 3).mean(axis=1), 3))
        after = of_volume_one(after)
