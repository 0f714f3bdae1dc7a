"""The report's markers: centers, sigmas, flags, cuts with outline and residual.

Each is measured again where the document says it is, and drawn with what the model leaves over.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from ronnaplan.case.folder import Case
from ronnaplan.ct import CTVolume
from ronnaplan.documents.fiducials import FiducialEntry, FiducialsDocument
from ronnaplan.errors import RonnaplanError
from ronnaplan.report.contact import Candidate, Pair, cut_pairs, draw_row
from ronnaplan.report.html import Part, Piece, element, picture, table
from ronnaplan.text import counted, isolated

if TYPE_CHECKING:
    from ronnaplan.documents.fiducials import Resolution as ResolutionEntry
    from ronnaplan.localization import Build, Resolution
    from ronnaplan.localization.known_scan import KnownScan


STYLE = """
.markers figure { display: grid; grid-template-columns: 3rem 1fr; align-items: center; margin: .3rem 0 }
.markers figcaption { order: -1; font-weight: 600 }
"""

HEADER = ("", "x", "y", "z (LPS mm)", "sigma x", "sigma y", "sigma z (um)", "diameter mm", "contrast HU", "flags")
CAPTION = (
    "Cuts through each center with the fitted outline; beside each, data less model at a tenth of the contrast."
)


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


def markers_part(case: Case) -> Part:
    """List and draw the markers; a marker that is not found again where it is stated is a warning."""
    if case.fiducials is None:
        return Part("Markers", warnings=["there is no fiducials.json: the markers are not reported"])
    markers = case.fiducials.fiducials
    body: list[Piece] = [table(HEADER, [_row(marker) for marker in markers])] if markers else []
    rejected = counted(len(case.fiducials.rejected), "candidate")
    body.append(element("p", f"{counted(len(markers), 'marker')}; {rejected} rejected."))
    warnings = list(case.fiducials.doubts)
    if case.volume is None:
        return Part("Markers", body, warnings)
    try:
        pictures = marker_pictures(case.volume, case.fiducials)
    except RonnaplanError as error:
        return Part("Markers", body, [*warnings, f"the markers could not be drawn: {error}"])
    if pictures:
        body += [element("p", CAPTION, "note"), partial(_drawn, pictures)]
    warnings += [
        f"marker {one.label} was found again {one.apart_mm:.2f} mm from its stated center; localize again"
        for one in pictures
        if not one.agrees
    ]
    return Part("Markers", body, warnings)


def _drawn(pictures: list[MarkerPicture]) -> str:
    drawn = "".join(picture(one.png, one.label) for one in pictures)
    return f'<div class="markers">{drawn}</div>'


def _row(marker: FiducialEntry) -> list[str]:
    errors = 1e3 * np.sqrt(np.diag(np.array(marker.covariance)))
    return [
        isolated(marker.label),
        *(f"{value:.3f}" for value in marker.center),
        *(f"{error:.1f}" for error in errors),
        f"{marker.diameter_mm:.3f}",
        f"{marker.contrast_hu:.0f}",
        ", ".join(marker.flags) or "-",
    ]
