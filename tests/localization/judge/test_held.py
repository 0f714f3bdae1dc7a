"""Metal beside a ball is found wherever it lies."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ronnaplan.localization.examine import fit_place
from ronnaplan.localization.judge.held import is_metal_beyond, metal_beyond
from ronnaplan.localization.scanner.scan import Scan
from tests.scans import balls, scan, small_stack


def test_a_look_along_whole_rows_passes_no_metal_by() -> None:
    """Spots of metal, of which one in a few is where something is looked for."""
    volume = scan(balls([(1.0, 2.0, 3.0)], 6.0), small_stack())
    fit, draws, found = fit_place(Scan(volume), np.array([1.0, 2.0, 3.0]), 6.0), np.random.default_rng(4), []
    turns = np.linspace(0.0, 2.0 * np.pi, 48, endpoint=False)
    around = np.column_stack([np.cos(turns), np.sin(turns), np.zeros(48)])
    near = np.flatnonzero(np.abs(volume.grid.slice_positions_mm - 3.0) < 4.0)
    for _ in range(40):
        k, j, i = draws.choice(near), *(int(draws.integers(size)) for size in volume.voxels_hu.shape[1:])
        voxels_hu = volume.voxels_hu.copy()
        voxels_hu[k, j : j + 2, i : i + 2] = 3000
        spotted = replace(volume, voxels_hu=voxels_hu)
        found.append(bool(metal_beyond(spotted, fit, around)[1].any()))
        assert is_metal_beyond(spotted, fit, around) == found[-1]
    assert 5 < sum(found) < 35
