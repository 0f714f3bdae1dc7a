"""Decisions about markers keep the fitted values and never make a marker without a covariance."""

from __future__ import annotations

import pytest

from ronnaplan.case.marker_edits import BY_HAND, accept, named, reject, rename
from ronnaplan.documents.fiducials import FiducialsDocument
from ronnaplan.errors import RefusedError, UsageError
from tests import cases


def test_a_rejected_marker_can_be_taken_back_as_it_was() -> None:
    document = cases.fiducials()
    rejected = reject(document, "F2")
    assert "F2" not in [one.label for one in rejected.fiducials]
    assert rejected.rejected[0].reason == BY_HAND
    written = FiducialsDocument.model_validate_json(rejected.model_dump_json())
    assert named(accept(written, 0), "F2") == named(document, "F2")
    assert accept(written, 0).rejected == document.rejected


def test_what_the_localizer_rejected_cannot_be_used() -> None:
    with pytest.raises(RefusedError, match="not round"):
        accept(cases.fiducials(), 0)


def test_a_name_is_neither_empty_nor_used_twice() -> None:
    assert named(rename(cases.fiducials(), "F1", " nose "), "nose").center == cases.fiducials().fiducials[0].center
    for bad in ("", "  ", "F2"):
        with pytest.raises(UsageError, match="cannot be the marker's name"):
            rename(cases.fiducials(), "F1", bad)
    with pytest.raises(UsageError, match="no marker F9"):
        reject(cases.fiducials(), "F9")


def test_a_marker_is_not_taken_back_over_another_of_its_name() -> None:
    document = rename(reject(cases.fiducials(), "F2"), "F1", "F2")
    with pytest.raises(UsageError, match="another marker F2"):
        accept(document, 0)
