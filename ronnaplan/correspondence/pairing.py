"""What correspondence answers: a pairing with its probability, or a refusal with the rivals and the way out."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

IntArray = NDArray[np.int64]

Status = Literal["unique", "ambiguous", "unmatched"]


def no_pairs() -> IntArray:
    """Return an empty list of pairs, (0, 2)."""
    return np.zeros((0, 2), dtype=np.int64)


@dataclass(frozen=True, eq=False)
class Rival:
    """Another pairing: its ``pairs`` (L, 2), and how far behind the most probable one it is in log evidence."""

    pairs: IntArray
    log_evidence_below: float


@dataclass(frozen=True, eq=False)
class Pairing:
    """The answer of a matcher.

    Attributes
    ----------
    status
        ``unique``: the pairing may be used.  ``ambiguous``: rivals remain.  ``unmatched``: no acceptable pairing.
    pairs
        (L, 2) indices (CT point, OTS point), sorted by CT point; empty unless the status is ``unique``.
    probability
        Posterior probability of the most probable pairing (``rivals[0]`` when refused); NaN from the published
        algorithm, which states none.
    rivals
        The other pairings, nearest first.  When refused, the first is the most probable one, 0 nats below itself.
    reason
        One sentence: why the answer was refused; empty when ``unique``.
    touch
        Index of the CT point whose marker a tracked pointer should touch to settle an ambiguity, or None.
    doubtful
        (D, 2) pairs of a large set that fit but are not certain enough to be given; they are not in ``pairs``.

    """

    status: Status
    pairs: IntArray
    probability: float
    rivals: tuple[Rival, ...] = ()
    reason: str = ""
    touch: int | None = None
    doubtful: IntArray = field(default_factory=no_pairs)
