"""The measured voxels about a place."""

from __future__ import annotations

import numpy as np

from ronnaplan.localization.fit.neighbourhood import gather
from ronnaplan.planning.voxels import voxels_near
from tests import cases


def test_voxels_about_a_place_are_those_that_the_compiled_way_gathers() -> None:
    volume = cases.volume()
    for place, reach in (
        (cases.ENTRY_MM, 9.0),
        (np.array([-95.0, 0.0, -20.0]), 20.0),
        (np.array([0.0, 0.0, 900.0]), 5.0),
    ):
        compiled = gather(volume, place, reach, volume.grid.axes)
        offsets, values = voxels_near(volume, place, reach)
        np.testing.assert_array_equal(values, compiled.values_hu)
        np.testing.assert_allclose(offsets, compiled.offsets_mm @ compiled.axes, atol=1e-9)
