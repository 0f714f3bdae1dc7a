"""What the time that a sender states in its messages is worth: whether it goes on, and how old what it tells is."""

from __future__ import annotations

from dataclasses import dataclass

CLOCK_DRIFT = 1e-3
"""Two clocks part no faster while each is being set right as is usual (by 500 parts in a million)."""
LATE = (
    "late: it took longer from its own time until it was looked at than others of its device before; where its clock "
    "was set back, start anew"
)
"""Status of a good reading of a stream that falls behind, as of a slow sender, network or computer: it is over, too."""
LEAP_S = 0.5
"""A device's time that goes back by more was set back; by less, messages may have overtaken each other."""
STOOD = "of a time that stands still, although it went on before: nobody can tell of which moment it is"
"""Status of a good reading whose device sends on, but states the time of an earlier moment."""


@dataclass
class _Clock:
    """Of one sender: its last time, when by this computer's clock it was new, and the shortest delay, held when."""

    time_s: float
    new_s: float
    shortest_s: float
    held_s: float
    goes: bool = False


class Clocks:
    """Of each sender the time that it states, which need not agree with this computer's, nor with another's.

    They outlast a connection: what a sender kept in a queue while there was none is as old as it is. A time that was
    set back is another clock.
    """

    def __init__(self, longest_s: float) -> None:
        self._longest_s = longest_s
        self._of: dict[str, _Clock] = {}
        self.none: dict[str, float] = {}
        """The one time that senders have stated for longer than ``longest_s``, in every message: that states none."""

    def __len__(self) -> int:
        return len(self._of)

    @property
    def notes(self) -> list[str]:
        """Who states a time that is none, one sentence each."""
        return [
            f"{sender} state the time {time_s:g} in all of them, which is none; they count as of their arrival"
            for sender, time_s in self.none.items()
        ]

    def heard(self, sender: str, time_s: float, now_s: float) -> str | None:
        """Return why a message of ``time_s`` that is here at ``now_s`` may be of a moment that is over, if it may.

        It may where it took more than ``longest_s`` longer than the quickest of its ``sender``. A delay that was there
        from the first message on is taken for the clocks'.
        """
        took = now_s - time_s
        clock = self._of.get(sender)
        if clock is None or time_s < clock.time_s - LEAP_S:
            clock = self._of[sender] = _Clock(time_s, now_s, took, now_s)
            self.none.pop(sender, None)
        if time_s != clock.time_s:
            clock.time_s, clock.new_s, clock.goes = time_s, now_s, True
            self.none.pop(sender, None)
        clock.shortest_s = min(took, clock.shortest_s + CLOCK_DRIFT * (now_s - clock.held_s))
        clock.held_s = now_s
        if not clock.goes and now_s - clock.new_s > self._longest_s:
            self.none[sender] = time_s
        if sender in self.none or took - clock.shortest_s <= self._longest_s:
            return None
        return LATE if now_s - clock.new_s <= self._longest_s else STOOD
