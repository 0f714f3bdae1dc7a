"""limits.json: what a plan's trajectories must keep."""

from __future__ import annotations

import os
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from ronnaplan.documents.files import read_json
from ronnaplan.documents.reading import first_fault
from ronnaplan.errors import InputError
from ronnaplan.planning.limits import Limits

FORMAT = "ronnaplan.limits"
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Angle = Annotated[float, Field(gt=0, le=90)]


class LimitsDocument(BaseModel):
    """The whole of limits.json, version 1; a limit that is left out does not count."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    format: Literal["ronnaplan.limits"]
    version: Literal[1]
    longest_path_mm: Positive | None = None
    greatest_skull_angle_deg: Angle | None = None
    greatest_skull_thickness_mm: Positive | None = None
    least_no_go_distance_mm: NotNegative | None = None
    least_metal_distance_mm: NotNegative | None = None
    least_marker_distance_mm: NotNegative | None = None
    least_trajectory_distance_mm: NotNegative | None = None
    greatest_target_error_mm: Positive | None = None
    greatest_angular_error_deg: Positive | None = None
    least_probability: Annotated[float, Field(gt=0, lt=1)] | None = None
    tolerance_mm: Positive = 2.0


def read_limits(path: str | os.PathLike[str]) -> Limits:
    """Read and check limits.json; raises `InputError` naming the first field that is wrong or unknown."""
    content = read_json(path)
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise InputError(f"{os.fspath(path)} does not hold limits; expected the format '{FORMAT}'")
    if content.get("version") != 1:
        raise InputError(f"{os.fspath(path)} has version {content.get('version')}; this ronnaplan reads version 1")
    try:
        document = LimitsDocument.model_validate(content)
    except ValidationError as error:
        raise InputError(f"{os.fspath(path)}: {first_fault(error)}") from error
    return Limits(**document.model_dump(exclude={"format", "version"}))
