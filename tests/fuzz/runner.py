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

from tests.fuzz.border import FAILED, GIB, SlowError, try_one
from tests.fuzz.borders import BORDERS, made

ADDRESS_SPACE_BYTES = 8 * GIB
"""Beyond, allocations fail instead of taking the machine down."""
LONGEST_START_S = 900.0
"""Time to make a border's valid inputs and to compile what is compiled at first use."""
LONGEST_END_S = 5.0
"""Time to end what a border has begun."""
WAITED = 6.0
"""An input that waits is stopped after this many times what its border allows."""
WATCHED = 8.0
"""It is given up after this many times, should the alarm not reach it."""
LONGEST_SHOWN = 20


@dataclass
class Tally:
    """What became of the inputs of one border: counts of (kind, outcome), one text a failure, and the extremes."""

    outcomes: Counter[tuple[str, str]] = field(default_factory=Counter)
    failures: list[str] = field(default_factory=list)
    longest: tuple[float, int] = (0.0, 0)
    """Seconds of the processor, and the number of the input that took them."""
    peak_bytes: int = 0

    def add(self, number: int, kind: str, outcome: str, took_s: float = 0.0, peak_bytes: int = 0) -> None:
        """Count one input."""
        self.longest = max(self.longest, (took_s, number))
        self.peak_bytes = max(self.peak_bytes, peak_bytes)
        failed = outcome.startswith(FAILED)
        self.outcomes[kind, FAILED if failed else outcome] += 1
        if failed:
            self.failures.append(f"input {number} ({kind}): {outcome.removeprefix(FAILED).lstrip(': ')}")
            print(self.failures[-1], file=sys.stderr, flush=True)


def run(target: str, seed: int, numbers: range, deadline: float = float("inf")) -> Tally:
    """Try the inputs ``numbers`` of the border ``target`` (``module:class``) until `time.monotonic` is ``deadline``."""
    tally = Tally()
    while numbers and time.monotonic() < deadline:
        tried = _in_child(target, seed, numbers, deadline, tally)
        if tried is None:
            break
        numbers = numbers[tried:]
    return tally


def _in_child(target: str, seed: int, numbers: range, deadline: float, tally: Tally) -> int | None:
    """Return how many inputs one child tried, None if it could not even start."""
    context = multiprocessing.get_context("spawn")
    receiver, sender = context.Pipe(duplex=False)
    child = context.Process(target=_work, args=(target, seed, numbers, sender))
    child.start()
    sender.close()
    patience, kind, tried = LONGEST_START_S, "its start", 0
    try:
        while tried < len(numbers) and time.monotonic() < deadline:
            if not receiver.poll(patience):
                raise EOFError
            kind, outcome, patience, is_spent, took_s, peak = receiver.recv()
            if outcome:
                tally.add(numbers[tried], kind, outcome, took_s, peak)
                tried += 1
            if is_spent:
                break
    except EOFError:
        child.join(timeout=1.0)
        ended = "hung" if child.is_alive() else f"ended the process (status {child.exitcode})"
        tally.add(numbers[tried], kind, f"{FAILED}: {ended}")
        if kind == "its start":
            return None
        tried += 1
    finally:
        child.terminate()  # and so what it has begun itself
        child.join(LONGEST_END_S)
        child.kill()
        child.join()
    return tried


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
            _alarm(WAITED * border.slowest_s)
            started = time.process_time()
            kind, outcome = try_one(border, number, seed, folder)
            took_s = time.process_time() - started
            _alarm(0.0)
            peak = border.peak_bytes()
            is_spent = peak > border.most_bytes  # a peak stays, so the next input needs another process
            if is_spent:
                outcome = f"{FAILED}: took {peak / GIB:.2f} GiB of memory ({outcome})"
            sender.send((kind, outcome, patience, is_spent, took_s, peak))


def _bound_process() -> None:
    def too_slow(*_: object) -> None:
        raise SlowError

    if sys.platform != "win32":
        import resource

        signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))

        resource.setrlimit(resource.RLIMIT_AS, (ADDRESS_SPACE_BYTES, ADDRESS_SPACE_BYTES))
        signal.signal(signal.SIGALRM, too_slow)


def _alarm(seconds: float) -> None:
    if sys.platform != "win32":
        signal.setitimer(signal.ITIMER_REAL, seconds)


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
    parser.add_argument("--minutes", type=float, help="time for all borders together, shared evenly")
    arguments = parser.parse_args()
    unknown = sorted(set(arguments.borders) - set(BORDERS))
    if unknown:
        parser.error(f"there is no border {', '.join(unknown)}; there are {', '.join(BORDERS)}")
    names = list(dict.fromkeys(arguments.borders)) or list(BORDERS)
    count = arguments.count or (10_000 if arguments.minutes is None else sys.maxsize - arguments.first)
    failed = 0
    ends = time.monotonic() + 60.0 * arguments.minutes if arguments.minutes else float("inf")
    for at, name in enumerate(names):
        now = time.monotonic()
        deadline = now + (ends - now) / (len(names) - at)
        tally = run(BORDERS[name], arguments.seed, range(arguments.first, arguments.first + count), deadline)
        print(report(name, tally), flush=True)
        failed += len(tally.failures)
    return 1 if failed else 0
