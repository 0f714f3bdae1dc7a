"""The borders that `scripts/fuzz` knows, by name."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from typing import Final

from tests.fuzz.border import Border

BORDERS: Final[Mapping[str, str]] = {
    "dicom": "tests.ct.fuzzing:DicomBorder",
    "images": "tests.ct.image_fuzzing:ImageBorder",
    "planner": "tests.planner.fuzzing:PlannerBorder",
    "start page": "tests.planner.fuzzing:StartBorder",
    "documents": "tests.documents.fuzzing:DocumentBorder",
    "readings": "tests.tracking.fuzzing:ReadingsBorder",
    "openigtlink": "tests.tracking.fuzzing:StreamBorder",
}
"""Name -> ``module:class``, imported where it is run only."""


def made(target: str) -> Border:
    """Return the border that ``target`` (``module:class``) names."""
    module, _, name = target.partition(":")
    border = getattr(importlib.import_module(module), name)()
    assert isinstance(border, Border)
    return border
