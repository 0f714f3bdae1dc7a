"""Limits are read from their document, and an unknown one is refused."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from ronnaplan.documents.limits import read_limits
from ronnaplan.errors import InputError
from ronnaplan.planning import Limits


def test_limits_are_read_and_an_unknown_one_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "limits.json"
    head = {"format": "ronnaplan.limits", "version": 1}
    path.write_text(json.dumps({**head, "longest_path_mm": 80, "least_probability": 0.95}))
    assert read_limits(path) == Limits(longest_path_mm=80.0, least_probability=0.95)
    for wrong, words in (
        ({**head, "longest_path": 80}, "longest_path"),
        ({**head, "longest_path_mm": -1}, "longest_path_mm"),
        ({**head, "version": 3}, "version 3"),
        ({"longest_path_mm": 80}, "not a limits document"),
    ):
        path.write_text(json.dumps(wrong))
        with pytest.raises(InputError, match=words):
            read_limits(path)
