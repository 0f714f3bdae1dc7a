"""How far work is that takes long: a bar on standard error, or told to whoever asks."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Final, TypeVar

Item = TypeVar("Item")

Progress = bool | Callable[[float], None]
"""Whether a bar is shown, or what is told the share that is done, 0 to 1."""

DELAY_S: Final = 1.0
"""Work shorter than this shows no bar."""


def advancing(items: Iterable[Item], total: int, progress: Progress, what: str) -> Iterable[Item]:
    """Return ``items``; with them a bar on a terminal advances, or the share that is done is told."""
    if callable(progress):
        return _telling(items, total, progress)
    if not progress:
        return items
    from tqdm import tqdm

    return tqdm(items, total=total, desc=what, delay=DELAY_S, leave=False, disable=None)


def _telling(items: Iterable[Item], total: int, tell: Callable[[float], None]) -> Iterator[Item]:
    for number, one in enumerate(items, start=1):
        yield one
        tell(min(number / max(total, 1), 1.0))
