"""Checks of what a matcher is given: points in mm, their errors, the expected number, pairs that are known."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from numbers import Real
from operator import index

import numpy as np
from numpy.typing import ArrayLike

from ronnaplan.bounds import LARGEST_SIGMA_MM, SMALLEST_SIGMA_MM
from ronnaplan.correspondence.pairing import IntArray
from ronnaplan.correspondence.told import LEAST_PAIRS, Told
from ronnaplan.errors import InputError, check_type
from ronnaplan.geometry import MIRROR, FloatArray, as_numbers, as_points
from ronnaplan.rigid import require_millimetres

MOST_POINTS = 10_000
"""Eight times what a tracker sees in a frame. The distances of so many take a gigabyte; the kernels number points in 16
bits, up to 32,767."""


@dataclass(frozen=True, eq=False)
class ErrorModel:
    """The errors of one set: variances (N,) per axis in mm^2; covariances (N, 3, 3) if they are anisotropic."""

    variances: FloatArray
    covariances: FloatArray | None

    def full(self) -> FloatArray:
        """Return the errors as covariances (N, 3, 3) in mm^2."""
        if self.covariances is not None:
            return self.covariances
        return np.asarray(self.variances[:, None, None] * np.eye(3))

    def scaled(self, scale: float) -> ErrorModel:
        """Return errors so many times as large."""
        covariances = None if self.covariances is None else scale**2 * self.covariances
        return ErrorModel(scale**2 * self.variances, covariances)

    def of(self, points: IntArray) -> ErrorModel:
        """Return the errors of some of the points (K,)."""
        covariances = None if self.covariances is None else self.covariances[points]
        return ErrorModel(self.variances[points], covariances)

    def mirrored(self) -> ErrorModel:
        """Return the errors of the points' mirror image."""
        covariances = None if self.covariances is None else self.covariances * np.outer(MIRROR, MIRROR)
        return ErrorModel(self.variances, covariances)


def checked_points(values: ArrayLike, name: str) -> FloatArray:
    """Return points (N, 3) in mm; raises `InputError` for fewer than three, too many, or a spread that cannot be mm.

    Writeable, as the compiled kernels take them: what other libraries hand on often is not.
    """
    points = np.require(as_points(values, name), requirements=["C", "W"])
    if len(points) < LEAST_PAIRS:
        raise InputError(f"{name} are {len(points)}; a rigid registration needs at least {LEAST_PAIRS}")
    if len(points) > MOST_POINTS:
        raise InputError(f"{name} are {len(points)}; expected at most {MOST_POINTS}; leave out what is no marker")
    require_millimetres(points, name)
    return points


def checked_errors(sigma_mm: ArrayLike, covariances_mm2: ArrayLike | None, count: int, name: str) -> ErrorModel:
    """Return the errors of N = ``count`` points from sigmas per axis, () or (N,), or from their covariances."""
    if covariances_mm2 is not None:
        return errors_from_covariances(covariances_mm2, count, name)
    sigma = as_numbers(sigma_mm, f"the errors sigma of {name}", "standard deviations per axis in mm")
    if sigma.shape not in ((), (count,)):
        raise InputError(
            f"sigma of {name} has shape {sigma.shape}; expected one number or one for each of {count}"
        )
    bad = ~((sigma >= SMALLEST_SIGMA_MM) & (sigma < LARGEST_SIGMA_MM))
    if bad.any():
        raise InputError(
            f"sigma of {name} is {sigma[bad][0]:g}; expected positive standard deviations per axis, "
            f"{SMALLEST_SIGMA_MM:g} to {LARGEST_SIGMA_MM:g} mm"
        )
    return ErrorModel(np.broadcast_to(sigma**2, (count,)).copy(), None)


def errors_from_covariances(covariances_mm2: ArrayLike, count: int, name: str) -> ErrorModel:
    """Return the errors that covariances state, (3, 3) for all or (N, 3, 3); or `InputError` if they can be none."""
    expected = f"(3, 3) for all or ({count}, 3, 3) in mm^2"
    covariances = as_numbers(covariances_mm2, f"covariances of {name}", expected)
    if covariances.shape not in ((3, 3), (count, 3, 3)):
        raise InputError(
            f"covariances of {name} have shape {covariances.shape}; expected {expected}, and errors that are the same "
            "along all axes as sigma"
        )
    covariances = np.broadcast_to(covariances, (count, 3, 3)).copy()
    symmetric = np.isfinite(covariances).all() and np.allclose(covariances, covariances.transpose(0, 2, 1))
    variances = np.linalg.eigvalsh(covariances) if symmetric else np.zeros(1)
    if variances.min() <= 0:
        raise InputError(
            f"a covariance of {name} is not symmetric positive definite; expected mm^2, no zero error"
        )
    for variance in (variances.min(), variances.max()):
        if not SMALLEST_SIGMA_MM**2 <= variance < LARGEST_SIGMA_MM**2:
            raise InputError(
                f"a covariance of {name} states an error of {math.sqrt(variance):g} mm along an axis, expected "
                f"{SMALLEST_SIGMA_MM:g} to {LARGEST_SIGMA_MM:g} mm; state covariances in mm^2"
            )
    return ErrorModel(np.trace(covariances, axis1=1, axis2=2) / 3.0, covariances)


def check_probability(least_probability: float) -> None:
    """Raise `InputError` unless a pairing can be accepted at this probability, `UsageError` for what is no number."""
    check_type(least_probability, Real, "least_probability", "give a number")
    if not 0.5 < least_probability < 1:
        raise InputError(f"least_probability is {least_probability}; expected a probability between 0.5 and 1")


def checked_number(number: int | None, meaning: str = "expected") -> int | None:
    """Return a number of pairs that was told; raises `InputError` when no sets can hold it."""
    if number is None:
        return None
    check_type(number, Real, f"the number of pairs that are {meaning}", "give a whole number")
    if number % 1 != 0 or not LEAST_PAIRS <= number <= MOST_POINTS:
        raise InputError(
            f"{number} pairs are {meaning}; a registration needs a whole number of at least {LEAST_PAIRS}, and "
            f"{MOST_POINTS} at most"
        )
    return int(number)


def checked_told(expected: int | None, at_least: int | None) -> Told:
    """Return what was told about the number of pairs; raises `InputError` when both or the impossible was."""
    if expected is not None and at_least is not None:
        raise InputError(f"{expected} pairs are expected and at least {at_least} as well; state only one of them")
    return Told(checked_number(expected), checked_number(at_least, "the least"))


def checked_known(known_pairs: Iterable[tuple[int, int]], counts: tuple[int, int]) -> IntArray:
    """Return pointed-at pairs as (K, 2); raises `InputError` for an index outside its set or used twice."""
    try:
        pairs = [(index(i), index(j)) for i, j in known_pairs]
        known = np.array(pairs, dtype=np.int64).reshape(-1, 2)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"known pairs are {known_pairs!r}; expected pairs of (CT index, OTS index)") from error
    for column, (name, count) in enumerate(zip(("CT", "OTS"), counts, strict=True)):
        indices = known[:, column]
        if ((indices < 0) | (indices >= count)).any() or len(set(indices.tolist())) < len(indices):
            raise InputError(
                f"known pairs name {name} points {indices.tolist()}; expected different ones of 0 to {count - 1}"
            )
    return known
