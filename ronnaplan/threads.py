"""Work shared out to threads, as many as this process may use."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager
from functools import cache
from typing import Any, TypeVar

from ronnaplan.portable import processors

TOLD = "OMP_NUM_THREADS"
"""Environment variable by which schedulers, and whoever starts several processes, say how many threads one may have."""

PARTS_PER_CORE = 2
"""Parts are not equally much work; what ends early takes another."""

Item = TypeVar("Item")
Result = TypeVar("Result")


def cores() -> int:
    """Return how many threads this process may have at work: what `TOLD` says, else its processors."""
    told = os.environ.get(TOLD, "").partition(",")[0].strip()
    if told.isascii() and told.isdigit() and int(told) > 0:
        return int(told)
    return processors()


def in_threads(work: Callable[[Item], Result], items: Iterable[Item], most: int | None = None) -> Iterator[Result]:
    """Yield what ``work`` makes of each of ``items``, in their order, in at most ``most`` threads.

    With one core no thread is begun, for each would only be waited for. An error, or the end of who asks, drops what
    has not begun.
    """
    count = min(cores(), most or cores())
    if count == 1:
        yield from map(work, items)
        return
    pool = ThreadPoolExecutor(count)
    try:
        yield from pool.map(work, items)
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def in_parts(work: Callable[[int, int], Result], count: int) -> list[Result]:
    """Call ``work`` with first and past-the-last of even parts of ``range(count)``, in threads; results in order.

    For work that releases the interpreter's lock, and whose result does not depend on where the parts begin.
    """
    parts = max(min(PARTS_PER_CORE * cores(), count), 1)
    ends = [count * n // parts for n in range(parts + 1)]
    done: dict[int, Result] = {}
    left = iter(range(parts))  # its step is one for the interpreter: no two threads draw the same part

    def take() -> None:
        for n in left:
            done[n] = work(ends[n], ends[n + 1])

    # Who asks works along: to begin a thread takes as long as many a part.
    helpers = min(cores(), parts) - 1
    with ThreadPoolExecutor(max(helpers, 1)) as pool:
        others = [pool.submit(take) for _ in range(helpers)]
        take()
        for other in others:
            other.result()
    return [done[n] for n in range(parts)]


def single_threaded_algebra() -> AbstractContextManager[Any]:
    """Keep the linear algebra of each thread to its own core, for the time of a ``with``.

    Libraries that start threads for each small product would wait for one another, and sum in another order on
    another number of cores.
    """
    limits: AbstractContextManager[Any] = _libraries("scipy.linalg" in sys.modules).limit(
        limits=1, user_api="blas"
    )
    return limits


@cache
def _libraries(with_scipys_own: bool) -> Any:
    """Return those that are loaded; they are looked for anew once ``scipy.linalg`` has brought its own."""
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()
