"""fiducials.json: the markers of one scan, with covariances, and the candidates that were turned down."""

from __future__ import annotations

import os
from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, model_validator

from ronnaplan import __version__
from ronnaplan.documents.reading import read_document
from ronnaplan.geometry import Frame, Points
from ronnaplan.localization.fiducials import Fiducials

FORMAT = "ronnaplan.fiducials"
Vector = tuple[FiniteFloat, FiniteFloat, FiniteFloat]
Matrix = tuple[Vector, Vector, Vector]
PositiveMm = Annotated[float, Field(gt=0, allow_inf_nan=False)]


class _Model(BaseModel):
    model_config = ConfigDict(frozen=True, extra="allow")


class Source(_Model):
    """Where the scan comes from; nothing here names the patient."""

    study_instance_uid: str | None = None
    series_instance_uid: str | None = None
    frame_of_reference_uid: str | None = None
    voxel_sha256: str | None = None


class Marker(_Model):
    """What was looked for."""

    diameter_mm: PositiveMm


class FiducialEntry(_Model):
    """One marker: centre in LPS mm, covariance in mm^2, and what the fit found beside it."""

    label: str
    center: Vector
    covariance: Matrix
    diameter_mm: PositiveMm
    contrast_hu: FiniteFloat
    flags: tuple[str, ...] = ()


class RejectedEntry(_Model):
    """One candidate that is no marker, and why."""

    center: Vector
    reason: str


class Software(_Model):
    """What wrote the document."""

    name: str
    version: str


class FiducialsDocument(_Model):
    """The whole of fiducials.json, version 1."""

    format: Literal["ronnaplan.fiducials"]
    version: Literal[1]
    coordinate_system: Literal["LPS"]
    unit: Literal["mm"]
    source: Source
    marker: Marker
    fiducials: tuple[FiducialEntry, ...]
    rejected: tuple[RejectedEntry, ...] = ()
    software: Software

    @model_validator(mode="after")
    def _check(self) -> FiducialsDocument:
        labels = [entry.label for entry in self.fiducials]
        if len(set(labels)) != len(labels):
            raise ValueError("two fiducials have the same label")
        for entry in self.fiducials:
            covariance = np.array(entry.covariance)
            if not np.allclose(covariance, covariance.T) or np.linalg.eigvalsh(covariance)[0] < 0:
                raise ValueError(f"the covariance of {entry.label} is not symmetric and positive")
        return self

    @property
    def points(self) -> Points:
        """The markers as labelled points of the scan's frame."""
        return Points(
            np.array([entry.center for entry in self.fiducials], dtype=np.float64).reshape(-1, 3),
            np.array([entry.covariance for entry in self.fiducials], dtype=np.float64).reshape(-1, 3, 3),
            tuple(entry.label for entry in self.fiducials),
            Frame("CT", self.source.frame_of_reference_uid),
        )


def fiducials_document(found: Fiducials) -> FiducialsDocument:
    """Turn the localizer's result into its document."""
    return FiducialsDocument.model_validate(
        {
            "format": FORMAT,
            "version": 1,
            "coordinate_system": "LPS",
            "unit": "mm",
            "source": {
                "study_instance_uid": found.source.study_instance_uid,
                "series_instance_uid": found.source.series_instance_uid,
                "frame_of_reference_uid": found.source.frame_of_reference_uid,
                "voxel_sha256": found.voxel_sha256,
                "flags": [flag.name.lower() for flag in found.volume_flags],
            },
            "marker": {"diameter_mm": found.diameters_mm[0], "diameters_mm": found.diameters_mm},
            "fiducials": [
                {
                    "label": one.label,
                    "center": one.center_mm.tolist(),
                    "covariance": one.covariance_mm2.tolist(),
                    "diameter_mm": one.diameter_mm,
                    "contrast_hu": one.contrast_hu,
                    "flags": [flag.name.lower() for flag in one.flags],
                    "bound": one.bound_mm2.tolist(),
                    "coverage": one.coverage,
                    "misfit": one.misfit,
                }
                for one in found.fiducials
            ],
            "rejected": [
                {"center": one.center_mm.tolist(), "reason": one.reason, "test": one.test}
                for one in found.rejected
            ],
            "software": {"name": "ronnaplan", "version": __version__},
        }
    )


def to_json(document: BaseModel) -> str:
    """Write a document as indented JSON with a final newline."""
    return document.model_dump_json(indent=2) + "\n"


def read_fiducials(path: str | os.PathLike[str]) -> FiducialsDocument:
    """Read and check fiducials.json; raises `InputError` naming the first field that is wrong."""
    return read_document(
        path,
        FiducialsDocument,
        format_name=FORMAT,
        kind="fiducials document",
        remedy="write it anew with localize",
    )
