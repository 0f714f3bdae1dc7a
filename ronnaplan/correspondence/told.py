"""What a user tells about the number of pairs, and what is believed because of it."""

from __future__ import annotations

import math
from dataclasses import dataclass

LEAST_PAIRS = 3
"""A rigid transform needs three pairs."""

UNEXPECTED_PRIOR = 1e-3
"""Prior probability that the number of pairs is one that what was told excludes."""

OTHER_PATIENT = 0.05
"""Prior probability that nothing pairs, for the points are another patient's, where a number of pairs was told."""

UNUSABLE_MARKER = 0.05
"""Prior probability that a marker counted on was knocked, hidden or misread, so that it does not pair.

So one of five may be left out, three of eight: more are less probable than `UNEXPECTED_PRIOR`."""

LEAST_OF_MORE = 4
"""Where more than three markers are expected, no fewer than these are given: three by chance are too easily had. They
are believed, though: of four markers one of which was knocked, three are right, and what four pair is wrong."""


@dataclass(frozen=True)
class Told:
    """What was told about the number of pairs: ``expected`` pairs or a few fewer, or ``at_least``, or nothing."""

    expected: int | None = None
    at_least: int | None = None

    def allows(self, size: int) -> bool:
        """Tell whether a pairing of ``size`` pairs may be given."""
        enough = self.expected is None or size >= min(self.expected, LEAST_OF_MORE)
        return enough and self.believes(size)

    def believes(self, size: int) -> bool:
        """Tell whether ``size`` pairs may be right, by what was told."""
        if self.expected is not None:
            return size <= self.expected and self._lost(size) >= UNEXPECTED_PRIOR
        return size >= (self.at_least or LEAST_PAIRS)

    def _lost(self, size: int) -> float:
        """Return the probability that no more than ``size`` of the expected markers pair."""
        return sum(self._usable(left) for left in range(size + 1))

    def _usable(self, size: int) -> float:
        """Return the probability that ``size`` of the expected markers pair."""
        return binomial(self.expected or 0, size, 1.0 - UNUSABLE_MARKER)

    def __str__(self) -> str:
        return f"at least {self.at_least}" if self.expected is None else f"{self.expected}"

    def prior(self, sizes: range) -> dict[int, float]:
        """Return the prior probability of each number of pairs in ``sizes``, and of 0: nothing pairs.

        Told nothing, that nothing pairs (another patient) is as probable as that anything does, and every number
        is equally probable.  Of ``expected`` markers each fails to pair with `UNUSABLE_MARKER`, independently.  What
        the sets are too small for keeps its share, so the sum is less than 1: that markers are missing makes another
        patient more probable.
        """
        if self.expected is None and self.at_least is None:
            return {0: 0.5} | dict.fromkeys(sizes, 0.5 / max(len(sizes), 1))
        likely = [size for size in sizes if self.believes(size)]
        share = {size: 1.0 if self.expected is None else self._usable(size) for size in likely}
        beyond = range(sizes.stop, (self.expected or 0) + 1)
        total = sum(share.values()) + sum(self._usable(size) for size in beyond)
        rest = UNEXPECTED_PRIOR / max(len(sizes) - len(likely), 1)
        believed = {
            size: (1.0 - UNEXPECTED_PRIOR - OTHER_PATIENT) * value / total for size, value in share.items()
        }
        return {0: OTHER_PATIENT} | dict.fromkeys(sizes, rest) | believed


def binomial(count: int, successes: int, probability: float) -> float:
    """Return the probability of ``successes`` among ``count`` independent trials."""
    failures = count - successes
    ways = math.lgamma(count + 1) - math.lgamma(successes + 1) - math.lgamma(failures + 1)
    return math.exp(ways + successes * math.log(probability) + failures * math.log1p(-probability))
