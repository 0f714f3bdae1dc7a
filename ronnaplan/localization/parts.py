"""Work over a long range, shared out to the cores."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from functools import cache
from itertools import pairwise
from typing import Any, TypeVar

from threadpoolctl import ThreadpoolController

from ronnaplan.threads import cores, in_threads

Result = TypeVar("Result")

PARTS_PER_CORE = 2
"""Parts are not equally much work; what ends early takes another."""


def in_parts(work: Callable[[int, int], Result], count: int) -> list[Result]:
    """Call ``work`` with first and past-the-last of even parts of ``range(count)``, in threads; results in order.

    For work that releases the interpreter's lock, and whose result does not depend on where the parts begin.
    """
    parts = max(min(PARTS_PER_CORE * cores(), count), 1)
    ends = [count * n // parts for n in range(parts + 1)]
    return list(in_threads(lambda part: work(*part), pairwise(ends)))


def single_threaded_algebra() -> AbstractContextManager[Any]:
    """Keep the linear algebra of each thread to its own core, for the time of a ``with``.

    Libraries that start threads for each small product would wait for one another, and sum in another order on
    another number of cores.
    """
    limits: AbstractContextManager[Any] = _libraries().limit(limits=1, user_api="blas")
    return limits


@cache
def _libraries() -> ThreadpoolController:
    return ThreadpoolController()
