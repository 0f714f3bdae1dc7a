"""Metal beside a ball is found wherever it lies."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from ronnaplan.geometry import FloatArray
from ronnaplan.localization.examine import fit_place
from ronnaplan.localization.judge import held
from ronnaplan.localization.judge.held import is_metal_beyond, metal_beyond
from ronnaplan.localization.scanner.scan import Scan
from tests.scans import balls, scan, small_stack


def test_a_look_into_the_box_about_all_places_passes_no_metal_by() -> None:
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


def test_what_lies_beyond_a_ball_is_looked_up_once_in_the_same_directions_of_the_same_scan(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    looked_up: list[int] = []

    def counted(*asked: Any) -> tuple[FloatArray, NDArray[np.bool_]]:
        looked_up.append(1)
        return in_scan(*asked)

    in_scan = held._metal_in
    monkeypatch.setattr(held, "_metal_in", counted)
    bare = scan(balls([(1.0, 2.0, 3.0)], 6.0), small_stack())
    screwed = replace(bare, voxels_hu=np.where(bare.voxels_hu > 5000, 0, bare.voxels_hu).astype(np.int16))
    screwed.voxels_hu[:12, 60:66, 60:66] = 3000
    down, up = np.array([[0.0, 0.0, -1.0]]), np.array([[0.0, 0.0, 1.0]])
    fit = fit_place(Scan(bare), np.array([1.0, 2.0, 3.0]), 6.0)
    looked_up.clear()
    told = [metal_beyond(volume, fit, way)[1].any() for volume in (screwed, bare) for way in (down, down, up)]
    assert told == [True, True, False, False, False, False]
    assert len(looked_up) == 4
