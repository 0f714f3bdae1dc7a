"""What localization returns: the markers found, and every rejected candidate with its reason."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from ronnaplan.ct.volume import SeriesSource, VolumeFlag
from ronnaplan.geometry import FloatArray, Frame, Points


class FiducialFlag(StrEnum):
    """Reasons to doubt a found marker; each value is the sentence shown to the user."""

    CUT = "part of the marker lies outside the scan"
    NEIGHBOUR = "something touches more than a quarter of the marker"
    CLIPPED = "the marker is brighter than the scan's scale"
    THICK_SLICES = "the slices are thicker than half the marker"


@dataclass(frozen=True)
class Fiducial:
    """A marker: centre (3,) in LPS mm with covariance (3, 3) in mm^2, and what the fit found beside it.

    ``coverage`` is the share of its surface that informed the fit, ``misfit`` the RMS residual there as a share
    of the contrast, ``sigma_mm`` the scanner's in-plane blur.
    """

    label: str
    center_mm: FloatArray
    covariance_mm2: FloatArray
    diameter_mm: float
    contrast_hu: float
    sigma_mm: float
    coverage: float
    misfit: float
    flags: tuple[FiducialFlag, ...] = ()

    @property
    def standard_error_mm(self) -> float:
        """Root mean square distance between found and true centre that the covariance stands for."""
        return float(np.sqrt(np.trace(self.covariance_mm2)))


@dataclass(frozen=True)
class Rejected:
    """A place that was looked at closely and is no marker: ``center_mm`` (3,), and the test that it failed."""

    center_mm: FloatArray
    test: str
    reason: str


@dataclass(frozen=True)
class Fiducials:
    """The markers of one scan, ordered from the top of the head down, with where they come from."""

    fiducials: tuple[Fiducial, ...]
    rejected: tuple[Rejected, ...]
    diameter_mm: float
    source: SeriesSource
    voxel_sha256: str
    volume_flags: tuple[VolumeFlag, ...] = ()

    def __len__(self) -> int:
        return len(self.fiducials)

    @property
    def centers(self) -> FloatArray:
        """Centres (N, 3) in LPS mm."""
        return np.array([found.center_mm for found in self.fiducials], dtype=np.float64).reshape(-1, 3)

    @property
    def covariances(self) -> FloatArray:
        """Covariances (N, 3, 3) in mm^2."""
        return np.array([found.covariance_mm2 for found in self.fiducials], dtype=np.float64).reshape(-1, 3, 3)

    @property
    def labels(self) -> tuple[str, ...]:
        """Labels, F1 upwards."""
        return tuple(found.label for found in self.fiducials)

    @property
    def points(self) -> Points:
        """The markers as labelled points of the scan's frame."""
        frame = Frame("CT", self.source.frame_of_reference_uid)
        return Points(self.centers, self.covariances, self.labels, frame)
