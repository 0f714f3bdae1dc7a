"""fiducials.json: the markers of one scan, with covariances, and the candidates that were turned down."""

from __future__ import annotations

import os
from typing import Literal

import numpy as np
from pydantic import model_validator

from ronnaplan.ct.identity import ScanIdentity
from ronnaplan.ct.volume import VolumeFlag
from ronnaplan.documents.fields import (
    Coordinate,
    Covariance,
    Direction,
    DocumentModel,
    Hounsfield,
    Label,
    LengthMm,
    Line,
    MarkerCovariance,
    PositiveMm,
    Probability,
    Ratio,
    Revision,
    Software,
    Vector,
    flag_sentence,
    require_different_names,
)
from ronnaplan.documents.reading import made, read_document
from ronnaplan.errors import check_type
from ronnaplan.geometry import FloatArray, Frame, Points, mutual_distances, rms_mm
from ronnaplan.localization.fiducials import UNSEEN_MOTION_MM, FiducialFlag, Fiducials
from ronnaplan.text import counted, sizes

FORMAT = "ronnaplan.fiducials"
LEAST_APART = 0.25
"""Balls whose centers are nearer to each other than this share of the smallest diameter are one ball, named twice. The
localizer keeps apart what is twice as far."""
FEW = 200
"""So many markers have all their distances taken; a tree is faster from some thousand on, but is long to load."""


class Source(DocumentModel):
    """Where the scan comes from; nothing here names the patient."""

    study_instance_uid: Line | None = None
    series_instance_uid: Line | None = None
    frame_of_reference_uid: Line | None = None
    voxel_sha256: Line | None = None
    flags: tuple[Line, ...] = ()
    """Reasons to doubt the scan's volume."""
    distortion: Line | None = None
    """How its geometry may be wrong, as markers or candidates that are alike ellipsoids tell."""

    @property
    def frame(self) -> Frame:
        """The scan's frame of reference."""
        return Frame("CT", self.frame_of_reference_uid)

    def identity(self, name: str, frame: Frame) -> ScanIdentity:
        """Return the scan of a document, which is called ``name`` and whose points are in ``frame``."""
        return ScanIdentity(name, frame, self.series_instance_uid, self.voxel_sha256)

    @property
    def doubts(self) -> tuple[str, ...]:
        """Why the scan should be doubted, a sentence each."""
        wrong = () if self.distortion is None else (self.distortion,)
        return tuple(
            f"the scan: {why}" for why in (*(flag_sentence(VolumeFlag, flag) for flag in self.flags), *wrong)
        )


class Sought(DocumentModel):
    """What was looked for."""

    diameter_mm: PositiveMm
    diameters_mm: tuple[PositiveMm, ...] = ()
    """All sizes that were looked for, where there are several."""
    layer_mm: Coordinate = 0.0
    """A hollow marker's wall below zero, a wrapping's thickness above."""


class Resolution(DocumentModel):
    """How sharp the markers look, beside what the scan's header says."""

    blur_mm: PositiveMm
    """Standard deviation of the blur within the slices."""
    profile_fwhm_mm: PositiveMm
    """Full width at half maximum of the slice profile."""
    profile_shape: Ratio
    """0 is a box, from 4 on a bell."""
    stated_thickness_mm: PositiveMm | None = None
    profile_axis: Direction | None = None
    """Along what the profile blurs, where that is not the slices' normal: they were computed obliquely from others."""
    summed_first: bool | None = None
    """Whether rays were summed before the logarithm was taken, which is made good; null where nothing tells."""


class Motion(DocumentModel):
    """What no image shows: that the head moved between two markers."""

    assumed_mm: LengthMm
    """Standard deviation per axis that is assumed, and not part of any covariance."""
    distance_error_mm: LengthMm | None = None
    """By how much known distances (a template's) are off at most; none were known where this is missing."""


class FiducialEntry(DocumentModel):
    """One marker: center in LPS mm, covariance in mm^2, and what the fit found beside it."""

    label: Label
    center: Vector
    covariance: MarkerCovariance
    diameter_mm: PositiveMm
    contrast_hu: Hounsfield
    flags: tuple[Line, ...] = ()
    bound: Covariance | None = None
    """Cramer-Rao bound (mm^2) of a whole, untouched ball."""
    coverage: Probability | None = None
    """Share of the surface that informed the fit."""
    misfit: Ratio | None = None
    """RMS residual as a share of the contrast."""

    @property
    def error_rms_mm(self) -> float:
        """Expected distance (root mean square) of the center from the truth."""
        return float(rms_mm(np.array(self.covariance)))

    @property
    def doubts(self) -> tuple[str, ...]:
        """Why the marker should be doubted, a sentence each."""
        return tuple(flag_sentence(FiducialFlag, flag) for flag in self.flags)


class RejectedEntry(DocumentModel):
    """One candidate that is no marker, and why."""

    center: Vector
    reason: Line
    test: Line | None = None
    """The localizer's test that it failed."""
    marker: FiducialEntry | None = None
    """The whole marker, where a person turned it down: it can be taken back."""


class FiducialsDocument(DocumentModel):
    """The whole of fiducials.json, version 1."""

    format: Literal["ronnaplan.fiducials"]
    version: Literal[1]
    coordinate_system: Literal["LPS"]
    unit: Literal["mm"]
    revision: Revision = 0
    source: Source
    marker: Sought
    resolution: Resolution | None = None
    motion: Motion | None = None
    fiducials: tuple[FiducialEntry, ...]
    rejected: tuple[RejectedEntry, ...] = ()
    software: Software

    @model_validator(mode="after")
    def _check(self) -> FiducialsDocument:
        require_different_names("fiducials", [entry.label for entry in self.fiducials])
        _check_apart(self.fiducials)
        return self

    def __repr__(self) -> str:
        looked_for = sizes(self.marker.diameters_mm or (self.marker.diameter_mm,))
        doubted = sum(bool(entry.flags) for entry in self.fiducials)
        flags = f", {doubted} flagged" if doubted else ""
        found, rejected = counted(len(self.fiducials), "marker"), counted(len(self.rejected), "candidate")
        return f"FiducialsDocument({found} of {looked_for} mm{flags}, {rejected} rejected)"

    __str__ = __repr__

    @property
    def points(self) -> Points:
        """The markers as labelled points of the scan's frame."""
        return Points(
            np.array([entry.center for entry in self.fiducials], dtype=np.float64).reshape(-1, 3),
            np.array([entry.covariance for entry in self.fiducials], dtype=np.float64).reshape(-1, 3, 3),
            tuple(entry.label for entry in self.fiducials),
            self.source.frame,
        )

    @property
    def identity(self) -> ScanIdentity:
        """The scan that the markers are in."""
        return self.source.identity("the markers' document", self.points.frame)

    @property
    def radii_mm(self) -> FloatArray:
        """How far (N,) the markers reach about their centers, with what they are wrapped in."""
        wrapped_mm = max(self.marker.layer_mm, 0.0)
        return np.array([entry.diameter_mm / 2 + wrapped_mm for entry in self.fiducials], dtype=np.float64)

    @property
    def doubts(self) -> tuple[str, ...]:
        """Why markers should be doubted, a sentence each."""
        return tuple(f"marker {one.label}: {doubt}" for one in self.fiducials for doubt in one.doubts)


def _check_apart(entries: tuple[FiducialEntry, ...]) -> None:
    if len(entries) < 2:
        return
    apart_mm, first, other = _closest(np.array([one.center for one in entries]))
    least_mm = LEAST_APART * min(one.diameter_mm for one in entries)
    if apart_mm < least_mm:
        raise ValueError(
            f"the fiducials {entries[first].label} and {entries[other].label} are {apart_mm:.3g} mm "
            f"apart; expected {least_mm:.3g} mm at least"
        )


def _closest(centers_mm: FloatArray) -> tuple[float, int, int]:
    """Return how far apart the closest two of ``centers_mm`` (N, 3) are, and their numbers."""
    if len(centers_mm) > FEW:
        from scipy.spatial import KDTree

        near_mm, near = (np.asarray(found) for found in KDTree(centers_mm).query(centers_mm, k=2))
        first = int(near_mm[:, 1].argmin())
        return float(near_mm[first, 1]), first, next(int(each) for each in near[first] if each != first)
    distances_mm = mutual_distances(centers_mm)
    np.fill_diagonal(distances_mm, np.inf)
    first, other = divmod(int(distances_mm.argmin()), len(centers_mm))
    return float(distances_mm[first, other]), first, other


def fiducials_document(found: Fiducials) -> FiducialsDocument:
    """Turn the localizer's result into its document."""
    check_type(found, Fiducials, "what was found", "localize returns it")
    return made(
        FiducialsDocument,
        {
            "source": {
                **found.source.uids,
                "voxel_sha256": found.voxel_sha256,
                "flags": [flag.name.lower() for flag in found.volume_flags],
                "distortion": found.distortion,
            },
            "marker": {
                "diameter_mm": found.diameters_mm[0],
                "diameters_mm": found.diameters_mm,
                "layer_mm": found.marker.layer_mm,
            },
            "resolution": _resolution(found),
            "motion": {"assumed_mm": UNSEEN_MOTION_MM, "distance_error_mm": found.distance_error_mm},
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
        },
    )


def _resolution(found: Fiducials) -> dict[str, object] | None:
    seen = found.resolution
    if seen is None:
        return None
    return {
        "blur_mm": seen.blur_mm,
        "profile_fwhm_mm": seen.profile_mm,
        "profile_shape": seen.shape,
        "stated_thickness_mm": seen.stated_mm,
        "profile_axis": None if seen.profile_axis is None else seen.profile_axis.tolist(),
        "summed_first": seen.summed_first,
    }


def read_fiducials(path: str | os.PathLike[str]) -> FiducialsDocument:
    """Read and check fiducials.json; raises `InputError` naming the first field that is wrong."""
    return read_document(path, FiducialsDocument, kind="fiducials document", remedy="write it anew with localize")
