"""Metal beside a ball is found wherever it lies."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from phantoms.scene import Part, Scene
from phantoms.solids import cylinder
from ronnaplan.localization.examine import fit_place
from ronnaplan.localization.judge import held
from ronnaplan.localization.judge.evidence import Evidence
from ronnaplan.localization.judge.held import is_metal_beyond, metal_beyond
from ronnaplan.localization.judge.noise import noise_level
from ronnaplan.localization.judge.uncertainty import POST_PULL_MM
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
        found.append(bool(metal_beyond(spotted, fit, around).of_metal.any()))
        assert is_metal_beyond(spotted, fit, around) == found[-1]
    assert 5 < sum(found) < 35


def test_what_touches_a_ball_is_looked_up_once_to_state_its_error(monkeypatch: pytest.MonkeyPatch) -> None:
    looked_up: list[int] = []

    def counted(*asked: Any) -> Any:
        looked_up.append(len(asked[1]))
        return in_scan(*asked)

    post = Part(cylinder((1.0, 2.0, 1.0), (0.0, 0.0, -1.0), 18.0, 2.0), "acrylic")
    volume = scan(Scene((post,)) + balls([(1.0, 2.0, 3.0)], 6.0), small_stack())
    fit, in_scan = fit_place(Scan(volume), np.array([1.0, 2.0, 3.0]), 6.0), held._metal_beyond
    monkeypatch.setattr(held, "_metal_beyond", counted)
    assert Evidence(fit, 6.0, 0.6, 0.6, noise_level(fit), 0.0, volume).covariance_mm2[2, 2] > POST_PULL_MM**2
    assert looked_up == [np.count_nonzero(fit.verdict.state == 0)]
    assert looked_up[0] > 0
