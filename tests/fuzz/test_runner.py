"""The fuzzer sees each kind of failure, goes on after it, and says which input it was."""

import ctypes
import os
import random
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import tests.fuzz.border as border_module
from ronnaplan.errors import InputError
from tests.fuzz.border import FAILED, Border, Watch, WrongValueError, try_one
from tests.fuzz.runner import Tally, main, report, run

SEED = 7


class BrokenBorder(Border):
    """Breaks at every other input, each time in another of its `ways`; those between are refused and read in turn."""

    slowest_s = 0.5
    most_bytes = 200 << 20
    ways: tuple[Callable[[], None], ...] = ()

    def check_seeds(self, folder: Path) -> None:
        pass

    def hostile(self, chance: random.Random) -> tuple[str, Any]:
        return "a kind", chance.random()

    def feed(self, given: Any, folder: Path) -> str:
        number = next(n for n in range(99) if random.Random(f"{SEED}/{n}").random() == given)
        if number % 2:
            self.ways[number // 2]()
        elif number % 4:
            raise InputError("it is two more than a multiple of four; expected one")
        return "read"


def traceback() -> None:
    raise KeyError("rows")


def wrong() -> None:
    raise WrongValueError("3 mm, its header says 4 mm")


class TalkativeError(InputError):
    def __str__(self) -> str:
        return "two\nlines"


def talkative() -> None:
    raise TalkativeError


def slow() -> None:
    ends = time.process_time() + 1.0
    while time.process_time() < ends:
        pass


def waiting() -> None:
    time.sleep(60)


def deaf() -> None:
    """Wait where no signal reaches it, as a decoder's loop does."""
    import signal

    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGALRM})
    time.sleep(60)


def crashing() -> None:
    ctypes.string_at(0)


def leaving() -> None:
    os._exit(3)


def greedy() -> None:
    np.ones(250 << 20, np.uint8)


WORDS = {
    traceback: "KeyError: 'rows'",
    wrong: "wrong value: 3 mm, its header says 4 mm",
    talkative: "not one printable line",
    slow: "took 1.",
    waiting: "hung, stopped",
    deaf: "hung",
    crashing: "ended the process (status -11)",
    leaving: "ended the process (status 3)",
    greedy: "GiB of memory",
}


class EveryWayBorder(BrokenBorder):
    ways = tuple(WORDS)


COUNT = 2 * len(WORDS) + 1
SLOW, GREEDY = (2 * list(WORDS).index(one) + 1 for one in (slow, greedy))


@pytest.fixture(scope="module")
def tally() -> Tally:
    return run(f"{__name__}:{EveryWayBorder.__name__}", SEED, range(COUNT))


def test_a_watch_counts_waiting_but_not_what_others_take_of_the_processor(monkeypatch: pytest.MonkeyPatch) -> None:
    clock, taken = [5.0], [2.0]
    monkeypatch.setattr(time, "monotonic", lambda: clock[0])
    monkeypatch.setattr(border_module, "starved_s", lambda process: taken[0])
    watch = Watch(7)
    clock[0], taken[0] = 15.0, 9.0
    assert watch.passed_s() == 3.0


@pytest.mark.parametrize("way", WORDS, ids=[way.__name__ for way in WORDS])
def test_each_kind_of_failure_is_seen(way: Callable[[], None], tally: Tally) -> None:
    number = 2 * list(WORDS).index(way) + 1
    (failure,) = (one for one in tally.failures if one.startswith(f"input {number} ("))
    assert WORDS[way] in failure
    assert failure in report("a border", tally)


def test_the_inputs_after_a_failure_are_tried(tally: Tally) -> None:
    """Also where it took the process with it."""
    assert [tally.outcomes["a kind", outcome] for outcome in ("read", "refused")] == [5, 5]
    assert len(tally.failures) == len(WORDS)
    assert sum(count for (_, outcome), count in tally.outcomes.items() if outcome == FAILED) == len(WORDS)


def test_of_several_inputs_the_longest_is_kept() -> None:
    tally = Tally()
    for number, took_s in ((1, 0.4), (3, 1.2), (5, 0.3)):
        tally.add(number, "a kind", "read", took_s)
    assert tally.longest == (1.2, 3)


def test_the_longest_input_and_the_memory_at_its_peak_are_told(tally: Tally) -> None:
    seconds, number = tally.longest
    assert number in (SLOW, GREEDY)  # a busy machine takes as long to find so much memory
    assert seconds > 0.9
    assert f"(input {number}) and 0." in report("a border", tally)
    assert tally.peak_bytes > 200 << 20


def test_the_same_number_of_the_same_seed_is_the_same_input() -> None:
    border = BrokenBorder()
    given = [border.hostile(random.Random(f"{SEED}/6"))[1] for _ in range(2)]
    assert given[0] == given[1]
    assert try_one(border, 6, SEED, Path()) == ("a kind", "refused")


def test_a_border_that_cannot_start_is_a_failure() -> None:
    (failure,) = run("tests.fuzz.border:Border", SEED, range(5)).failures
    assert "its start" in failure


class LateBorder(BrokenBorder):
    """Takes longer to start than its inputs may take together."""

    def check_seeds(self, folder: Path) -> None:
        time.sleep(0.3)


def test_the_start_of_a_border_takes_nothing_from_its_inputs_time() -> None:
    tally = run(f"{__name__}:{LateBorder.__name__}", SEED, range(1), budget_s=0.2)
    assert sum(tally.outcomes.values()) == 1
    assert not tally.failures


def test_a_border_without_an_input_is_a_failure() -> None:
    (failure,) = run(f"{__name__}:{LateBorder.__name__}", SEED, range(5), budget_s=0.0).failures
    assert "no input was tried" in failure


def test_an_unknown_border_is_wrong_usage(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.argv", ["fuzz", "doors"])
    with pytest.raises(SystemExit) as refusal:
        main()
    assert refusal.value.code == 2
