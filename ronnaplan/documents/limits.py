"""limits.json: what a plan's trajectories must keep."""

from __future__ import annotations

import os
from typing import Annotated, Literal

from pydantic import Field

from ronnaplan.documents.fields import DocumentModel, LengthMm, PositiveMm
from ronnaplan.documents.reading import read_document
from ronnaplan.planning.lengths import TOLERANCE_MM
from ronnaplan.planning.limits import Limits

Angle = Annotated[float, Field(gt=0, le=90)]


class LimitsDocument(DocumentModel):
    """The whole of limits.json, version 1; a limit that is left out does not count."""

    format: Literal["ronnaplan.limits"]
    version: Literal[1]
    longest_path_mm: PositiveMm | None = None
    greatest_skull_angle_deg: Angle | None = None
    greatest_skull_thickness_mm: PositiveMm | None = None
    least_no_go_distance_mm: LengthMm | None = None
    least_metal_distance_mm: LengthMm | None = None
    least_marker_distance_mm: LengthMm | None = None
    least_trajectory_distance_mm: LengthMm | None = None
    greatest_target_error_mm: PositiveMm | None = None
    greatest_angular_error_deg: Angle | None = None
    least_probability: Annotated[float, Field(gt=0, lt=1)] | None = None
    tolerance_mm: PositiveMm = TOLERANCE_MM


def read_limits(path: str | os.PathLike[str]) -> Limits:
    """Read and check limits.json; raises `InputError` naming the first field that is wrong or unknown."""
    document = read_document(path, LimitsDocument, kind="limits document", remedy="see docs/planning.md")
    return Limits(**document.model_dump(exclude={"format", "version"}))
