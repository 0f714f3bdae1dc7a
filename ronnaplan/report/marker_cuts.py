"""Each marker measured again where the document says it is, and drawn with what the model leaves over."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ronnaplan.ct import CTVolume
from ronnaplan.documents.fiducials import FiducialEntry, FiducialsDocument
from ronnaplan.report.contact import Candidate, Pair, cut_pairs, draw_row

if TYPE_CHECKING:
    from ronnaplan.localization import Build
    from ronnaplan.localization.scanner.scan import Scan

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
    from ronnaplan.localization.fit.parameters import full_width_at_half_maximum_mm
    from ronnaplan.localization.scanner.scan import Scan, Slant
    from ronnaplan.localization.scanner.summed import UNTOLD, Summed
    from ronnaplan.localization.scanwide.thick import of_thickness

    seen = found.resolution
    if seen is None:
        scan = thick = Scan.of(volume)
    else:
        width_mm = seen.profile_fwhm_mm / full_width_at_half_maximum_mm(1.0, seen.profile_shape)
        slant = None if seen.profile_axis is None else Slant(np.array(seen.profile_axis), width_mm)
        summed = Summed(first=True, error=0.0) if seen.summed_first else UNTOLD
        scan = Scan.of(volume, slant, summed)
        thick = of_thickness(scan, width_mm)
    build = Build(found.marker.layer_mm)
    return [_picture(scan, thick, marker, build) for marker in found.fiducials]


def _picture(scan: Scan, thick: Scan, marker: FiducialEntry, build: Build) -> MarkerPicture:
    """Fit a marker again, in slices as ``thick`` as the markers showed where their header hides it."""
    from ronnaplan.localization.examine import fit_place

    stated = np.array(marker.center, dtype=np.float64)
    fit = fit_place(scan, stated, marker.diameter_mm, build)
    if not fit.converged:
        fit = fit_place(thick, stated, marker.diameter_mm, build)
    place = Candidate(
        marker.label,
        fit.center_mm,
        fit.theta,
        accepted=True,
        layer_mm=build.layer_mm,
        profile_axis=scan.profile_axis,
    )
    apart_mm = float(np.linalg.norm(fit.center_mm - stated))
    return MarkerPicture(marker.label, apart_mm, place, cut_pairs(scan.volume, place))
