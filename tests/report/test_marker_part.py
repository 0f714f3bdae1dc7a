"""Each marker of a document is found again as it was."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from phantoms.fast import render_hu
from phantoms.scene import Part, Scene
from phantoms.solids import sphere
from ronnaplan.documents.fiducials import fiducials_document
from ronnaplan.localization import Build, localize
from ronnaplan.report.marker_part import marker_pictures
from tests.scans import balls, on_grid, scan, small_stack

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


def test_markers_in_slices_far_thicker_than_their_header_are_fitted_as_they_were() -> None:
    places = [(-14.0, -13.6, 1.1), (13.7, -14.2, -0.8), (-13.9, 14.1, 0.3)]
    stack = small_stack(start_mm=-15.0, stop_mm=15.0, spacing_mm=0.6, thickness_mm=0.6)
    images = render_hu(balls(places, 6.0), stack, blur_mm=0.5, noise_hu=10.0, seed=1)
    thick = ndimage.gaussian_filter1d(images, 2.2, axis=0)
    volume = on_grid(np.round(thick).astype(np.int16), stack)
    found = localize(volume, diameter_mm=6.0, expected=3)
    drawn = marker_pictures(volume, fiducials_document(found))
    assert max(one.apart_mm for one in drawn) < 1e-3
