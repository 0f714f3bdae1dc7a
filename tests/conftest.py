"""The tests have a network of their own where that can be had: what they start is reached from nowhere else."""

from __future__ import annotations

from tests import isolation


def pytest_configure() -> None:
    """Leave this machine's network before anything listens."""
    isolation.isolate()
