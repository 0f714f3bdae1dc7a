"""Work that is done apart from a browser's own event loop, which may run in the same thread."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

Answer = TypeVar("Answer")


def apart(work: Callable[..., Answer], *given: Any) -> Answer:
    """What ``work`` returns or raises, done in a thread of its own."""
    with ThreadPoolExecutor(1) as thread:
        return thread.submit(work, *given).result()


def run(coroutine: Coroutine[Any, Any, Answer]) -> Answer:
    """What ``coroutine`` gives or raises, run to its end."""
    return apart(lambda: asyncio.run(coroutine))
