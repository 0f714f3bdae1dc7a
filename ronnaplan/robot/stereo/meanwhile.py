"""Whether head or base moved while the markers were looked at one after the other, by what the registration leaves."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ronnaplan.geometry import FloatArray
from ronnaplan.pose import point_jacobian, transform_points
from ronnaplan.registration.drift import DRIFT_PROBABILITY
from ronnaplan.registration.flags import MISFIT_PROBABILITY
from ronnaplan.registration.registration import Registration

FEWEST_FOR_SHIFT = 2
"""On either side of a movement; of one marker alone that stands otherwise none is told, as it may be loose."""
FEWEST_FOR_TURN = 3
SHIFT, MOTION = slice(3, 6), slice(0, 6)
"""Of a rotation (rad) and a translation: a movement that turns nothing, and any."""


def moved_meanwhile(fit: Registration, looks: NDArray[np.intp], names: Sequence[str]) -> str | None:
    """Say how the markers moved between looks; ``looks`` (N) number those of the pairs, in their order.

    ``names`` are those of all looks. None unless errors as stated leave residuals as large less than once in a million
    times, and one movement, between two looks or steadily over all, explains them better than one loose marker.
    """
    from scipy.special import gammaincc

    chance = fit.fit_probability
    if chance is None or chance >= DRIFT_PROBABILITY:
        return None
    best, told = MISFIT_PROBABILITY, None
    in_order = np.sort(looks)
    for share, kind, when in _movements([names[look] for look in in_order.tolist()]):
        left, motion = _moved(fit, share[np.searchsorted(in_order, looks)], kind)
        explained = float(gammaincc((fit.degrees_of_freedom - kind.stop + kind.start) / 2, left / 2))
        if explained > best:
            turned = f" and {np.degrees(np.linalg.norm(motion[:3])):.2f} degrees" if kind is MOTION else ""
            best, told = explained, when and f"{when} by {np.linalg.norm(motion[3:]):.2f} mm{turned}"
    return told


def _movements(names: Sequence[str]) -> Iterator[tuple[FloatArray, slice, str | None]]:
    """Yield which share (N,) of a movement each look may have had, of what kind it was, and when; None of a marker."""
    count = len(names)
    for alone in np.eye(count):
        yield alone, SHIFT, None
    for first, (before, after) in enumerate(pairwise(names), start=1):
        fewer = min(first, count - first)
        if fewer >= FEWEST_FOR_SHIFT:
            kind = MOTION if fewer >= FEWEST_FOR_TURN else SHIFT
            yield (np.arange(count) >= first).astype(float), kind, f"between frames {before} and {after}"
    if count >= 2 * FEWEST_FOR_SHIFT:
        kind = MOTION if count >= 2 * FEWEST_FOR_TURN else SHIFT
        yield np.linspace(0.0, 1.0, count), kind, f"steadily from frame {names[0]} to frame {names[-1]}"


def _moved(fit: Registration, share: FloatArray, kind: slice) -> tuple[float, FloatArray]:
    """Return the sum of squares that a movement (6,) leaves, of which each pair had a ``share`` (N,), and that."""
    mapped = transform_points(fit.transform, fit.moving_mm)
    pose = point_jacobian(mapped - mapped.mean(axis=0))
    design = np.concatenate([pose, share[:, None, None] * pose[..., kind]], axis=2)
    weighted = np.linalg.solve(fit.covariances_mm2, design)
    score = np.einsum("nci,nc->i", weighted, fit.residual_vectors_mm)
    solution = np.linalg.solve(np.einsum("nci,ncj->ij", weighted, design), score)
    motion = np.zeros(6)
    motion[kind] = solution[6:]
    return fit.chi_square - float(score @ solution), motion
