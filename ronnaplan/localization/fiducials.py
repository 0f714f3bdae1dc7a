"""What localization returns: the markers found, and every rejected candidate with its reason."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING

import numpy as np

from ronnaplan.ct.volume import CTVolume, SeriesSource, VolumeFlag
from ronnaplan.display import Shown, coordinates, head_in_3d
from ronnaplan.geometry import FloatArray, Points, rms_mm
from ronnaplan.localization.build import SIZE_TOLERANCE_MM, SOLID, Build
from ronnaplan.localization.fit.parameters import (
    BLUR,
    CONTRAST,
    RADIUS,
    SHAPE,
    profile_fwhm_mm,
)
from ronnaplan.text import counted, place, sizes

if TYPE_CHECKING:
    from ronnaplan.figures import Picture

LEAST_ALIKE = 3
"""So many markers that are all off the stated diameter, and alike to `SIZE_TOLERANCE_MM`, have another size, and
nothing on them."""

UNSEEN_MOTION_MM = 0.3
"""Standard deviation per axis of what the head is assumed to have moved between two markers' slices, of which no image
tells: of a head that lies still in a cushion. Only distances that are known test it."""


class FiducialFlag(StrEnum):
    """Reasons to doubt a found marker; each value is the sentence shown to the user."""

    CUT = "part of the marker lies outside the scan"
    NEIGHBOUR = "something touches more than a quarter of the marker"
    DIAMETER = "the marker's diameter is not the stated one; something may cover it on one side"
    COVERED = "something lies on the marker"
    MOTION_SUSPECTED = "the marker is not in one place throughout the scan; the head may have moved"
    CLIPPED = "the marker is brighter than the scan's scale"
    THICK_SLICES = "the slices are thicker than half the marker"
    GAPPED = "there are gaps between the slices"


@dataclass(frozen=True, eq=False)
class Fiducial:
    """A marker: center (3,) in LPS mm with covariance (3, 3) in mm^2, and what the fit found beside it.

    ``bound_mm2`` (3, 3) is the Cramer-Rao bound: the covariance that a perfect fit of the whole, untouched ball
    would have under uncorrelated noise of the same strength. ``parameters`` are the model's, in the order of
    `ronnaplan.localization.fit.parameters.PARAMETERS` and those that may follow them. ``coverage`` is the share of the
    surface that informed the fit, ``misfit`` the RMS residual there as a share of the contrast.
    """

    label: str
    center_mm: FloatArray
    covariance_mm2: FloatArray
    bound_mm2: FloatArray
    parameters: FloatArray
    coverage: float
    misfit: float
    flags: tuple[FiducialFlag, ...] = ()

    def __repr__(self) -> str:
        flags = "".join(f", {flag.name.lower()}" for flag in self.flags)
        return (
            f"Fiducial({self.label} at {place(self.center_mm)} mm, error {self.error_rms_mm:.2g} mm RMS, "
            f"diameter {self.diameter_mm:.2f} mm{flags})"
        )

    @property
    def error_rms_mm(self) -> float:
        """Root-mean-square distance between found and true center, over all three axes, that the covariance states."""
        return float(rms_mm(self.covariance_mm2))

    @property
    def standard_error_mm(self) -> float:
        """The old name of `error_rms_mm`, to be removed in 0.4."""
        warnings.warn("Fiducial.standard_error_mm is now error_rms_mm", DeprecationWarning, stacklevel=2)
        return self.error_rms_mm

    @property
    def efficiency(self) -> float:
        """Variance of the bound as a share of the stated one: 1 is a perfect fit, less is what neighbours cost."""
        return float(np.trace(self.bound_mm2) / np.trace(self.covariance_mm2))

    @property
    def diameter_mm(self) -> float:
        """Fitted diameter."""
        return float(2.0 * self.parameters[RADIUS])

    @property
    def sigma_mm(self) -> float:
        """Fitted in-plane blur of the scanner (standard deviation)."""
        return float(self.parameters[BLUR])

    @property
    def profile_mm(self) -> float:
        """Full width at half maximum of the fitted slice profile."""
        return profile_fwhm_mm(self.parameters)

    @property
    def contrast_hu(self) -> float:
        """Fitted contrast of the ball to its surroundings."""
        return float(self.parameters[CONTRAST])


@dataclass(frozen=True, eq=False)
class Rejected:
    """A place that was looked at closely and is no marker: ``center_mm`` (3,), and the test that it failed.

    ``parameters`` and ``fitted_mm`` (3,) are the fit that was turned down.
    """

    center_mm: FloatArray
    test: str
    reason: str
    parameters: FloatArray
    fitted_mm: FloatArray

    def __repr__(self) -> str:
        return f"Rejected(at {place(self.center_mm)} mm: {self.reason})"


@dataclass(frozen=True, eq=False)
class Resolution:
    """How sharp a scan's markers look, the middle of them, beside what its header says."""

    blur_mm: float
    """Standard deviation of the blur within the slices."""
    profile_mm: float
    """Full width at half maximum of the slice profile."""
    shape: float
    """The profile's shape: 0 a box, from 4 on a bell."""
    stated_mm: float | None
    """The header's slice thickness, if it has one."""
    profile_axis: FloatArray | None = None
    """Unit vector (3,) in LPS along which the profile blurs; None where that is the slices' normal."""
    summed_first: bool | None = None
    """Whether rays were summed before the logarithm, which is made good; None where nothing tells."""


@dataclass(frozen=True, eq=False, repr=False)
class Fiducials(Shown[Fiducial]):
    """The markers of one scan, ordered from the top of the head down, with where they come from: a sequence of them.

    ``rejected`` were looked at closely and are none; ``diameters_mm`` and ``marker`` (how a ball is built) were sought.
    ``volume_flags`` are doubts about the scan itself, ``stated_thickness_mm`` is its header's slice thickness.
    """

    fiducials: tuple[Fiducial, ...]
    rejected: tuple[Rejected, ...]
    diameters_mm: tuple[float, ...]
    source: SeriesSource
    voxel_sha256: str
    volume_flags: tuple[VolumeFlag, ...] = ()
    marker: Build = SOLID
    stated_thickness_mm: float | None = None
    distance_error_mm: float | None = None
    """By how much the markers' distances depart from those of a template at most; None without one."""
    profile_axis: FloatArray | None = None
    """Unit vector (3,) in LPS along which the slices' profile blurs; None where that is their normal."""
    summed_first: bool | None = None
    """Whether rays were summed before the logarithm, which is made good; None where nothing tells."""
    distortion: str | None = None
    """How the scan's geometry may be wrong, as markers or candidates that are alike ellipsoids tell; else None."""

    def _items(self) -> Sequence[Fiducial]:
        return self.fiducials

    def _headline(self) -> str:
        doubted = sum(bool(found.flags) for found in self)
        flags = f", {doubted} flagged" if doubted else ""
        hint = f", {self.other_size}" if self.other_size else ""
        hint += "" if len(self) else "; localization.sizes_seen(volume) tells what is there"
        hint = hint if self.distortion is None else f"; {self.distortion}"
        rejected = counted(len(self.rejected), "candidate")
        return f"{counted(len(self), 'marker')} of {sizes(self.diameters_mm)} mm{flags}{hint}, {rejected} rejected"

    @property
    def other_diameter_mm(self) -> float | None:
        """The diameter that all markers have where it is not the stated one; None where it is, or they differ.

        Those that are clipped do not show theirs.
        """
        measured = np.array([found.diameter_mm for found in self if FiducialFlag.CLIPPED not in found.flags])
        off = all(FiducialFlag.DIAMETER in found.flags for found in self)
        if len(self.diameters_mm) > 1 or len(measured) < LEAST_ALIKE or not off:
            return None
        middle = float(np.median(measured))
        return middle if np.abs(measured - middle).max() < SIZE_TOLERANCE_MM else None

    @property
    def other_size(self) -> str:
        """Which markers have `other_diameter_mm`, in words; empty where none have."""
        some_hide_it = any(FiducialFlag.CLIPPED in found.flags for found in self)
        other, who = self.other_diameter_mm, "all that show their size" if some_hide_it else "all"
        return "" if other is None else f"{who} measure {other:.2f} mm"

    def _columns(self) -> Mapping[str, Sequence[object]]:
        errors = [np.sqrt(np.diag(found.covariance_mm2)) for found in self]
        return {
            "label": list(self.labels),
            **coordinates("", self.centers),
            **coordinates("sigma_", errors),
            "diameter_mm": [found.diameter_mm for found in self],
            "contrast_hu": [found.contrast_hu for found in self],
            "coverage": [found.coverage for found in self],
            "misfit": [found.misfit for found in self],
            "flags": ["; ".join(found.flags) for found in self],
        }

    def plot(self, volume: CTVolume | None = None) -> Picture:
        """Return the markers from three sides; given their scan's ``volume``, before its silhouette.

        Then they are shown on its head in 3-D, too, where pyvista is installed.
        """
        from ronnaplan.ct.silhouette import silhouettes
        from ronnaplan.figures import ThreeViews

        views = ThreeViews(self._headline(), head=None if volume is None else head_in_3d(self, volume))
        views.points(self.centers, self.labels)
        if volume is None:
            views.frame(self.centers)
        else:
            views.silhouettes(silhouettes(volume))
        return views.picture

    @property
    def centers(self) -> FloatArray:
        """Centers (N, 3) in LPS mm."""
        return np.array([found.center_mm for found in self.fiducials], dtype=np.float64).reshape(-1, 3)

    @property
    def covariances(self) -> FloatArray:
        """Covariances (N, 3, 3) in mm^2."""
        return np.array([found.covariance_mm2 for found in self.fiducials], dtype=np.float64).reshape(-1, 3, 3)

    @property
    def resolution(self) -> Resolution | None:
        """How sharp the markers look; None without markers."""
        if not self.fiducials:
            return None
        blur_mm, shape = np.median([found.parameters[[BLUR, SHAPE]] for found in self.fiducials], axis=0)
        profile_mm = float(np.median([found.profile_mm for found in self.fiducials]))
        stated = self.stated_thickness_mm, self.profile_axis, self.summed_first
        return Resolution(float(blur_mm), profile_mm, float(shape), *stated)

    @property
    def labels(self) -> tuple[str, ...]:
        """Labels, F1 upwards."""
        return tuple(found.label for found in self.fiducials)

    @property
    def points(self) -> Points:
        """The markers as labelled points of the scan's frame."""
        return Points(self.centers, self.covariances, self.labels, self.source.frame)
