"""Errors that depend on the robot's pose: joints whose zero is off, links that bend, a tracker that errs by place.

No number of poses averages them out, and most of such an error looks like another pose of base or tool: little of it
is left. So they are taken for a field over the poses, of which what is left tells how large it is; what it does to the
estimate follows. As every other kind of noise a field is weighed by its restricted likelihood (`memory`), beside noise
in the tracker's axes or the tool's that is alike in all directions or not: beside the wrong noise it would lose to the
right one without a field. So it would beside steadiness where the tracker drifts. There are four:

- of any cause: its six components are linear in the numbers of the robot's pose, all of one variance;
- of an arm that bends under its load, as its joints are springs: it turns down in its upright plane by how far out it
  reaches, about a joint of unknown height. These two numbers tell sooner that there is something. How far such errors
  go is told by the first kind;
- of a tracker whose distances are all wrong by one share (or of a robot's that are);
- of a tracker, or a robot, that is late: what it adds goes with how fast the tool moves.

Late poses are often wrong by place, too: where a delay is likelier than the others these are weighed beside it as well.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from enum import StrEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ronnaplan.geometry import FloatArray
from ronnaplan.robot.by_pose_likelihood import COMPONENTS, Judged, judge, products, weighted_sums
from ronnaplan.robot.spectra import beside_a_field, log_prior_of_drift, log_priors

SHARES = (1.0, 10.0, 100.0)
"""Variances of the field, in those of the noise beside it: some hundredths of it are left."""
ONE_CAUSE = 0.1
"""So likely beforehand is each of the fields that have one cause, in parts of that which may have any."""


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


def suspicion(likely: FloatArray, fields: Sequence[Weighed]) -> Suspicion:
    """Return what ``fields`` tell that were weighed, each ``likely`` (N,) beside all other kinds of noise."""
    told = (number for cause in OF_ONE_NUMBER for number in _size(cause, likely, fields))
    return Suspicion(float(likely.sum()), *told)


def _size(cause: Cause, likely: FloatArray, fields: Sequence[Weighed]) -> tuple[float, float, float]:
    """Return how likely a field of one number is, how large, and with which standard error."""
    ours = np.array([cause in one.sizes for one in fields], dtype=bool)
    share = float(likely[ours].sum())
    if not share > 0:
        return 0.0, 0.0, 0.0
    each = likely[ours] / share
    sizes, variances = np.array([one.sizes[cause] for one in fields if cause in one.sizes]).T
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


def weighed(equations: ByFrequency, fields: Mapping[Cause, FloatArray], count: int, unlike: bool) -> list[Weighed]:
    """Return what ``fields`` (N, 6, s) are worth beside noise, white or as a filter leaves it, that drifts or not.

    The first ``count`` frequencies are judged. The noise's components are alike, or also ``unlike``.
    """
    noises = _Noises(equations, fields, count, unlike)
    steady = _of_causes((), noises)
    late = [_rarer(one) for one in noises.beside((Cause.DELAY,))]
    if max(one.log_weight for one in late) < max(one.log_weight for one in steady):
        return steady + late
    return steady + late + [_rarer(one) for one in _of_causes((Cause.DELAY,), noises)]


def _of_causes(others: tuple[Cause, ...], noises: _Noises) -> list[Weighed]:
    """Return what fields by place are worth, beside ``others``, as `weighed` does."""
    found = list(noises.beside((Cause.ANY, *others)))
    weights = np.array([one.log_weight for one in found])
    weights = np.exp(weights - weights.max())
    wide = np.einsum("m,mij->ij", weights / weights.sum(), np.array([one.covariance for one in found]))
    bent = noises.beside((Cause.BENDING, *others))
    found += [_rarer(one)._replace(covariance=wide) for one in bent]
    return found + [_rarer(one) for one in noises.beside((Cause.SCALE, *others))]


def _rarer(one: Weighed) -> Weighed:
    return one._replace(log_weight=one.log_weight + np.log(ONE_CAUSE))


class _Noises:
    """The kinds of noise that may lie beside fields, of S spectra, and what all fields need of them."""

    def __init__(
        self, equations: ByFrequency, fields: Mapping[Cause, FloatArray], count: int, unlike: bool
    ) -> None:
        design, left, self.known, self.bread, drifts = equations
        self.constant, self.count, self.unlike = np.diag(self.known) == 0, count, unlike
        parts: list[FloatArray] = [
            design[..., self.constant],
            *fields.values(),
            design[..., drifts],
            left[..., None],
        ]
        ends = np.cumsum([part.shape[2] for part in parts])
        self.constants, *of_causes, self.drifts, self.left = np.split(np.arange(ends[-1]), ends[:-1])
        self.columns = dict(zip(fields, of_causes, strict=True))
        self.of_drifts = np.diag(self.known)[drifts]
        joined = np.concatenate(parts, axis=2)
        self.carried = np.einsum("kci,kcs->is", design, joined, optimize=True)
        spectra = np.array(beside_a_field(len(design)))
        deviations = np.sqrt(spectra)[..., None, None]
        self.sums = np.array([products((joined / one)[:count]) for one in deviations])
        self.scores = np.array([products(design * one) for one in deviations])
        volumes = -0.5 * COMPONENTS * np.log(spectra[:, :count]).sum(axis=1)
        self.log_prior = volumes + log_priors(spectra)

    def beside(self, causes: tuple[Cause, ...]) -> Iterator[Weighed]:
        """Yield what a field is worth in each of its variances, and beside each noise, as `weighed` does.

        Of ``causes`` the first is the field's; any other's is as large as it may be.
        """
        field = np.concatenate([self.columns[cause] for cause in causes])
        width, others = len(self.columns[causes[0]]), len(field) - len(self.columns[causes[0]])
        variances = np.array([np.repeat([share, SHARES[-1]], [width, others]) for share in SHARES])
        firsts = len(self.constants) + np.cumsum([0, *(len(self.columns[cause]) for cause in causes[:-1])])
        for drifting in (False, True):
            drifts = self.drifts if drifting else self.drifts[:0]
            known = (np.zeros(len(self.constants)), self.of_drifts[: len(drifts)])
            precision = np.array([np.concatenate([known[0], 1 / each, known[1]]) for each in variances])
            columns = np.concatenate([self.constants, field, drifts, self.left])
            sums = self.sums[:, :, columns[:, None], columns]
            for found in judge(sums, precision, self.count, self.unlike):
                log_weight = found.log_weight + self.log_prior[:, None] + log_prior_of_drift(drifting)
                covariance = self._covariance(found, causes[0], field, width, variances)
                sizes = [found.size(first) for first in firsts]
                for at in np.ndindex(log_weight.shape):
                    told = {cause: tuple(size[at]) for cause, size in zip(causes, sizes, strict=True)}
                    yield Weighed(float(log_weight[at]), covariance[at], told)

    def _covariance(
        self, found: Judged, cause: Cause, field: NDArray[np.intp], width: int, variances: FloatArray
    ) -> FloatArray:
        """Return the estimate's covariance (S, T, p, p) with a ``field`` of ``variances`` (T, s), by its columns.

        Of it the first ``width`` are of ``cause``; other fields are as they are modelled, and as large as what is left
        tells.
        """
        constants = len(self.constants)
        if cause in OF_ONE_NUMBER:
            covariance = np.zeros((*found.variance.shape, *self.known.shape))
            covariance[..., *np.ix_(self.constant, self.constant)] = found.second_moment[
                ..., :constants, :constants
            ]
            return covariance
        ends = slice(constants + width, constants + len(field))
        moment = (found.variance[..., None] * variances)[..., None] * np.eye(len(field))
        moment[..., width:, width:] = found.second_moment[..., ends, ends]
        carried = self.carried[:, field]
        spread = weighted_sums(found.noise, self.scores) + carried @ moment @ carried.T
        spread += np.trace(found.noise, axis1=-2, axis2=-1)[..., None, None] / COMPONENTS * self.known
        return np.asarray(self.bread @ spread @ self.bread)
