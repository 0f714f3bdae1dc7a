"""template.json holds a template, or is refused with the field that makes it none."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from ronnaplan.documents.template import read_template
from ronnaplan.errors import InputError
from tests.localization.test_template import DISTANCES


def test_a_template_file_is_checked(tmp_path: Path) -> None:
    good = {
        "format": "ronnaplan.template",
        "version": 1,
        "unit": "mm",
        "name": "frame",
        "labels": ["A", "B", "C", "D"],
        "distances": DISTANCES.tolist(),
    }
    path = tmp_path / "frame.json"
    path.write_text(json.dumps(good))
    assert read_template(path).distances_mm == pytest.approx(DISTANCES)
    for change, complaint in (
        ({"labels": ["A", "B", "C", "C"]}, "two markers have the same name"),
        ({"labels": ["A", "B", "C", "C "]}, "the names 'C' and 'C ' of two markers read as one"),
        ({"labels": ["A", "B", "C"]}, r"shape \(4, 4\); expected \(3, 3\) in mm"),
        ({"distances": [*DISTANCES.tolist()[:3], [0.0]]}, "rows of the distances are not of one length"),
        ({"distances": (DISTANCES + np.triu(DISTANCES)).tolist()}, "symmetric"),
        ({"unit": "cm"}, "unit"),
    ):
        path.write_text(json.dumps(good | change))
        with pytest.raises(InputError, match=complaint):
            read_template(path)
