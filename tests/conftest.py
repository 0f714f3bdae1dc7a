"""The tests have a network of their own where that can be had: what they start is reached from nowhere else."""

from __future__ import annotations

import pytest

from tests import isolation, shared

LONG = ("browser", "test_readme", "test_kernelcache")
"""Parts of the names of files that take longest."""


def pytest_configure(config: pytest.Config) -> None:
    """Leave this machine's network before anything listens."""
    isolation.isolate()
    shared.share(config)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the files that take longest: so no core waits long for the other's last one."""
    items.sort(key=lambda item: not any(part in item.path.name for part in LONG))
