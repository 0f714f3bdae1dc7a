"""What correspondence answers: a pairing with its probability, or a refusal with the rivals and the way out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from ronnaplan.display import Shown
from ronnaplan.geometry import FloatArray
from ronnaplan.text import chance

if TYPE_CHECKING:
    from ronnaplan.figures import Picture

IntArray = NDArray[np.int64]

LEAST_PROBABILITY = 0.99
"""Posterior at which a pairing is accepted.

Most accepted pairings are far more probable: over the paper's protocol fewer than 1 in 10,000 accepted answers are
wrong, in the worst cell too (three markers, four outliers); see docs/correspondence.md."""

MOST_RIVALS = 10
"""Rivals listed in an answer."""

LEFT_HANDED = "the mirror image fits far better: the coordinates of one set are left-handed; check its axes"
TWO_BODIES = (
    "the points hold two rigid bodies, and neither is clearly the larger; remove one, or point at a marker"
)
REGULAR = "the markers are laid out regularly and fit in more than one order; point at one, or move one"

Status = Literal["unique", "ambiguous", "unmatched"]


def no_pairs() -> IntArray:
    """Return an empty list of pairs, (0, 2)."""
    return np.zeros((0, 2), dtype=np.int64)


@dataclass(frozen=True, eq=False)
class Rival:
    """Another pairing: its ``pairs`` (L, 2), and how far behind the most probable one it is in log evidence."""

    pairs: IntArray
    log_evidence_below: float


@dataclass(frozen=True, eq=False, repr=False)
class Pairing(Shown[tuple[int, int]]):
    """The answer of a matcher: a sequence of pairs (CT index, OTS index), empty unless it is unique.

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
    pair_probabilities
        (L,) the probability of each of ``pairs`` that it is right, not two outliers, or an outlier and a marker, that
        meet by chance; NaN from the published algorithm.

    """

    status: Status
    pairs: IntArray
    probability: float
    rivals: tuple[Rival, ...] = ()
    reason: str = ""
    touch: int | None = None
    doubtful: IntArray = field(default_factory=no_pairs)
    moved: IntArray = field(default_factory=no_pairs)
    pair_probabilities: FloatArray = field(default_factory=lambda: np.zeros(0))

    @classmethod
    def unmatched(cls, reason: str, probability: float = 0.0, rivals: tuple[Rival, ...] = ()) -> Pairing:
        """Return the refusal of sets for which no pairing is acceptable."""
        return cls("unmatched", no_pairs(), probability, rivals, reason)

    @classmethod
    def ambiguous(
        cls,
        reason: str,
        probability: float = 0.0,
        rivals: tuple[Rival, ...] = (),
        *,
        touch: int | None = None,
        doubtful: IntArray | None = None,
    ) -> Pairing:
        """Return the refusal of sets that can be paired, but not in one way that is sure."""
        kept = no_pairs() if doubtful is None else doubtful
        return cls("ambiguous", no_pairs(), probability, rivals, reason, touch, kept)

    def _items(self) -> Sequence[tuple[int, int]]:
        return [(int(ct), int(ots)) for ct, ots in self.pairs]

    def _headline(self) -> str:
        sure = "" if np.isnan(self.probability) else f", probability {chance(self.probability, 6)}"
        why = f": {self.reason}" if self.reason else ""
        return f"{self.status}, {len(self)} pairs{sure}{why}"

    def _columns(self) -> Mapping[str, Sequence[object]]:
        kinds = {"paired": self.pairs, "doubtful": self.doubtful, "moved": self.moved}
        rows = [(int(ct), int(ots), kind) for kind, pairs in kinds.items() for ct, ots in pairs]
        columns = {name: [row[number] for row in rows] for number, name in enumerate(("ct", "ots", "kind"))}
        stated = self.pair_probabilities.tolist()  # of those that are paired, the first rows
        return {**columns, "probability": stated + [float("nan")] * (len(rows) - len(stated))}

    def plot(self) -> Picture:
        """Return how far behind the most probable pairing its rivals are, in nats of evidence."""
        from ronnaplan.figures import DOUBT_COLOUR, Picture

        picture = Picture(7.0, 1.4 + 0.22 * len(self.rivals))
        axes = picture.add_subplot()
        behind = [rival.log_evidence_below for rival in self.rivals]
        axes.barh(range(1, len(behind) + 1), behind, color=DOUBT_COLOUR)
        axes.set_yticks(range(1, len(behind) + 1))
        axes.invert_yaxis()
        axes.set_title(self._headline(), fontsize=9)
        axes.set_xlabel("evidence below the most probable pairing, nats" if behind else "no rival", fontsize=8)
        axes.set_ylabel("rival", fontsize=8)
        axes.tick_params(labelsize=7)
        return picture

    def swapped(self) -> Pairing:
        """Return the answer for the two sets exchanged."""
        return replace(
            self,
            pairs=exchanged(self.pairs),
            rivals=tuple(replace(rival, pairs=exchanged(rival.pairs)) for rival in self.rivals),
            touch=self._partner_to_touch(),
            doubtful=exchanged(self.doubtful),
            moved=exchanged(self.moved),
            pair_probabilities=self.pair_probabilities[np.argsort(self.pairs[:, 1], kind="stable")],
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
