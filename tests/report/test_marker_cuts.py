"""Each marker of a document is found again as it was."""

from __future__ import annotations

import pytest

from phantoms.scene import Part, Scene
from phantoms.solids import sphere
from ronnaplan.documents.fiducials import fiducials_document
from ronnaplan.localization import Build, localize
from ronnaplan.report.marker_cuts import marker_pictures
from tests.scans import balls, scan, small_stack

CENTER = (1.3, 2.2, 3.1)


@pytest.mark.parametrize(("cavity_mm", "build"), [(0.0, "solid"), (9.5, "shell:1")])
def test_markers_are_fitted_as_they_are_built(cavity_mm: float, build: str) -> None:
    cavity = Scene((Part(sphere(CENTER, cavity_mm), "air"),) if cavity_mm else ())
    post = Scene((Part(sphere((CENTER[0], CENTER[1], CENTER[2] - 7.5), 5.0), "acrylic"),))
    volume = scan(balls([CENTER]) + cavity + post, small_stack(thickness_mm=0.6, spacing_mm=0.6))
    found = localize(volume, diameter_mm=11.5, expected=1, marker=Build.parse(build))
    (drawn,) = marker_pictures(volume, fiducials_document(found))
    assert drawn.png.startswith(b"\x89PNG")
    assert drawn.apart_mm < 1e-3
