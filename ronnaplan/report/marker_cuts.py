"""Each marker measured again where the document says it is, and drawn with what the model leaves over."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ronnaplan.ct import CTVolume
from ronnaplan.documents.fiducials import FiducialEntry, FiducialsDocument
from ronnaplan.report.contact import Candidate, Pair, cut_pairs, draw_row

if TYPE_CHECKING:
    from ronnaplan.documents.fiducials import Resolution as ResolutionEntry
    from ronnaplan.localization import Build, Resolution
    from ronnaplan.localization.known_scan import KnownScan

AGREEMENT_MM = 0.05
"""A marker that is found again farther than this from where its document says it is raises a warning."""


@dataclass(frozen=True, eq=False)
class MarkerPicture:
    """Three cuts with residuals, and how far (mm) the marker was found from its stated center."""

    label: str
    apart_mm: float
    place: Candidate
    pairs: list[Pair]

    @property
    def agrees(self) -> bool:
        """Whether the document's center was found again."""
        return self.apart_mm <= AGREEMENT_MM

    @property
    def png(self) -> bytes:
        """The picture, drawn when it is asked for: by then its scan may be gone."""
        return draw_row(self.place, self.pairs)


def marker_pictures(volume: CTVolume, found: FiducialsDocument) -> list[MarkerPicture]:
    """Fit every marker of a document again in its scan; the pictures hold what they show, and no voxels."""
    from ronnaplan.localization import Build
    from ronnaplan.localization.known_scan import KnownScan

    known = KnownScan.of(volume, None if found.resolution is None else _resolution(found.resolution))
    build = Build(found.marker.layer_mm)
    return [_picture(known, marker, build) for marker in found.fiducials]


def _resolution(entry: ResolutionEntry) -> Resolution:
    """Return how sharp the markers looked, as the localizer tells it."""
    from ronnaplan.localization import Resolution

    return Resolution(
        blur_mm=entry.blur_mm,
        profile_mm=entry.profile_fwhm_mm,
        shape=entry.profile_shape,
        stated_mm=entry.stated_thickness_mm,
        profile_axis=None if entry.profile_axis is None else np.array(entry.profile_axis),
        summed_first=entry.summed_first,
    )


def _picture(known: KnownScan, marker: FiducialEntry, build: Build) -> MarkerPicture:
    """Fit a marker again, and cut the scan through it."""
    stated = np.array(marker.center, dtype=np.float64)
    fit = known.fit(stated, marker.diameter_mm, build)
    place = Candidate(
        marker.label,
        fit.center_mm,
        fit.theta,
        accepted=True,
        layer_mm=build.layer_mm,
        profile_axis=known.scan.profile_axis,
    )
    apart_mm = float(np.linalg.norm(fit.center_mm - stated))
    return MarkerPicture(marker.label, apart_mm, place, cut_pairs(known.scan.volume, place))
