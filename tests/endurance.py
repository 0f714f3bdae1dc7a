"""What is acknowledged stays: kill -9 in writers and in the planner, and many hands on one plan (`scripts/faults`)."""

from __future__ import annotations

import argparse
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit

from ronnaplan.documents.plan import change_plan, read_plan, write_plan
from ronnaplan.planning import Plan
from tests import cases
from tests.faults import killed_at
from tests.planner.browser import Planner, environment
from tests.planner.pages import request
from tests.planner.raw import RawSocket, framed

CHANGES_PER_PLAN = 300
"""Then the plan is begun anew: its history is written with every change."""

COMMAND_LINES = 8
ANSWER_S = 60.0


def note(number: int) -> Callable[[Plan], Plan]:
    return lambda plan: plan.edit("left", notes=str(number))


def noted(path: Path) -> int:
    """Return the number that the plan's only trajectory holds: how many changes were made to it."""
    return int(read_plan(path).trajectory("left").notes or 0)


def kill_writers(kills: int, folder: Path, chance: random.Random) -> Counter[str]:
    """Kill a writer of a plan before or after any of its system calls, ``kills`` times."""
    path, counts, stop = folder / "plan.json", Counter[str](), 0
    told_by, tell = os.pipe()
    os.set_blocking(told_by, False)
    while counts["killed"] < kills:
        if counts["killed"] % CHANGES_PER_PLAN == 0:
            write_plan(path, cases.plan())
        before, stop = noted(path), stop + 1
        was_killed = killed_at(stop, _acknowledged(path, before + 1, tell))
        if not was_killed:
            stop = 0
        acknowledged = _read(told_by)
        counts["killed"] += was_killed
        counts["acknowledged"] += acknowledged
        counts["lost"] += noted(path) < before + acknowledged
        change_plan(path, note(noted(path)))
        counts["left behind"] += len(list(folder.glob(".ronnaplan.*")))
    return counts


def _acknowledged(path: Path, number: int, tell: int) -> Callable[[], object]:
    def work() -> None:
        change_plan(path, note(number))
        os.write(tell, b".")

    return work


def _read(pipe: int) -> int:
    try:
        return len(os.read(pipe, 100))
    except BlockingIOError:
        return 0


def kill_planners(kills: int, folder: Path, chance: random.Random) -> Counter[str]:
    """Kill a planner at any time while a page changes its plan, ``kills`` times; each goes on from the last."""
    counts: Counter[str] = Counter()
    serve = _planner_of(folder)
    while counts["killed"] < kills:
        if counts["killed"] % (CHANGES_PER_PLAN // 10) == 0:
            cases.write_case(folder)
        acknowledged = noted(folder / "plan.json")
        with _forked(serve) as (child, url):
            page = _opened(url)
            for number in range(acknowledged + 1, acknowledged + chance.randrange(2, 6)):
                assert page.act("notes", "left", str(number))
                acknowledged = number
                counts["acknowledged"] += 1
            page.send(
                framed(request("trame.trigger", "notes", ["left", str(acknowledged + 1)], {}, number="rpc:last"))
            )
            time.sleep(chance.uniform(0.0, 0.03))
            os.kill(child, signal.SIGKILL)
            with suppress(ConnectionError):
                acknowledged += page.is_done("rpc:last")
            page.close()
        counts["killed"] += 1
        counts["lost"] += noted(folder / "plan.json") < acknowledged
    return counts


def _opened(url: str) -> RawSocket:
    parts = urlsplit(url)
    assert parts.hostname is not None
    assert parts.port is not None
    return RawSocket((parts.hostname, parts.port), parse_qs(parts.query)["token"][0], ANSWER_S)


def _planner_of(folder: Path) -> Callable[[int], None]:
    """Return what serves the case in ``folder`` and tells its address to a pipe; all it needs is loaded here."""
    import trame.ui.html  # noqa: F401

    from ronnaplan.planner import app, gate, sockets  # noqa: F401
    from ronnaplan.planner.server import serve
    from ronnaplan.planner.state import PlannerState
    from ronnaplan.planner.storage import Storage

    cases.write_case(folder)
    state = PlannerState(cases.volume(), Storage.of(str(folder / "plan.json"), None, None))
    assert state.case.surroundings.head  # found once, for all who are split off

    def work(tell: int) -> None:
        state.case.look_again()
        serve(state, announce=lambda url: _tell(tell, url))

    return work


def _tell(pipe: int, url: str) -> None:
    os.write(pipe, url.encode())
    os.close(pipe)


@contextmanager
def _forked(serve: Callable[[int], None]) -> Iterator[tuple[int, str]]:
    """Yield a child's process number and the address it serves."""
    told_by, tell = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            os.close(told_by)
            serve(tell)
        finally:
            os._exit(1)
    os.close(tell)
    with os.fdopen(told_by) as stream:
        url = stream.read()
    try:
        yield child, url
    finally:
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)


def many_hands(seconds: float, folder: Path) -> Counter[str]:
    """Change one plan from two planners and eight command lines for ``seconds``."""
    cases.write_case(folder)
    path, counts = folder / "plan.json", Counter[str]()
    planners = [Planner(folder, surfaces=True) for _ in range(2)]
    end = time.monotonic() + seconds
    try:
        with ThreadPoolExecutor() as hands:
            clicked = [hands.submit(_click, running.url, hand, end) for hand, running in enumerate(planners)]
            added = [hands.submit(_add, path, hand, end) for hand in range(COMMAND_LINES)]
            notes = [one for each in clicked for one in each.result()]
            names = [one for each in added for one in each.result()]
    finally:
        for running in planners:
            running.kill()
    history = read_plan(path).history
    done = Counter(_said(change) for change in history)
    counts["acknowledged by planners"], counts["acknowledged by command lines"] = len(notes), len(names)
    counts["lost"] = sum(done[said] != 1 for said in [*notes, *names])
    counts["in the history"] = len(history)
    return counts


def _said(change: object) -> str:
    after = getattr(change, "after", None)
    return getattr(after, "name", "") if getattr(change, "action", "") == "add" else getattr(after, "notes", "")


def _click(url: str, hand: int, end: float) -> list[str]:
    """Write notes to the one trajectory that both planners show; return those that were not refused."""
    page, kept, number = _opened(url), list[str](), 0
    while time.monotonic() < end:
        number += 1
        said = f"page {hand}, note {number}"
        if page.act("notes", "left", said):
            kept.append(said)
        time.sleep(0.05)
    page.close()
    return kept


def _add(path: Path, hand: int, end: float) -> list[str]:
    """Add trajectories with the command line; return the names of those that it said were added."""
    kept, number = list[str](), 0
    places = [*map(str, cases.ENTRY_MM)], [*map(str, cases.TARGET_MM)]
    while time.monotonic() < end:
        number += 1
        name = f"line {hand}, path {number}"
        command = [sys.executable, "-m", "ronnaplan", "plan", "add", str(path), name, "--ct", str(cases.CT)]
        command += ["--entry", *places[0], "--target", *places[1], "--coordinates", "LPS"]
        if subprocess.run(command, env=environment(), capture_output=True, check=False).returncode == 0:
            kept.append(name)
    return kept


def main(arguments: list[str]) -> int:
    """Run what is asked for and print what was counted; 1 where anything acknowledged was lost or left behind."""
    parser = argparse.ArgumentParser(prog="scripts/faults", description=__doc__)
    parser.add_argument(
        "--kills", type=int, default=1000, help="kill -9 in writers, and in planners (default 1000)"
    )
    parser.add_argument("--seconds", type=float, default=60.0, help="many hands on one plan (default 60)")
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args(arguments)
    failed = False
    runs: dict[str, Callable[[Path], Any]] = {
        "writers": lambda folder: kill_writers(given.kills, folder, random.Random(given.seed)),
        "planners": lambda folder: kill_planners(given.kills, folder, random.Random(given.seed)),
        "many hands": lambda folder: many_hands(given.seconds, folder),
    }
    for what, run in runs.items():
        started = time.monotonic()
        with tempfile.TemporaryDirectory() as name:
            counts = run(Path(name))
        print(f"{what}: {dict(counts)} in {time.monotonic() - started:.0f} s", flush=True)
        failed |= counts["lost"] > 0 or counts["left behind"] > 0
    return int(failed)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
