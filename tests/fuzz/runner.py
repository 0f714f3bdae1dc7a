"""Feeds hostile inputs to the borders of the program and reports what breaks.

Each border runs in a child process, begun anew after a crash, so that a decoder that ends the process is seen
too. A failure is a traceback, a hang, memory above the border's limit, an end of the process, a message of
several lines, or a value that was accepted but is not what the input states. Input ``number`` of a seed is always
the same: ``scripts/fuzz dicom --seed 3 --first 1234 --count 1`` tries one again.
"""

from __future__ import annotations

import argparse
import multiprocessing
import signal
import sys
import tempfile
import time
import warnings
from collections import Counter
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from tests.fuzz.border import FAILED, GIB, SlowError, Watch, try_one
from tests.fuzz.borders import BORDERS, made

ADDRESS_SPACE_BYTES = 8 * GIB
"""Beyond, allocations fail instead of taking the machine down."""
LONGEST_START_S = 1800.0
"""Time to make a border's valid inputs and to compile what is compiled at first use, on a crowded machine, too."""
LONGEST_END_S = 5.0
"""Time to end what a border has begun."""
WAITED = 6.0
"""An input that waits is stopped after this many times what its border allows."""
WATCHED = 8.0
"""It is given up after this many times, should the alarm not reach it."""
LEAST_ALARM_S = 0.01
LONGEST_SHOWN = 20


@dataclass
class Tally:
    """What became of the inputs of one border: counts of (kind, outcome), one text a failure, and the extremes."""

    outcomes: Counter[tuple[str, str]] = field(default_factory=Counter)
    failures: list[str] = field(default_factory=list)
    longest: tuple[float, int] = (0.0, 0)
    """Seconds of the processor, and the number of the input that took them."""
    peak_bytes: int = 0
    fed_s: float = 0.0
    """Time in which inputs were tried: what a border takes to start is not its inputs' time."""

    def add(self, number: int, kind: str, outcome: str, took_s: float = 0.0, peak_bytes: int = 0) -> None:
        """Count one input."""
        self.longest = max(self.longest, (took_s, number))
        self.peak_bytes = max(self.peak_bytes, peak_bytes)
        failed = outcome.startswith(FAILED)
        self.outcomes[kind, FAILED if failed else outcome] += 1
        if failed:
            self.failures.append(f"input {number} ({kind}): {outcome.removeprefix(FAILED).lstrip(': ')}")
            print(self.failures[-1], file=sys.stderr, flush=True)


def run(target: str, seed: int, numbers: range, budget_s: float = float("inf")) -> Tally:
    """Try the inputs ``numbers`` of the border ``target`` (``module:class``) for ``budget_s``.

    A border that came to no input has failed: its silence would say nothing.
    """
    tally = Tally()
    while numbers and tally.fed_s < budget_s:
        tried = _in_child(target, seed, numbers, budget_s, tally)
        if tried is None:
            break
        numbers = numbers[tried:]
    if not tally.outcomes:
        tally.add(numbers.start, "its start", f"{FAILED}: no input was tried")
    return tally


def _in_child(target: str, seed: int, numbers: range, budget_s: float, tally: Tally) -> int | None:
    """Return how many inputs one child tried, None if it could not even start."""
    context = multiprocessing.get_context("spawn")
    receiver, sender = context.Pipe(duplex=False)
    child = context.Process(target=_work, args=(target, seed, numbers, sender))
    child.start()
    sender.close()
    patience, kind, tried, latest = LONGEST_START_S, "its start", 0, float("nan")
    try:
        while tried < len(numbers) and tally.fed_s < budget_s:
            if not _answers(receiver, child.pid, patience):
                raise EOFError
            kind, outcome, patience, is_spent, took_s, peak = receiver.recv()
            now = time.monotonic()
            if outcome:
                tally.add(numbers[tried], kind, outcome, took_s, peak)
                tally.fed_s += now - latest
                tried += 1
            latest = now
            if is_spent:
                break
    except EOFError:
        child.join(timeout=1.0)
        ended = "hung" if child.is_alive() else f"ended the process (status {child.exitcode})"
        tally.add(numbers[tried], kind, f"{FAILED}: {ended}")
        if kind == "its start":
            return None
        tally.fed_s += time.monotonic() - latest
        tried += 1
    finally:
        child.terminate()  # and so what it has begun itself
        child.join(LONGEST_END_S)
        child.kill()
        child.join()
    return tried


def _answers(receiver: Connection[Any, Any], child: int | None, patience: float) -> bool:
    """Wait until there is something to receive, as long as the child has had no more than ``patience`` seconds."""
    watch = Watch(child or "self")
    while (left := patience - watch.passed_s()) > 0.0:
        if receiver.poll(left):
            return True
    return False


def _work(target: str, seed: int, numbers: range, sender: Connection[Any, Any]) -> None:
    warnings.simplefilter("error")
    _bound_process()
    border = made(target)
    patience = WATCHED * border.slowest_s
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        border.check_seeds(folder)
        for number in numbers:
            sender.send(("an input", "", patience, False, 0.0, 0))
            _alarm(Watch(), WAITED * border.slowest_s)
            started = time.process_time()
            kind, outcome = try_one(border, number, seed, folder)
            took_s = time.process_time() - started
            _alarm(Watch(), 0.0)
            peak = border.peak_bytes()
            is_spent = peak > border.most_bytes  # a peak stays, so the next input needs another process
            if is_spent:
                outcome = f"{FAILED}: took {peak / GIB:.2f} GiB of memory ({outcome})"
            sender.send((kind, outcome, patience, is_spent, took_s, peak))


def _bound_process() -> None:
    if sys.platform != "win32":
        import resource

        signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))
        resource.setrlimit(resource.RLIMIT_AS, (ADDRESS_SPACE_BYTES, ADDRESS_SPACE_BYTES))


def _alarm(watch: Watch, allowed_s: float) -> None:
    """Raise `SlowError` in this process once it has had ``allowed_s`` by its ``watch``; 0 ends the last alarm."""

    def ring(*_: object) -> None:
        if watch.passed_s() >= allowed_s:
            raise SlowError
        _alarm(watch, allowed_s)

    if sys.platform != "win32":
        signal.signal(signal.SIGALRM, ring)
        signal.setitimer(
            signal.ITIMER_REAL, max(allowed_s - watch.passed_s(), LEAST_ALARM_S) if allowed_s else 0.0
        )


def report(name: str, tally: Tally) -> str:
    """Return the table of one border: kinds by outcomes."""
    columns = sorted(
        {outcome for _, outcome in tally.outcomes} | {FAILED}, key=lambda each: (each == FAILED, each)
    )
    kinds = sorted({kind for kind, _ in tally.outcomes})
    lines = [f"{name:24}" + "".join(f"{column:>18}" for column in columns)]
    lines += [f"  {kind:22}" + "".join(f"{tally.outcomes[kind, each]:18}" for each in columns) for kind in kinds]
    totals = [sum(tally.outcomes[kind, each] for kind in kinds) for each in columns]
    lines.append(f"  {'all':22}" + "".join(f"{total:18}" for total in totals))
    seconds, number = tally.longest
    lines.append(f"  at most {seconds:.2f} s (input {number}) and {tally.peak_bytes / GIB:.2f} GiB of memory")
    return "\n".join([*lines, *(f"  {failure}" for failure in tally.failures[:LONGEST_SHOWN])])


def main() -> int:
    """Run from the command line; return 1 if anything failed."""
    parser = argparse.ArgumentParser(
        prog="scripts/fuzz", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("borders", nargs="*", metavar="BORDER", help=f"of {', '.join(BORDERS)} (default: all)")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--count", type=int, help="inputs for each border (default: 10,000, or what the time allows)"
    )
    parser.add_argument("--first", type=int, default=0, help="number of the first input")
    parser.add_argument(
        "--minutes",
        type=float,
        help="time for all inputs together, shared evenly by the borders (what they take to start comes on top)",
    )
    arguments = parser.parse_args()
    unknown = sorted(set(arguments.borders) - set(BORDERS))
    if unknown:
        parser.error(f"there is no border {', '.join(unknown)}; there are {', '.join(BORDERS)}")
    names = list(dict.fromkeys(arguments.borders)) or list(BORDERS)
    count = arguments.count or (10_000 if arguments.minutes is None else sys.maxsize - arguments.first)
    failed = 0
    budget_s = float("inf") if arguments.minutes is None else 60.0 * arguments.minutes / len(names)
    for name in names:
        tally = run(BORDERS[name], arguments.seed, range(arguments.first, arguments.first + count), budget_s)
        print(report(name, tally), flush=True)
        failed += len(tally.failures)
    return 1 if failed else 0
