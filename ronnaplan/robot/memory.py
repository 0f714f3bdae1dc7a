"""Least squares when the noise has a memory, as a tracker's filtered, wandering and drifting poses have.

The noise is stationary in the tracker's axes or in the tool's. A part is white, a part has a memory of unknown length,
and there may be a steady drift. What has a memory is a first-order Markov process, up to a walk over the whole
recording, or the smoother process that a filter leaves. In the frequencies of the discrete cosine transform such noise
is all but uncorrelated, whatever its memory (Ahmed, Natarajan & Rao 1974, IEEE Trans. Comput. C-23:90), so every member
of the family is a list of variances. Each is weighed by its restricted likelihood (Harville 1977, JASA 72:320), which
counts what the fit itself took away. Only the slow frequencies that the estimate uses are judged: nothing is concluded
from the fast ones, where a tracker's filter hides the noise.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import NamedTuple

import numpy as np

from ronnaplan.geometry import FloatArray
from ronnaplan.robot import by_pose
from ronnaplan.robot.by_pose import ByFrequency, Cause, Suspicion
from ronnaplan.robot.by_pose_likelihood import LEAST_VARIANCE, SHAPE_ROUNDS, of_volume_one
from ronnaplan.robot.spectra import log_prior_of_drift, log_priors, spectra
from ronnaplan.threads import single_threaded_algebra

DRIFT_SDS = 4.0
"""A steady drift over half the recording, one standard deviation, in those of the noise."""
SLOW_HALF_WAVES = 8
"""So many of the slowest half-waves over the recording are followed through axes that turn."""
SLOW_SHARES = (0.3, 3.0)
"""Variances of noise in axes that turn, in those of the noise that is stationary."""
USED_LEVERAGE = 0.99
"""The estimate uses the lowest frequencies that make up so much of its leverage ..."""
BAND = 3
"""... and the noise is judged over so many times as many ..."""
FEWEST_FREQUENCIES = 8
"""... and so many more."""
FEWEST_FOR_SHAPE = 4
"""Unlike components are only considered with so many frequencies for each of them."""


@dataclass(frozen=True, eq=False)
class Equations:
    """N successive vector equations of least squares in axes in which their noise may be stationary."""

    design: FloatArray
    """(N, c, p): the columns of the constant unknowns, then of all steady drifts; noise has about unit variance."""
    residual: FloatArray
    """(N, c): ``design @ estimate`` less what was observed."""
    drifts: slice
    """Which columns are a steady drift in these axes."""
    turning: FloatArray | None = None
    """(N, c, s): what noise in other axes, which turn against these, adds; of about unit size."""
    fields: Mapping[Cause, FloatArray] | None = None
    """What errors that depend on the robot's pose add (`by_pose_fields`), where the components are six."""


def least_squares(design: FloatArray, observed: FloatArray, constants: int) -> tuple[FloatArray, FloatArray]:
    """Return the (p,) that fits ``design`` (N, c, p) to ``observed`` (N, c), and what freedom (c,) it leaves each row.

    All unknowns but the first ``constants`` are drifts, which are held near zero by what is known of them beforehand.
    """
    normal = np.einsum("nci,ncj->ij", design, design) + _drift_precision(design, constants)
    solution: FloatArray = np.linalg.solve(normal, np.einsum("nci,nc->i", design, observed))
    return solution, len(design) - np.einsum("nci,nci->c", design @ np.linalg.inv(normal), design)


def least_squares_covariance(
    frames: Sequence[Equations], estimate: FloatArray, constants: int
) -> tuple[FloatArray, Suspicion]:
    """Return the covariance (p, p) of the ``estimate`` (p,) of `least_squares`, and what fields are likely in it.

    ``frames`` are the same equations in one frame or more (of the tracker, of the tool). The noise is stationary in
    one of them, its components alike or not, it drifts steadily or not: each is a candidate, and the result is the
    average over all candidates and spectra by their likelihood. So are fields of errors by the robot's pose, where
    the equations tell them.
    """
    seen = [_Frequencies(frame, constants) for frame in frames]
    count = max(frame.used for frame in seen)  # alike in all frames, or their likelihoods would be of unlike data
    with single_threaded_algebra():
        weights, covariances = _noises(seen, estimate, count)
        noises, fields = len(weights), _fields(seen, estimate, count)
    weights += [one.log_weight - np.log(len(frames)) for one in fields]
    covariances += [one.covariance for one in fields]
    likely = np.exp(np.array(weights) - max(weights))
    likely /= likely.sum()
    mean = np.einsum("m,mij->ij", likely, np.array(covariances))
    return mean, by_pose.suspicion(likely[noises:], fields)


def _noises(
    seen: Sequence[_Frequencies], estimate: FloatArray, count: int
) -> tuple[list[float], list[FloatArray]]:
    """Return the log weight of each kind of noise, and the covariance (p, p) of the ``estimate`` with it."""
    weights, covariances = [], []
    for frame in seen:
        shares = (0.0,) if frame.turning is None else (0.0, *SLOW_SHARES)
        for share, drifting in product(shares, (False, True)):
            candidate = _Candidate(frame, estimate, count, share, drifting)
            for shape, parameters in candidate.component_shapes():
                judged = candidate.judge(shape)
                top = judged.log_weights.max()
                likely = np.exp(judged.log_weights - top)
                weights.append(top + np.log(likely.sum()) - 0.5 * parameters * np.log(count))  # Schwarz's penalty
                covariances.append(candidate.covariance(shape, likely * judged.variances / likely.sum()))
    return weights, covariances


def _fields(seen: Sequence[_Frequencies], estimate: FloatArray, count: int) -> list[by_pose.Weighed]:
    """Return what fields of errors by the robot's pose are worth, in frames that tell them."""
    fields = []
    for frame in seen:
        if frame.fields is None:
            continue
        left = frame.residual - frame.design[..., frame.constants :] @ estimate[frame.constants :]
        unlike = count >= FEWEST_FOR_SHAPE * frame.residual.shape[1]
        equations = ByFrequency(frame.design, left, frame.known, frame.bread, frame.drifts)
        fields += by_pose.weighed(equations, frame.fields, count, unlike)
    return fields


def _drift_precision(design: FloatArray, constants: int) -> FloatArray:
    """Return what is known (p, p) of the unknowns beforehand: drifts are of about `DRIFT_SDS`."""
    unknowns = design.shape[2]
    return np.diag(np.where(np.arange(unknowns) < constants, 0.0, DRIFT_SDS**-2))


class _Frequencies:
    """Equations (N, c, p) by frequency, the estimate's covariance for noise of unit variance, and which are used."""

    def __init__(self, frame: Equations, constants: int) -> None:
        from scipy.fft import dct

        self.design = dct(frame.design, axis=0, norm="ortho")
        self.residual = dct(frame.residual, axis=0, norm="ortho")
        self.constants, self.drifts = constants, frame.drifts
        self.known = _drift_precision(frame.design, constants)
        self.bread = np.linalg.inv(np.einsum("kci,kcj->ij", self.design, self.design) + self.known)
        leverage = np.einsum("kci,ij,kcj->k", self.design, self.bread, self.design)
        lowest = int(np.searchsorted(np.cumsum(leverage), USED_LEVERAGE * leverage.sum()))
        poses = len(self.design)
        self.used = min(BAND * lowest + FEWEST_FREQUENCIES, poses)
        self.turning = None
        """The slowest half-waves of noise in axes that turn: (N, c, waves * s)."""
        if frame.turning is not None:
            waves = dct(np.eye(min(SLOW_HALF_WAVES, poses), poses), type=3, axis=1, norm="ortho")
            mixed = waves.T[:, None, :, None] * frame.turning[:, :, None]
            self.turning = dct(mixed.reshape(*frame.residual.shape, -1), axis=0, norm="ortho")
        self.fields = None
        if frame.fields is not None:
            self.fields = {cause: dct(field, axis=0, norm="ortho") for cause, field in frame.fields.items()}


class _Explained(NamedTuple):
    """What M spectra are worth: log weights (M,), variances (M,), normal matrices (M, q, q), solutions (M, q)."""

    log_weights: FloatArray
    variances: FloatArray
    normal: FloatArray
    solutions: FloatArray


class _Candidate:
    """One kind of noise over the slowest ``count`` frequencies of a frame, and its family of M spectra.

    ``share`` is the variance of the noise in axes that turn; what it and the drift add to the equations are further
    unknowns, of which their variance is known.
    """

    def __init__(
        self, frame: _Frequencies, estimate: FloatArray, count: int, share: float, drifting: bool
    ) -> None:
        self.frame, self.poses = frame, len(frame.design)
        self.design = frame.design[:count]
        modelled = np.zeros(len(estimate), dtype=bool)
        modelled[: frame.constants] = True
        modelled[frame.drifts] = drifting
        self.residual = frame.residual[:count] - self.design[..., ~modelled] @ estimate[~modelled]
        self.spectra = spectra(self.poses, drifting)[:, :count]
        self.inverse_spectra, self.log_volumes = 1 / self.spectra, np.log(self.spectra).sum(axis=1)
        random = np.full((len(self.spectra), modelled.sum() - frame.constants), DRIFT_SDS**2)
        self.turning = None
        self.fitted = self.design[..., modelled]
        if share and frame.turning is not None:
            self.turning = frame.turning[:count]
            waves = self.spectra[:, : min(SLOW_HALF_WAVES, self.poses)]
            self.turning_variances = share * np.repeat(waves, self.turning.shape[2] // waves.shape[1], axis=1)
            random = np.hstack([random, self.turning_variances])
            self.fitted = np.concatenate([self.fitted, self.turning], axis=2)
        self.precision = np.hstack([np.zeros((len(random), frame.constants)), 1 / random])
        volumes = 0.5 * np.log(1 / random).sum(axis=1)
        self.log_prior = volumes + log_prior_of_drift(drifting) + log_priors(self.spectra)

    def judge(self, shape: FloatArray) -> _Explained:
        """Return how well every spectrum explains the equations, for components of ``shape`` (c, c)."""
        count, size = self.residual.shape
        joined = np.concatenate([self.fitted, self.residual[..., None]], axis=2)
        whitened = np.linalg.inv(np.linalg.cholesky(shape)) @ joined
        products = whitened.transpose(0, 2, 1) @ whitened
        sums = (self.inverse_spectra @ products.reshape(count, -1)).reshape(-1, *products.shape[1:])
        normal, score, square = sums[:, :-1, :-1], sums[:, :-1, -1], sums[:, -1, -1]
        unknowns = np.arange(normal.shape[1])
        normal[:, unknowns, unknowns] += self.precision
        solutions = np.linalg.solve(normal, score[..., None])[..., 0]
        freedom = count * size - self.frame.constants
        misfit = np.maximum(square - (score * solutions).sum(axis=1), freedom * LEAST_VARIANCE)
        volume = size * self.log_volumes + np.linalg.slogdet(normal)[1]
        log_weights = self.log_prior - 0.5 * (freedom * np.log(misfit) + volume)
        return _Explained(log_weights, misfit / freedom, normal, solutions)

    def covariance(self, shape: FloatArray, variances: FloatArray) -> FloatArray:
        """Return the estimate's covariance (p, p) under noise of ``shape`` (c, c) and ``variances`` (M,) of spectra.

        A shape that was itself estimated makes the covariance's inverse too large on average (Kaufman 1967; the mean
        of an inverse Wishart matrix), so it is widened by as much.
        """
        count, size = self.residual.shape
        freedom = count - self.fitted.shape[2] / size
        widened = freedom / (freedom - size - 1) if np.count_nonzero(shape) > size else 1.0
        deviations = np.sqrt(variances @ self.spectra)[:, None, None]
        scores = np.einsum("kai,ab->kbi", self.design, np.linalg.cholesky(shape)) * deviations
        spread = widened * np.einsum("kbi,kbj->ij", scores, scores) + variances.sum() * self.frame.known
        if self.turning is not None:
            carried = np.einsum("kci,kcs->is", self.design, self.turning)
            spread += (carried * (variances @ self.turning_variances)) @ carried.T
        covariance: FloatArray = self.frame.bread @ spread @ self.frame.bread
        return covariance

    def component_shapes(self) -> list[tuple[FloatArray, int]]:
        """Return the candidates (c, c), of determinant one, for the covariance of the noise's components.

        They are alike, within rotations and within places, or unlike; with how many numbers each takes.
        """
        count, size = self.residual.shape
        kinds = size // 3
        alike = np.eye(size)
        for _ in range(SHAPE_ROUNDS if kinds > 1 else 0):
            of_kinds = np.diag(self._noise_shape(alike)).reshape(kinds, 3).mean(axis=1)
            alike = of_volume_one(np.diag(np.repeat(of_kinds, 3)))
        if self.turning is not None or count < FEWEST_FOR_SHAPE * size:
            return [(alike, kinds - 1)]
        unlike = alike
        for _ in range(SHAPE_ROUNDS):
            unlike = of_volume_one(self._noise_shape(unlike))
        return [(alike, kinds - 1), (unlike, size * (size + 1) // 2 - 1)]

    def _noise_shape(self, shape: FloatArray) -> FloatArray:
        """Return the covariance (c, c) of the noise's components that is expected under ``shape`` (c, c).

        It counts what the fit leaves and what it took away (Dempster, Laird & Rubin 1977, JRSS B 39:1).
        """
        judged = self.judge(shape)
        best = int(judged.log_weights.argmax())
        left = self.residual - self.fitted @ judged.solutions[best]
        scaled = self.fitted / np.sqrt(self.spectra[best])[:, None, None]
        taken = np.tensordot(scaled @ np.linalg.inv(judged.normal[best]), scaled, axes=([0, 2], [0, 2]))
        expected: FloatArray = (left.T / self.spectra[best]) @ left + judged.variances[best] * taken
        return expected
