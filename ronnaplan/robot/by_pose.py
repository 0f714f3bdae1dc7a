"""Errors that depend on the robot's pose: joints whose zero is off, links that bend, a tracker that errs by place.

No number of poses averages them out, and most of such an error looks like another pose of base or tool: little of it
is left. So they are taken for a field over the poses, whose six components are linear in the numbers of the robot's
pose, all of one variance. What is left tells how large that is, and what it does to the estimate follows. As every
other kind of noise it is weighed by its restricted likelihood (`memory`).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from ronnaplan.geometry import FloatArray
from ronnaplan.pose import cross_matrix
from ronnaplan.robot.spectra import beside_a_field

SHARES = (1.0, 10.0, 100.0)
"""Variances of the field, in those of the noise beside it: some hundredths of it are left."""
ALIKE = 10.0
"""Variance of what is alike in all poses, in that of what differs: over a recording an arm's axes and reach, and the
way to the tracker, change little."""
ROUNDS = 3
"""Each weighs rotations and places by the noise that the one before it tells."""
LEAST_VARIANCE = 1e-12
"""Of the noise, in equations in which it is about one: of poses without any, round-off is left, of either sign."""


def field(robot_from_m: FloatArray, robot_from_tcp: FloatArray, sds: FloatArray) -> FloatArray:
    """Return (N, 6, 78): what the field's unknowns, each of about unit size, add to the poses of M, in its axes.

    They turn and shift the TCP (N, 4, 4) in R by ``sds`` (6,) for each number of its pose: for one, which is the same
    in all (`ALIKE`), its place, in the usual distance from R's origin, as an arm errs by its reach, and its rotation.
    """
    places = robot_from_tcp[:, :3, 3]
    usual = np.sqrt((places**2).sum(axis=1).mean())
    rotations = robot_from_tcp[:, :3, :3].reshape(-1, 9)
    alike = np.full((len(places), 1), np.sqrt(ALIKE))
    numbers = np.hstack([alike, places / usual, rotations / np.sqrt(3)]) / np.sqrt(3)
    to_m = robot_from_m[:, :3, :3].swapaxes(1, 2)
    moved = np.zeros((len(places), 6, 6))
    moved[:, :3, :3] = moved[:, 3:, 3:] = to_m
    moved[:, 3:, :3] = to_m @ cross_matrix(places - robot_from_m[:, :3, 3]) * (sds[0] / sds[3])
    return np.asarray((moved[:, :, None, :] * numbers[:, None, :, None]).reshape(len(places), 6, -1))


def judged(
    design: FloatArray, field: FloatArray, residual: FloatArray, known: FloatArray, count: int
) -> Iterator[tuple[float, FloatArray]]:
    """Return log weights of fields beside noise, white or as a filter leaves it, and the covariance of the score.

    All is by frequency, of which the first ``count`` are judged: ``design`` (N, 6, p) of the unknowns, of which
    ``known`` (p, p) is known beforehand, ``field`` (N, 6, s) and what is left, ``residual`` (N, 6). The score is the
    design times the residual (p, p).
    """
    constant = np.diag(known) == 0
    joined = np.concatenate([design[..., constant], field, residual[..., None]], axis=2)
    constants = int(constant.sum())
    carried = np.einsum("kci,kcs->is", design, field)
    for i, spectrum in enumerate(beside := beside_a_field(len(design))):
        deviations = np.sqrt(spectrum)[:, None, None]
        prior = np.log(len(beside) - 1) if i else 0.0  # white noise is as likely beforehand as all others
        volume = 0.5 * residual.shape[1] * np.log(spectrum[:count]).sum()
        of_kinds = (joined / deviations)[:count].reshape(count, 2, 3, -1).swapaxes(0, 1).reshape(2, 3 * count, -1)
        products = of_kinds.swapaxes(1, 2) @ of_kinds
        for share in SHARES:
            found = _judge(products, constants, residual[:count].size - constants, share)
            scores = design * deviations * np.sqrt(found.noise)[:, None]
            spread = np.einsum("kci,kcj->ij", scores, scores) + found.variance * carried @ carried.T
            yield found.log_weight - volume - prior, spread + found.noise.mean() * known


class _Judged(NamedTuple):
    """How likely a field is, and how large it and the noise beside it are."""

    log_weight: float
    variance: float
    noise: FloatArray
    """(6,): variances of the noise."""


def _judge(products: FloatArray, constants: int, freedom: int, share: float) -> _Judged:
    """Return what a field of ``share``, in the variance of the noise, is worth.

    ``products`` (2, p + s + 1, p + s + 1) are, of rotations and of places, the sums of how the p ``constants`` of the
    fit and the field's unknowns change the residual, and of that itself, each times each, with noise of about one
    variance. ``freedom`` is the number of residuals less that of constants.
    """
    unknowns = products.shape[2] - 1 - constants
    known = np.repeat([0.0, 1 / share], [constants, unknowns])
    after = np.ones(2)
    for _ in range(ROUNDS):
        of_kinds = after
        summed = np.tensordot(1 / of_kinds, products, axes=1)
        normal, score = summed[:-1, :-1] + np.diag(known), summed[:-1, -1]
        solution = np.linalg.solve(normal, score)
        misfit = max(float(summed[-1, -1] - score @ solution), freedom * LEAST_VARIANCE)
        left = np.append(solution, -1.0)
        after = np.einsum("i,kij,j->k", left, products, left)
        after += misfit / freedom * np.einsum("ij,kij->k", np.linalg.inv(normal), products[:, :-1, :-1])
        after = np.maximum(after, LEAST_VARIANCE)
        after /= np.sqrt(after.prod())
    volume = np.linalg.slogdet(normal)[1] + unknowns * np.log(share)
    log_weight = -0.5 * (freedom * np.log(misfit) + volume)
    return _Judged(log_weight, share * misfit / freedom, np.repeat(of_kinds, 3) * misfit / freedom)
