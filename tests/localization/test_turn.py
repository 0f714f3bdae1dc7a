"""What a turn makes of a ball that it sees in other places from other directions is measured as far as it is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import fft

from ronnaplan.ct import CTVolume
from ronnaplan.geometry import FloatArray
from ronnaplan.localization.build import SOLID
from ronnaplan.localization.examine import examine_place
from ronnaplan.localization.motion import PATTERNS
from ronnaplan.localization.scan import Scan
from tests.scans import balls, scan, small_stack

CENTER = (1.3, -2.4, 0.7)


def seen_displaced(still: CTVolume, harmonic: str, by_mm: float) -> CTVolume:
    """Return a scan whose views each see all displaced: by the cosine or sine of a multiple of their direction."""
    grid = still.grid
    steps = (grid.typical_gap_mm, grid.row_spacing_mm, grid.column_spacing_mm)
    across, down, along = np.meshgrid(
        *(fft.fftfreq(size, step) for size, step in zip(still.voxels_hu.shape, steps, strict=True)), indexing="ij"
    )
    direction = np.arctan2(down, along)
    order, wave = harmonic.split()
    multiple = {"third": 3, "fifth": 5, "across": 2}[order]
    turned = multiple * direction
    far_mm = by_mm * (np.cos(turned) if wave == "cos" else np.sin(turned))
    frequency: FloatArray = across if order == "across" else np.hypot(down, along)
    spectrum: NDArray[np.complex128] = fft.fftn(still.voxels_hu.astype(float))
    moved = fft.ifftn(spectrum * np.exp(-2j * np.pi * frequency * far_mm)).real
    return replace(still, voxels_hu=np.asarray(np.round(moved), dtype=np.int16))


@pytest.mark.parametrize("harmonic", ["third cos", "third sin", "fifth cos", "across sin"])
@pytest.mark.parametrize(("diameter_mm", "blur_mm"), [(11.5, 0.5), (5.0, 0.7)])
def test_the_bending_is_measured_as_large_as_it_is(harmonic: str, diameter_mm: float, blur_mm: float) -> None:
    """Small balls under soft kernels show it less at their edges than in the streaks beside them."""
    stack = small_stack(spacing_mm=0.5)
    still = scan(balls([CENTER], diameter_mm), stack, blur_mm=blur_mm, noise_hu=2.0)
    bent = seen_displaced(still, harmonic, 0.04)
    found = examine_place(Scan(bent), np.array(CENTER), diameter_mm, SOLID)
    assert found.movement is not None, found.failures
    expected_mm = np.where(np.array(PATTERNS) == harmonic, 0.04, 0.0)
    within_turn = slice(PATTERNS.index("third cos"), None)
    off_mm = found.movement.amplitudes_mm[within_turn] - expected_mm[within_turn]
    assert np.abs(off_mm).max() < 0.004
