"""A bar on standard error for work that takes long."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final, TypeVar

Item = TypeVar("Item")
DELAY_S: Final = 1.0
"""Work shorter than this shows no bar."""


def advancing(items: Iterable[Item], total: int, progress: bool, what: str) -> Iterable[Item]:
    """Return ``items``, with a bar on a terminal that advances with them if ``progress``."""
    if not progress:
        return items
    from tqdm import tqdm

    return tqdm(items, total=total, desc=what, delay=DELAY_S, leave=False, disable=None)
