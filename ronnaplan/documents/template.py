"""A frame of markers at known distances, or at known places, as a JSON file."""

from __future__ import annotations

import os
from typing import Literal, Self

import numpy as np
from pydantic import Field, model_validator

from ronnaplan.documents.fields import (
    DocumentModel,
    Label,
    LengthMm,
    PositiveMm,
    Vector,
    require_different_names,
)
from ronnaplan.documents.reading import made, read_document
from ronnaplan.errors import InputError
from ronnaplan.geometry import FloatArray, Frame, Points, mutual_distances
from ronnaplan.localization import Template
from ronnaplan.localization.template import DISTANCE_TOLERANCE_MM
from ronnaplan.planning.template_layout import TemplateLayout

FORMAT = "ronnaplan.template"

MOST_MARKERS = 64
"""No frame carries more."""

SMALLEST_MM = 2.0
"""No frame is so small; one in metres is, up to two of them."""


class TemplateDocument(DocumentModel):
    """``{"format": "ronnaplan.template", "version": 1, "unit": "mm", "name", "labels", "distances" or "centers"}``."""

    format: Literal["ronnaplan.template"]
    version: Literal[1]
    unit: Literal["mm"]
    name: Label
    labels: tuple[Label, ...] = Field(min_length=3, max_length=MOST_MARKERS)
    distances: tuple[tuple[LengthMm, ...], ...] = ()
    centers: tuple[Vector, ...] = Field(default=(), max_length=MOST_MARKERS)
    """In any right-handed frame; they say which of two mirror images is meant, which distances do not."""
    tolerance: PositiveMm = DISTANCE_TOLERANCE_MM

    @model_validator(mode="after")
    def _check(self) -> Self:
        require_different_names("markers", self.labels)
        if bool(self.distances) == bool(self.centers):
            raise ValueError("distances or centers are needed, and not both")
        if len({len(row) for row in self.distances}) > 1:
            raise ValueError("the rows of the distances are not of one length")
        try:
            matrix = self.template.distances_mm
        except InputError as error:
            raise ValueError(str(error)) from error
        if (matrix + np.eye(len(matrix)) <= 0).any():
            raise ValueError("two markers are at the same place")
        if matrix.max() < SMALLEST_MM:
            raise ValueError(f"all markers lie within {matrix.max():.2g} mm of each other; is that in metres?")
        _, misfit = self._nearest_points()
        if misfit > self.tolerance:
            raise ValueError(
                f"no points in space have these distances: the nearest miss them by {misfit:.2f} mm RMS, "
                f"expected at most the tolerance of {self.tolerance:g} mm"
            )
        return self

    @property
    def centers_mm(self) -> FloatArray:
        """The markers' places (N, 3): as stated, or such that they have the distances, up to mirroring."""
        return self._nearest_points()[0]

    @property
    def template(self) -> Template:
        """What the localizer looks for; raises `InputError` for distances or centers that none has."""
        if self.distances:
            return Template(self.name, self.labels, np.array(self.distances), self.tolerance)
        centers = np.array(self.centers)
        return Template(self.name, self.labels, mutual_distances(centers), self.tolerance, centers)

    def placed(self, frame: Frame, sigma_mm: float) -> Points:
        """Return the markers at their stated places in ``frame``, which err by ``sigma_mm`` per axis.

        Raises `InputError` where only distances are stated: they do not say which of two mirror images is meant.
        """
        if not self.centers:
            raise InputError(f"the template '{self.name}' states distances; expected the markers' centers")
        spread = np.tile(sigma_mm**2 * np.eye(3), (len(self.labels), 1, 1))
        return Points(np.array(self.centers), spread, self.labels, frame)

    def _nearest_points(self) -> tuple[FloatArray, float]:
        return (np.array(self.centers), 0.0) if self.centers else _nearest_points(np.array(self.distances))


def read_template(path: str | os.PathLike[str]) -> Template:
    """Read and check template.json, for `localize`; raises `InputError` naming the first field that is wrong."""
    return read_template_document(path).template


def read_template_document(path: str | os.PathLike[str]) -> TemplateDocument:
    """Read and check a template file; raises `InputError` naming what is wrong."""
    return read_document(path, TemplateDocument, kind="template", remedy="see docs/localization.md")


def printed_template_document(found: TemplateLayout, name: str) -> str:
    """Return the document of a template that is printed: places as drawn, the tolerance of print and screws.

    Raises `InputError` for a ``name`` that no document holds.
    """
    content = {
        "name": name,
        "labels": found.labels,
        "centers": found.centers_mm.round(4).tolist(),
        "tolerance": round(found.bridge.distance_tolerance_mm, 4),
    }
    document = made(TemplateDocument, content)
    return document.model_dump_json(indent=1, exclude={"distances"}) + "\n"


def _nearest_points(distances_mm: FloatArray) -> tuple[FloatArray, float]:
    """Return N points (N, 3) in space with the nearest distances to ``distances_mm`` (N, N), and how near (RMS, mm).

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

    nearest = least_squares(misses, start.ravel())
    return nearest.x.reshape(size, 3), float(np.sqrt(np.mean(nearest.fun**2)))
