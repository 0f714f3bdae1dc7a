"""The coarse surfaces of the 3-D view lie where the scan has them."""

from __future__ import annotations

import numpy as np
import pytest

from ronnaplan.scene.surfaces import SURFACES_HU, region, surface
from tests.scans import balls, scan, small_stack


@pytest.mark.parametrize("tilt_deg", [0.0, 15.0])
def test_the_surface_of_a_ball_lies_at_its_radius(tilt_deg: float) -> None:
    center = np.array([2.0, -3.0, 1.0])
    vertices, triangles = surface(scan(balls([tuple(center)], 20.0), small_stack(tilt_deg=tilt_deg)), -400.0)
    assert len(triangles) > 100
    radii = np.linalg.norm(vertices - center, axis=1)
    assert radii == pytest.approx(10.0, abs=1.25)  # half a coarse cell
    assert radii.mean() == pytest.approx(10.0, abs=0.35)


def test_an_empty_scan_has_no_surface() -> None:
    volume = scan(balls([(300.0, 0.0, 0.0)]), small_stack())
    assert all(len(part) == 0 for part in surface(volume, SURFACES_HU["skull"]))
    assert len(region(volume, np.zeros(volume.voxels_hu.shape, dtype=np.bool_))[1]) == 0
