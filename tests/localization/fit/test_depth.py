"""How deep voxels lie in a ball, and which of them its fit reaches."""

import numpy as np
import pytest

from ronnaplan.localization.fit.depth import edge_depth, squares_within_reach, within_reach
from ronnaplan.localization.fit.parameters import BLUR, PARAMETERS, RADIUS, WIDTH


@pytest.mark.parametrize(
    ("radius_mm", "blur_mm", "width_mm"), [(5.75, 0.5, 1.0), (1.5, 0.1, 5.0), (1.5, 2.5, 0.02)]
)
def test_every_voxel_that_a_fit_reaches_is_judged(radius_mm: float, blur_mm: float, width_mm: float) -> None:
    theta = np.zeros(len(PARAMETERS))
    theta[RADIUS], theta[BLUR], theta[WIDTH] = radius_mm, blur_mm, width_mm
    # Along the slices' normal and across it the blur is widest, and so is the reach: to the last digits there.
    inclined = np.linspace(0.0, np.pi / 2.0, 7)
    towards = np.column_stack([np.sin(inclined), np.zeros(7), np.cos(inclined)])
    places_mm = np.concatenate([far_mm * towards for far_mm in np.linspace(0.0, radius_mm + 9.0, 20001)])
    reached = within_reach(*edge_depth(places_mm, theta))
    least, most = squares_within_reach(theta)
    squares = np.sum(places_mm**2, axis=1)
    assert reached.any()
    assert np.all((squares[reached] > least) & (squares[reached] < most))
    # No more is asked for than the widest blur makes needed.
    assert squares[reached].max() > 0.999 * most
