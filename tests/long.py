"""Studies of many cases: the tests run a few of them each time, `scripts/test -m long` all."""

from __future__ import annotations

from typing import Any

import pytest


def few_or_all(name: str, few: Any, every: Any) -> pytest.MarkDecorator:
    """Give a test the argument ``name``, ``few`` each time, and ``every`` in long runs."""
    return pytest.mark.parametrize(
        name, [pytest.param(few, id="few"), pytest.param(every, id="all", marks=pytest.mark.long)]
    )


def few_and_others(name: str, few: Any, others: Any) -> pytest.MarkDecorator:
    """Run a test for each of ``few`` each time, and for each of ``others`` in long runs."""
    return pytest.mark.parametrize(name, [*few, *(pytest.param(one, marks=pytest.mark.long) for one in others)])
