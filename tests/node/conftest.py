from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from ronnaplan.node.index import Index
from tests.isolation import is_isolated
from tests.node.peers import Listening, Orthanc, listening, program


@pytest.fixture
def index(tmp_path: Path) -> Iterator[Index]:
    """An empty index."""
    with Index(tmp_path) as found:
        yield found


@pytest.fixture
def node(tmp_path: Path) -> Iterator[Listening]:
    """A receiver with one scanner that may send."""
    with listening(tmp_path / "home") as found:
        yield found


@pytest.fixture(scope="module")
def orthanc(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Orthanc]:
    """An archive that takes objects from RONNAPLAN."""
    if program("Orthanc") is None:
        pytest.skip("orthanc is not installed (see .ci/run)")
    if not is_isolated():
        pytest.skip("orthanc listens on every interface, and the tests have no network of their own (not root?)")
    archive = Orthanc(tmp_path_factory.mktemp("archive") / "db", {"node": ["RONNAPLAN", "127.0.0.1", 1]})
    yield archive
    archive.stop()
