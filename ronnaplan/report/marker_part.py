"""The report's markers: centers, sigmas, flags, cuts with outline and residual."""

from __future__ import annotations

from functools import partial

import numpy as np

from ronnaplan.case.folder import Case
from ronnaplan.documents.fiducials import FiducialEntry
from ronnaplan.errors import RonnaplanError
from ronnaplan.report.html import element, picture, table
from ronnaplan.report.marker_cuts import MarkerPicture, marker_pictures
from ronnaplan.report.part import Part, Piece
from ronnaplan.text import counted, isolated

STYLE = """
.markers figure { display: grid; grid-template-columns: 3rem 1fr; align-items: center; margin: .3rem 0 }
.markers figcaption { order: -1; font-weight: 600 }
"""

HEADER = ("", "x", "y", "z (LPS mm)", "sigma x", "sigma y", "sigma z (um)", "diameter mm", "contrast HU", "flags")
CAPTION = (
    "Cuts through each center with the fitted outline; beside each, data less model at a tenth of the contrast."
)


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
