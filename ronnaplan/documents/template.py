"""A frame of markers at known distances, as a JSON file."""

from __future__ import annotations

import os
from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from ronnaplan.documents.files import read_json
from ronnaplan.documents.reading import first_fault
from ronnaplan.errors import InputError
from ronnaplan.localization import Template
from ronnaplan.localization.template import DISTANCE_TOLERANCE_MM

Distance = Annotated[float, Field(ge=0, allow_inf_nan=False)]


class TemplateDocument(BaseModel):
    """``{"format": "ronnaplan.template", "version": 1, "unit": "mm", "name", "labels", "distances"}``."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    format: Literal["ronnaplan.template"]
    version: Literal[1]
    unit: Literal["mm"]
    name: str
    labels: tuple[str, ...] = Field(min_length=3)
    distances: tuple[tuple[Distance, ...], ...]
    tolerance: Annotated[float, Field(gt=0, allow_inf_nan=False)] = DISTANCE_TOLERANCE_MM

    @model_validator(mode="after")
    def _check(self) -> TemplateDocument:
        size = len(self.labels)
        if len(set(self.labels)) != size:
            raise ValueError("two markers have the same label")
        if len(self.distances) != size or any(len(row) != size for row in self.distances):
            raise ValueError(f"the distances are no {size} x {size} matrix")
        matrix = np.array(self.distances)
        if not np.allclose(matrix, matrix.T) or np.any(np.diag(matrix) != 0):
            raise ValueError("the distances are not symmetric with a zero diagonal")
        return self


def read_template(path: str | os.PathLike[str]) -> Template:
    """Read and check a template file; raises `InputError` naming what is wrong."""
    try:
        document = TemplateDocument.model_validate(read_json(path))
    except ValidationError as error:
        raise InputError(f"{os.fspath(path)}: {first_fault(error)}; see docs/localization.md") from error
    return Template(document.name, document.labels, np.array(document.distances), document.tolerance)
