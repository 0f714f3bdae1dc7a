"""A frame of markers at known distances, as a JSON file."""

from __future__ import annotations

import os
from typing import Literal, Self

import numpy as np
from pydantic import Field, model_validator

from ronnaplan.documents.fields import DocumentModel, Label, LengthMm, PositiveMm
from ronnaplan.documents.reading import read_document
from ronnaplan.geometry import FloatArray
from ronnaplan.localization import Template
from ronnaplan.localization.template import DISTANCE_TOLERANCE_MM

MOST_MARKERS = 64
"""No frame carries more."""


class TemplateDocument(DocumentModel):
    """``{"format": "ronnaplan.template", "version": 1, "unit": "mm", "name", "labels", "distances"}``."""

    format: Literal["ronnaplan.template"]
    version: Literal[1]
    unit: Literal["mm"]
    name: Label
    labels: tuple[Label, ...] = Field(min_length=3, max_length=MOST_MARKERS)
    distances: tuple[tuple[LengthMm, ...], ...]
    tolerance: PositiveMm = DISTANCE_TOLERANCE_MM

    @model_validator(mode="after")
    def _check(self) -> Self:
        size = len(self.labels)
        if len(set(self.labels)) != size:
            raise ValueError("two markers have the same label")
        if len(self.distances) != size or any(len(row) != size for row in self.distances):
            raise ValueError(f"the distances are no {size} x {size} matrix")
        matrix = np.array(self.distances)
        if (matrix != matrix.T).any() or (np.diag(matrix) != 0).any():
            raise ValueError("the distances are not symmetric with a zero diagonal")
        if (matrix + np.eye(size) <= 0).any():
            raise ValueError("two markers are at the same place")
        misfit = _misfit_mm(matrix)
        if misfit > self.tolerance:
            raise ValueError(
                f"no points in space have these distances: the nearest miss them by {misfit:.2f} mm RMS, "
                f"expected at most the tolerance of {self.tolerance:g} mm"
            )
        return self


def read_template(path: str | os.PathLike[str]) -> Template:
    """Read and check a template file; raises `InputError` naming what is wrong."""
    document = read_document(
        path,
        TemplateDocument,
        format_name="ronnaplan.template",
        kind="template",
        remedy="see docs/localization.md",
    )
    return Template(document.name, document.labels, np.array(document.distances), document.tolerance)


def _misfit_mm(distances_mm: FloatArray) -> float:
    """Return how far (RMS, mm) ``distances_mm`` (N, N) are from those of the nearest N points in space.

    Points are placed by classical scaling (Torgerson 1952, Psychometrika 17:401) and moved to the least squares of
    all distances. Distances that are each right within a tolerance cannot miss by more than it.
    """
    from scipy.optimize import least_squares

    size = len(distances_mm)
    middle = np.eye(size) - 1.0 / size
    values, vectors = np.linalg.eigh(-0.5 * middle @ distances_mm**2 @ middle)
    start = vectors[:, -3:] * np.sqrt(np.maximum(values[-3:], 0.0))
    i, j = np.triu_indices(size, 1)

    def misses(places: FloatArray) -> FloatArray:
        points = places.reshape(size, 3)
        missed: FloatArray = np.linalg.norm(points[i] - points[j], axis=1) - distances_mm[i, j]
        return missed

    return float(np.sqrt(np.mean(least_squares(misses, start.ravel()).fun ** 2)))
