"""How much longer than before a stream's messages take from their own time until they are here."""

from __future__ import annotations

CLOCK_DRIFT = 1e-3
"""Two clocks part no faster while each is being set right as is usual (by 500 parts in a million)."""


class Delays:
    """Of each device the shortest time that a message took, which clocks that differ may make any, below zero, too."""

    def __init__(self) -> None:
        self._shortest: dict[str, tuple[float, float]] = {}
        """With when, by this computer's clock, it was held to be that."""

    def grown_s(self, device: str, time_s: float, now_s: float) -> float:
        """Return by how much longer than the quickest of ``device`` a message of its ``time_s`` took until ``now_s``.

        A delay that was there from the first message on is taken for the clocks'.
        """
        took = now_s - time_s
        before, at = self._shortest.get(device, (took, now_s))
        shortest = min(took, before + CLOCK_DRIFT * (now_s - at))
        self._shortest[device] = shortest, now_s
        return took - shortest
