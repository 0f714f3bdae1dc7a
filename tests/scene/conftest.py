"""One process in which VTK works for all tests of a file: it takes longer to begin than most of what it does."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from ronnaplan.scene.vtk import Workshop


@pytest.fixture(scope="module")
def workshop() -> Iterator[Workshop]:
    """Return a process for VTK's tasks."""
    with Workshop() as begun:
        yield begun
