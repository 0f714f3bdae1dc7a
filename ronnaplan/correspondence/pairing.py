"""What correspondence answers: a pairing with its probability, or a refusal with the rivals and the way out."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

IntArray = NDArray[np.int64]

MOST_RIVALS = 10
"""Rivals listed in an answer."""

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
        (D, 2) pairs that fit but are not certain enough to be given; they are not in ``pairs``.
    moved
        (S, 2) points that do not fit but lie next to each other under the pairing, as a knocked marker would.

    """

    status: Status
    pairs: IntArray
    probability: float
    rivals: tuple[Rival, ...] = ()
    reason: str = ""
    touch: int | None = None
    doubtful: IntArray = field(default_factory=no_pairs)
    moved: IntArray = field(default_factory=no_pairs)

    def swapped(self) -> Pairing:
        """Return the answer for the two sets exchanged."""
        return replace(
            self,
            pairs=exchanged(self.pairs),
            rivals=tuple(replace(rival, pairs=exchanged(rival.pairs)) for rival in self.rivals),
            touch=self._partner_to_touch(),
            doubtful=exchanged(self.doubtful),
            moved=exchanged(self.moved),
        )

    def _partner_to_touch(self) -> int | None:
        """Return a point of the other set that the two best rivals pair differently."""
        if self.touch is None:
            return None
        partners = self.rivals[0].pairs
        return int(partners[partners[:, 0] == self.touch, 1][0])


def exchanged(pairs: IntArray) -> IntArray:
    """Return pairs (L, 2) with the sets exchanged, sorted by the first."""
    return np.ascontiguousarray(pairs[np.argsort(pairs[:, 1], kind="stable"), ::-1])
