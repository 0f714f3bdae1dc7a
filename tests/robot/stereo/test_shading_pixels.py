"""The pixels of a sphere that are fitted."""

import numpy as np
import pytest

from ronnaplan.robot.stereo.camera import Camera
from ronnaplan.robot.stereo.shading_pixels import OUTWARD_PX, pixels_near

FOCAL_PX, SIZE = 4000.0, (480, 480)
MATRIX = np.array([[FOCAL_PX, 0, 240], [0, FOCAL_PX, 240], [0, 0, 1]])


@pytest.mark.parametrize("radius_px", [40, 100, 180])
def test_every_pixel_of_a_sphere_counts_and_large_ones_are_averaged_beside_the_edge(radius_px: int) -> None:
    columns, rows = (one - 240.0 for one in np.meshgrid(np.arange(SIZE[1]), np.arange(SIZE[0])))
    grey = 100 + 0.2 * columns - 0.1 * rows
    axis, across = np.array([0.0, 0, 1]), np.eye(3)[:, :2]
    camera = Camera(MATRIX, np.zeros(5), np.eye(4))
    found = pixels_near(grey, camera, axis, across, radius_px / FOCAL_PX)
    seen = int((np.hypot(columns, rows) <= radius_px + OUTWARD_PX).sum())
    assert (found.weights**2).sum() == pytest.approx(seen, abs=20)  # places on the bound
    assert len(found.grey) == found.starts[-1] <= 4000 + 2 * np.pi * radius_px * 30
    assert found.grey == pytest.approx(100 + found.places @ (0.2, -0.1), abs=1e-6)
    outside = np.hypot(*found.places.T) - radius_px
    assert (found.weights[np.abs(outside) < 6] == 1).all()
    for side in (outside < -6, outside > 6):
        assert (found.weights[side].max() > 1) == (radius_px > 42)
