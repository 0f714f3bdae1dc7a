"""How likely fields of errors are, of several variances and beside several spectra of noise at once.

Recordings are short and every alternative needs the same few steps, so all of them take each step together.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from ronnaplan.geometry import FloatArray

ROUNDS = 3
"""Each weighs rotations and places by the noise that the one before it tells."""
SHAPE_ROUNDS = 4
"""So many more tell the noise's whole shape."""
LEAST_SHARE = 1e-4
"""No component of the noise has less of its variance: of noise about one axis alone, what rounds left of the other two
would be judged, and a field of errors be told by it."""
LEAST_VARIANCE = 1e-12
"""Of the noise, in equations in which it is about one: of poses without any, round-off is left, of either sign."""
COMPONENTS = 6
FIRST, SECOND = np.triu_indices(COMPONENTS)
"""The pairs of components; in a sum over all, those of two unlike ones count twice."""
TIMES = np.where(FIRST == SECOND, 1.0, 2.0)


class Judged(NamedTuple):
    """How likely fields of T precisions are beside S spectra, and how large they and the noise beside them are."""

    log_weight: FloatArray
    """(S, T)."""
    variance: FloatArray
    """(S, T), of the noise, beside which shares are those of fields."""
    noise: FloatArray
    """(S, T, 6, 6): covariance of the noise."""
    solution: FloatArray
    """(S, T, p): by how much the fit's constants are off, the field's unknowns, and those of a drift."""
    second_moment: FloatArray
    """(S, T, p, p), of what these may be."""

    def size(self, at: int) -> FloatArray:
        """Return (S, T, 2): how large an unknown is, and its variance."""
        size = self.solution[..., at]
        return np.stack([size, self.second_moment[..., at, at] - size**2], axis=-1)


def products(columns: FloatArray) -> FloatArray:
    """Return (21, q, q): for each pair of components the sums over ``columns`` (N, 6, q), each times each.

    They are symmetric, as the mean of both orders of the pair: only that counts.
    """
    flat = columns.reshape(len(columns), -1)
    both = (flat.T @ flat).reshape(*columns.shape[1:], *columns.shape[1:])
    each = both[FIRST, :, SECOND]
    return np.asarray((each + each.swapaxes(1, 2)) / 2)


def weighted_sums(covariance: FloatArray, sums: FloatArray) -> FloatArray:
    """Return (S, T, q, q): ``sums`` (S, 21, q, q) of products, weighted by ``covariance`` (S, T, 6, 6)."""
    weights = covariance[..., FIRST, SECOND] * TIMES
    return np.asarray((weights @ _flat(sums)).reshape(*weights.shape[:2], *sums.shape[2:]))


def of_volume_one(covariance: FloatArray) -> FloatArray:
    """Return shapes (..., c, c), of determinant one, for noise of ``covariance`` (..., c, c)."""
    size = covariance.shape[-1]
    trace = np.trace(covariance, axis1=-2, axis2=-1)[..., None, None]
    shape = covariance + LEAST_SHARE * trace / size * np.eye(size)
    return np.asarray(shape / np.exp(np.linalg.slogdet(shape)[1] / size)[..., None, None])


def judge(sums: FloatArray, precision: FloatArray, count: int, unlike: bool) -> Iterator[Judged]:
    """Yield what fields are worth of which ``precision`` (T, p), for noise of unit variance, is known beforehand.

    ``sums`` (S, 21, p + 1, p + 1) are the `products`, over ``count`` frequencies, of how the fit's constants, of which
    nothing is known, the field's unknowns and those of a drift change the residual, and of that itself. The noise has
    about one variance; its components are alike, within rotations and within places, then, if asked for, ``unlike``:
    its shape is what is expected of it with the field (as in `memory`), as one that was told without is the field's.
    """
    random, unknowns = precision[0] > 0, np.arange(precision.shape[1])
    freedom = count * COMPONENTS - np.count_nonzero(~random)
    volume = np.log(precision[:, random]).sum(axis=1)
    after = np.broadcast_to(np.eye(COMPONENTS), (len(sums), len(precision), COMPONENTS, COMPONENTS))
    last = ROUNDS + (SHAPE_ROUNDS if unlike else 0) - 1
    for done in range(last + 1):
        shape = after
        summed = weighted_sums(np.asarray(np.linalg.inv(shape)), sums)
        normal, score = summed[..., :-1, :-1], summed[..., :-1, -1]
        normal[..., unknowns, unknowns] += precision
        inverse, log_determinant = _inverses(normal)
        solution = (inverse @ score[..., None])[..., 0]
        misfit = np.maximum(summed[..., -1, -1] - (score * solution).sum(axis=-1), freedom * LEAST_VARIANCE)
        variance = misfit / freedom
        left = np.concatenate([solution, np.full((*misfit.shape, 1), -1.0)], axis=-1)
        second_moment = left[..., :, None] * left[..., None, :]
        second_moment[..., :-1, :-1] += variance[..., None, None] * inverse
        if done in (ROUNDS - 1, last):
            numbers = 1 if done < ROUNDS else len(FIRST) - 1
            unexplained = freedom * np.log(misfit) + log_determinant - volume
            log_weight = -0.5 * (unexplained + numbers * np.log(count))  # Schwarz's penalty
            noise = shape * variance[..., None, None]
            yield Judged(log_weight, variance, noise, solution, second_moment[..., :-1, :-1])
        after = of_volume_one(_expected(sums, second_moment, alike=done < ROUNDS - 1))


def _expected(sums: FloatArray, second_moment: FloatArray, alike: bool) -> FloatArray:
    """Return the covariance (S, T, 6, 6), but for a factor, that is expected of the noise's components."""
    pairs = _flat(second_moment) @ _flat(sums).swapaxes(1, 2)
    expected = np.zeros((*pairs.shape[:2], COMPONENTS, COMPONENTS))
    expected[..., FIRST, SECOND] = expected[..., SECOND, FIRST] = pairs
    if not alike:
        return expected
    variances = np.diagonal(expected, axis1=-2, axis2=-1).reshape(*pairs.shape[:2], 2, 3).mean(axis=-1)
    return np.asarray(np.repeat(variances, 3, axis=-1)[..., None] * np.eye(COMPONENTS))


def _flat(matrices: FloatArray) -> FloatArray:
    return matrices.reshape(*matrices.shape[:2], -1)


def _inverses(matrices: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return inverses of positive definite ``matrices`` (..., p, p), and the logarithms of the determinants (...,)."""
    from scipy.linalg.lapack import dpotrf, dpotri

    halves, log_determinants = np.empty(matrices.shape), np.empty(matrices.shape[:-2])
    for at in np.ndindex(log_determinants.shape):
        factor, failed = dpotrf(matrices[at], lower=1)
        if failed:  # to rounding it is not definite
            halves[at] = np.tril(np.linalg.inv(matrices[at]))
            log_determinants[at] = np.linalg.slogdet(matrices[at])[1]
        else:
            halves[at] = dpotri(factor, lower=1)[0]
            log_determinants[at] = 2 * np.log(factor.diagonal()).sum()
    diagonal = np.arange(matrices.shape[-1])
    inverses = halves + halves.swapaxes(-1, -2)
    inverses[..., diagonal, diagonal] /= 2
    return inverses, log_determinants
