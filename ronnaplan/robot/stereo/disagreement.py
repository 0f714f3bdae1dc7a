"""What explains that markers, looked at one after the other, do not agree with the scan: a movement, or the cameras."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ronnaplan.geometry import FloatArray
from ronnaplan.registration.beside_a_pose import fitted_beside, moved_together
from ronnaplan.registration.drift import DRIFT_PROBABILITY
from ronnaplan.registration.registration import Registration
from ronnaplan.sigmas import MISFIT_PROBABILITY

FEWEST_FOR_SHIFT = 2
"""On either side of a movement; of one marker alone that stands otherwise none is told, as it may be loose."""
FEWEST_FOR_TURN = 3
"""On either side of a movement of which the rotation is told, too: two markers leave one about their line open."""
FEWEST_FOR_MAJORITY = 5
"""Of so many markers the others outvote two that stand otherwise; two against two leave nobody to believe."""
LARGEST = np.array([0.1, 0.1, 0.1, 10.0, 10.0, 10.0])
"""Standard deviations of a movement's rotation (rad) and translation (mm): they hold what a layout does not tell."""


def explanations(
    fit: Registration, looks: NDArray[np.intp], names: Sequence[str], tcp_turns: FloatArray
) -> list[str]:
    """Say what the markers would agree by; ``looks`` (N) number those of the pairs, in their order.

    ``names`` are those of all looks, ``tcp_turns`` (N, 3, 3) rotations of R from TCP at those of the pairs. Empty
    unless errors as stated leave residuals as large less than once in a million times, and a movement between two
    looks, or steadily over all, or a shift of the cameras at the TCP explains them better than one loose marker.
    """
    if not disagrees(fit):
        return []
    motion = moved_together(fit.transform, fit.moving_mm)
    shift = motion[..., 3:]
    best = doubtful = explained_by_one(fit)
    told = []
    in_order = np.sort(looks)
    for share, fewest, when in _movements([names[look] for look in in_order.tolist()]):
        turns = fewest >= FEWEST_FOR_TURN
        shared = share[np.searchsorted(in_order, looks), None, None] * (motion if turns else shift)
        explained, moved = _explained(fit, motion, shared)
        if explained > best:
            turned = f" and {np.degrees(np.linalg.norm(moved[:3])):.2f} degrees" if turns else ""
            told = [f"head or robot base had moved {when} by {np.linalg.norm(moved[-3:]):.2f} mm{turned}"]
            best = explained
    explained, beside = _explained(fit, motion, tcp_turns)
    if explained > doubtful:
        told.append(f"the cameras were {np.linalg.norm(beside):.2f} mm beside their calibrated place at the TCP")
    if told and fit.stretch is not None:
        told.append("the scan's pixel size or slice distance were wrong")
    return told


def disagrees(fit: Registration) -> bool:
    """Whether errors as stated leave residuals as large less than once in a million times."""
    chance = fit.fit_probability
    return chance is not None and chance < DRIFT_PROBABILITY


def explained_by_one(fit: Registration) -> float:
    """Return how likely errors leave what one loose marker does not explain; other causes have to be likelier."""
    return max(MISFIT_PROBABILITY, _one_loose(fit))


def is_split(fit: Registration, *, left_out: bool) -> bool:
    """Whether so few markers contradict each other that none of them, and no one that stands alone, is to be believed.

    That is told as a movement is, or as any misfit where the pairing has ``left_out`` one more for its place.
    """
    chance = fit.fit_probability
    if chance is None or len(fit.moving_mm) >= FEWEST_FOR_MAJORITY:
        return False
    least = MISFIT_PROBABILITY if left_out else DRIFT_PROBABILITY
    return chance < least and _one_loose(fit) < MISFIT_PROBABILITY


def _one_loose(fit: Registration) -> float:
    """Return how likely errors as stated leave what is left but for the one marker that explains most."""
    motion = moved_together(fit.transform, fit.moving_mm)
    each = np.eye(len(motion))[..., None, None]
    return max(_explained(fit, motion, alone * motion[..., 3:])[0] for alone in each)


def _movements(names: Sequence[str]) -> Iterator[tuple[FloatArray, int, str]]:
    """Yield which share (N,) of a movement each look may have had, how many tell of either end of it, and when."""
    count = len(names)
    for first, (before, after) in enumerate(pairwise(names), start=1):
        if (fewest := min(first, count - first)) >= FEWEST_FOR_SHIFT:
            yield (np.arange(count) >= first).astype(float), fewest, f"between frames {before} and {after}"
    if count >= 2 * FEWEST_FOR_SHIFT:
        yield np.linspace(0.0, 1.0, count), count // 2, f"steadily from frame {names[0]} to frame {names[-1]}"


def _explained(fit: Registration, motion: FloatArray, design: FloatArray) -> tuple[float, FloatArray]:
    """Return how likely errors as stated leave what unknowns (K) of a ``design`` (N, 3, K) do, and these.

    ``motion`` (N, 3, 6) is that of all markers together, which is fitted anew.
    """
    found = fitted_beside(
        fit.residual_vectors_mm, fit.covariances_mm2, motion, design, LARGEST[-design.shape[2] :]
    )
    return found.probability, found.unknowns
