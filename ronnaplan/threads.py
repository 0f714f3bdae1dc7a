"""Work shared out to threads, as many as this process may use."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from ronnaplan.portable import processors

TOLD = "OMP_NUM_THREADS"
"""Environment variable by which schedulers, and whoever starts several processes, say how many threads one may have."""

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
