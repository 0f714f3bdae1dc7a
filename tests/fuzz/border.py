"""What a border is to the fuzzer: it makes a hostile input from a number, and says what became of it."""

from __future__ import annotations

import random
import time
import traceback
from abc import ABC, abstractmethod
from pathlib import Path
from typing import Any, ClassVar

from ronnaplan.errors import RonnaplanError

GIB = 1 << 30
FAILED = "FAILED"
"""An outcome that starts so is a failure; any other is counted under its own words."""


class WrongValueError(AssertionError):
    """An input was accepted with another value than it states: the one failure that nobody would notice."""


class SlowError(Exception):
    """An input took longer than its border allows (raised by the runner's alarm)."""


class Border(ABC):
    """One way into the program. Made once in a process; a subclass makes its valid inputs in ``__init__``."""

    slowest_s: ClassVar[float] = 5.0
    """An input that takes more of the processor is a hang, and one that waits several times as long."""
    most_bytes: ClassVar[int] = 2 * GIB
    """Resident memory of the whole process that no input may exceed."""
    inputs_in_tests: ClassVar[int] = 300
    """Inputs that long runs of the tests try, a few seconds' worth; else a third of them are tried."""
    expected_outcomes: ClassVar[tuple[str, ...]] = ("refused", "read")
    """Each must be a tenth of all at least, else the inputs are too wild or too tame to find much."""

    def peak_bytes(self) -> int:
        """Return the largest resident memory of what is fed so far: this process, unless it is another."""
        return peak_bytes()

    @abstractmethod
    def check_seeds(self, folder: Path) -> None:
        """Feed every valid input as it is: all must be accepted (and what is compiled at first use, is)."""

    @abstractmethod
    def hostile(self, chance: random.Random) -> tuple[str, Any]:
        """Return the kind of an input, for the table, and the input: the same for the same state of ``chance``."""

    @abstractmethod
    def feed(self, given: Any, folder: Path) -> str:
        """Feed one input, with ``folder`` to write into; return what became of it in a word or two.

        A `RonnaplanError` that escapes counts as "refused". Raises `WrongValueError` for a value that was
        accepted but is not what the input states; any other exception counts as a traceback.
        """


def peak_bytes(process: int | str = "self") -> int:
    """Return the largest resident memory of ``process`` so far (Linux; elsewhere, or once it has ended, 0)."""
    try:
        status = Path(f"/proc/{process}/status").read_text()
    except OSError:
        return 0
    return int(status.split("VmHWM:")[1].split()[0]) * 1024 if "VmHWM:" in status else 0


def starved_s(process: int | str = "self") -> float:
    """Return how long ``process`` has been ready to run while others had the processor (Linux; elsewhere 0)."""
    try:
        return int(Path(f"/proc/{process}/schedstat").read_text().split()[1]) * 1e-9
    except OSError:
        return 0.0


class Watch:
    """Tells how much time a process has had since its beginning: what others took from it is not held against it."""

    def __init__(self, process: int | str = "self") -> None:
        self._process = process
        self._began = self._now()

    def passed_s(self) -> float:
        """Return seconds in which the process ran or waited for something else than the processor."""
        return self._now() - self._began

    def _now(self) -> float:
        return time.monotonic() - starved_s(self._process)


def try_one(border: Border, number: int, seed: int, folder: Path) -> tuple[str, str]:
    """Feed input ``number`` of ``seed``; return its kind and what became of it, a failure starting with `FAILED`."""
    kind, given = border.hostile(random.Random(f"{seed}/{number}"))
    started = time.process_time()  # on a crowded machine the clock says little
    outcome = _outcome(border, given, folder)
    took = time.process_time() - started
    if not outcome.startswith(FAILED) and took > border.slowest_s:
        outcome = f"{FAILED}: took {took:.1f} s"
    return kind, outcome


def _outcome(border: Border, given: Any, folder: Path) -> str:
    try:
        return border.feed(given, folder)
    except RonnaplanError as error:
        if not str(error) or not str(error).isprintable():
            return f"{FAILED}: a message that is not one printable line: {error!r}"
        return "refused"
    except WrongValueError as error:
        return f"{FAILED}: wrong value: {error}"
    except SlowError:
        return f"{FAILED}: hung, stopped: {traceback.format_exc(limit=-4)}"
    except Exception:
        return f"{FAILED}: {traceback.format_exc()}"
