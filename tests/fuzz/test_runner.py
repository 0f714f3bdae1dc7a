"""The fuzzer sees each kind of failure, goes on after it, and says which input it was."""

import ctypes
import os
import random
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import tests.fuzz.border as border_module
from ronnaplan.errors import InputError
from tests.fuzz.border import Border, Watch, WrongValueError, try_one
from tests.fuzz.runner import main, report, run

BROKEN = 2
"""The number of the input that breaks the border below; those beside it are refused and read."""


class BrokenBorder(Border):
    """Breaks at every third input, in the way of its class."""

    most_bytes = 400 << 20

    def __init__(self) -> None:
        self.seen = 0

    def check_seeds(self, folder: Path) -> None:
        pass

    def hostile(self, chance: random.Random) -> tuple[str, Any]:
        return "a kind", chance.random()

    def feed(self, given: Any, folder: Path) -> str:
        number = next(n for n in range(9) if random.Random(f"7/{n}").random() == given)
        if number == BROKEN:
            self.fail()
        elif number % 2:
            raise InputError("it is odd; expected an even one")
        return "read"

    def fail(self) -> None:
        raise NotImplementedError


class TracebackBorder(BrokenBorder):
    def fail(self) -> None:
        raise KeyError("rows")


class WrongBorder(BrokenBorder):
    def fail(self) -> None:
        raise WrongValueError("3 mm, its header says 4 mm")


class TalkativeBorder(BrokenBorder):
    def fail(self) -> None:
        raise TalkativeError


class TalkativeError(InputError):
    def __str__(self) -> str:
        return "two\nlines"


class SlowBorder(BrokenBorder):
    slowest_s = 0.5

    def fail(self) -> None:
        ends = time.process_time() + 0.6
        while time.process_time() < ends:
            pass


class WaitingBorder(BrokenBorder):
    slowest_s = 0.5

    def fail(self) -> None:
        time.sleep(60)


class DeafBorder(BrokenBorder):
    """Waits where no signal reaches it, as a decoder's loop does."""

    slowest_s = 0.5

    def fail(self) -> None:
        import signal

        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGALRM})
        time.sleep(60)


class CrashingBorder(BrokenBorder):
    def fail(self) -> None:
        ctypes.string_at(0)


class LeavingBorder(BrokenBorder):
    def fail(self) -> None:
        os._exit(3)


class GreedyBorder(BrokenBorder):
    def fail(self) -> None:
        np.ones(500 << 20, np.uint8)


def test_a_watch_counts_waiting_but_not_what_others_take_of_the_processor(monkeypatch: pytest.MonkeyPatch) -> None:
    clock, taken = [5.0], [2.0]
    monkeypatch.setattr(time, "monotonic", lambda: clock[0])
    monkeypatch.setattr(border_module, "starved_s", lambda process: taken[0])
    watch = Watch(7)
    clock[0], taken[0] = 15.0, 9.0
    assert watch.passed_s() == 3.0


@pytest.mark.parametrize(
    ("border", "words"),
    [
        (TracebackBorder, "KeyError: 'rows'"),
        (WrongBorder, "wrong value: 3 mm, its header says 4 mm"),
        (TalkativeBorder, "not one printable line"),
        (SlowBorder, "took 0."),
        (WaitingBorder, "hung"),
        (DeafBorder, "hung"),
        (CrashingBorder, "ended the process (status -11)"),
        (LeavingBorder, "ended the process (status 3)"),
        (GreedyBorder, "GiB of memory"),
    ],
)
def test_each_kind_of_failure_is_seen_and_the_inputs_after_it_are_tried(border: type[Border], words: str) -> None:
    tally = run(f"{__name__}:{border.__name__}", 7, range(5))
    (failure,) = tally.failures
    assert failure.startswith(f"input {BROKEN} (")
    assert words in failure
    assert sorted(tally.outcomes.values()) == [1, 2, 2]
    assert tally.outcomes["a kind", "refused"] == tally.outcomes["a kind", "read"] == 2
    assert failure in report("a border", tally)


def test_the_longest_input_and_the_memory_at_its_peak_are_told() -> None:
    tally = run(f"{__name__}:{SlowBorder.__name__}", 7, range(5))
    assert tally.longest[1] == BROKEN
    assert tally.longest[0] > 0.5
    assert "(input 2) and 0." in report("a border", tally)
    assert tally.peak_bytes > 1 << 20


def test_the_same_number_of_the_same_seed_is_the_same_input() -> None:
    border = TracebackBorder()
    given = [border.hostile(random.Random("7/3"))[1] for _ in range(2)]
    assert given[0] == given[1]
    assert try_one(border, 3, 7, Path()) == ("a kind", "refused")


def test_a_border_that_cannot_start_is_a_failure() -> None:
    (failure,) = run("tests.fuzz.border:Border", 7, range(5)).failures
    assert "its start" in failure


class LateBorder(BrokenBorder):
    """Takes longer to start than its inputs may take together."""

    def check_seeds(self, folder: Path) -> None:
        time.sleep(0.3)

    def fail(self) -> None:
        pass


def test_the_start_of_a_border_takes_nothing_from_its_inputs_time() -> None:
    tally = run(f"{__name__}:{LateBorder.__name__}", 7, range(1), budget_s=0.2)
    assert sum(tally.outcomes.values()) == 1
    assert not tally.failures


def test_a_border_without_an_input_is_a_failure() -> None:
    (failure,) = run(f"{__name__}:{LateBorder.__name__}", 7, range(5), budget_s=0.0).failures
    assert "no input was tried" in failure


def test_an_unknown_border_is_wrong_usage(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.argv", ["fuzz", "doors"])
    with pytest.raises(SystemExit) as refusal:
        main()
    assert refusal.value.code == 2
