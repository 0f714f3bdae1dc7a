"""One document in, another tool's format out."""

from __future__ import annotations

import os
from collections.abc import Callable

from ronnaplan.documents.fiducials import FiducialsDocument, read_fiducials
from ronnaplan.documents.markups import markups
from ronnaplan.documents.table import csv_table

FIDUCIAL_EXPORTERS: dict[str, Callable[[FiducialsDocument], str]] = {"markups": markups, "csv": csv_table}
"""Formats a fiducials document can become, by the name given to ``--to``."""


def export(path: str | os.PathLike[str], to: str) -> str:
    """Read the document at ``path`` and return it in the format ``to``."""
    return FIDUCIAL_EXPORTERS[to](read_fiducials(path))
