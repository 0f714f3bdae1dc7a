"""Studies of many cases: the tests run a few of them each time, `scripts/test -m long` all."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import pytest


def few_or_all(name: str, few: Any, every: Any) -> pytest.MarkDecorator:
    """Give a test the argument ``name``, ``few`` each time, and ``every`` in long runs."""
    return pytest.mark.parametrize(
        name, [pytest.param(few, id="few"), pytest.param(every, id="all", marks=pytest.mark.long)]
    )


def few_and_others(
    names: str | tuple[str, ...], few: Iterable[Any], others: Iterable[Any], ids: Sequence[str] | None = None
) -> pytest.MarkDecorator:
    """Run a test for each of ``few`` each time, and for each of ``others`` in long runs."""
    of_each = (lambda one: (one,)) if isinstance(names, str) else tuple
    later = [pytest.param(*of_each(one), marks=pytest.mark.long) for one in others]
    return pytest.mark.parametrize(names, [*few, *later], ids=ids)
