"""Balls that metal artifact reduction put back in are refused for that, and not for a size that is the threshold's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ronnaplan.ct import CTVolume
from ronnaplan.localization import localize
from tests.scans import balls, scan, small_stack

THRESHOLD_HU = 2500.0


@pytest.fixture(scope="module")
def ceramic() -> CTVolume:
    return scan(balls([(-10.0, 2.0, 3.0), (12.0, -4.0, -5.0)], 8.0, "ceramic"), small_stack())


def metal_reduced(volume: CTVolume) -> CTVolume:
    """Return a scan with what is brighter than the threshold as it was, in the middle of what lines leave of it."""
    lines_hu = -1000.0 + 0.4 * (volume.voxels_hu + 1000.0)
    reduced = np.where(volume.voxels_hu > THRESHOLD_HU, volume.voxels_hu, lines_hu)
    return replace(volume, voxels_hu=reduced.astype(np.int16))


def test_what_artifact_reduction_put_back_is_said_to_be(ceramic: CTVolume) -> None:
    found = localize(metal_reduced(ceramic), diameter_mm=8.0)
    assert len(found) == 0
    assert len(found.rejected) == 2
    for one in found.rejected:
        assert one.test == "pasted"
        assert "artifact reduction puts back in; localize in the images without it" in one.reason


def test_what_a_scanner_blurred_is_not_said_to_be_put_back(ceramic: CTVolume) -> None:
    """Teeth and screws are as bright; and so are balls of another size."""
    assert len(localize(ceramic, diameter_mm=8.0)) == 2
    assert [one.test for one in localize(ceramic, diameter_mm=9.0).rejected] == ["diameter", "diameter"]
