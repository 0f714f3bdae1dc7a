"""One process in which VTK works for all tests of a file: it takes longer to begin than most of what it does."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import nullcontext

import pytest

from ronnaplan.scene.vtk import Workshop


@pytest.fixture(scope="module")
def workshop() -> Iterator[Workshop]:
    """Return a process for VTK's tasks."""
    with Workshop() as begun:
        yield begun


@pytest.fixture
def shared_workshop(workshop: Workshop, monkeypatch: pytest.MonkeyPatch) -> None:
    """Have pictures of a head drawn by the file's process instead of one begun for each."""
    for module in ("portrait", "results"):
        monkeypatch.setattr(f"ronnaplan.scene.{module}.Workshop", lambda: nullcontext(workshop))
