"""A document that is written in the place of another tells that it is another one."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from ronnaplan.documents.fiducials import read_fiducials
from ronnaplan.documents.registration import read_registration
from ronnaplan.documents.revision import write_document
from tests import cases

KINDS: list[tuple[Callable[[], Any], Callable[[Any], Any], dict[str, Any]]] = [
    (cases.fiducials, read_fiducials, {"rejected": ()}),
    (cases.registration, read_registration, {"doubt": "a person's"}),
]


@pytest.mark.parametrize(("made", "read", "other"), KINDS)
def test_the_revision_counts_the_changes(
    made: Callable[[], Any], read: Callable[[Any], Any], other: dict[str, Any], tmp_path: Path
) -> None:
    document = made()
    path, seen = tmp_path / "document.json", []
    for given in (document, document, document.model_copy(update=other), document):
        write_document(path, given, read)
        seen.append(read(path).revision)
    assert seen == [0, 0, 1, 2]
    assert read(path) == document.model_copy(update={"revision": 2})


def test_what_is_no_such_document_is_replaced(tmp_path: Path) -> None:
    path = tmp_path / "fiducials.json"
    path.write_text("not JSON")
    write_document(path, cases.fiducials(), read_fiducials)
    assert read_fiducials(path).revision == 0
