"""Balls draw the votes of their edges to their centers, in any geometry of slices."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ronnaplan.ct import CTVolume
from ronnaplan.localization.search.coarse import coarsen
from ronnaplan.localization.search.detect import _find_edges, detect
from tests.long import few_and_others
from tests.scans import balls, scan, small_stack

TURN = Rotation.from_euler("xyz", [20, -30, 50], degrees=True).as_matrix()


@few_and_others(
    "geometry",
    [{"tilt_deg": 20.0}, {"positions_mm": tuple(np.cumsum([-20, *[1.0] * 12, *[2.5] * 6, *[1.2] * 10]))}],
    [{}, {"orientation": TURN}, {"spacing_mm": 3.0, "thickness_mm": 3.0}],
    ids=["tilted", "uneven", "plain", "oblique", "thick"],
)
def test_the_strongest_candidate_is_the_ball(geometry: dict[str, object]) -> None:
    center = (3.2, -4.1, 1.7)
    found = detect(scan(balls([center]), small_stack(**geometry)), 11.5)
    assert np.linalg.norm(found[0] - center) < 1.0


def test_an_empty_scan_has_no_candidates() -> None:
    empty = scan(balls([(200.0, 0.0, 0.0)]), small_stack())
    assert len(detect(empty, 11.5)) == 0


def test_all_edges_are_kept_where_every_voxel_is_one() -> None:
    """There are more of them than there was room for at first."""
    slices, rows, columns = 12, 5, 6
    voxels_hu = np.zeros((slices, rows, columns), dtype=np.int16) + 1000 * np.arange(columns, dtype=np.int16)
    origins_mm = np.arange(float(slices))[:, np.newaxis] * [0.0, 0.0, 1.0]
    edges = _find_edges(voxels_hu, origins_mm, np.ones(2), 100.0, 1, slices - 1)
    k, j, i = np.indices((slices - 2, rows - 2, columns - 2)).reshape(3, -1) + 1
    np.testing.assert_array_equal(edges, [i, j, k, *[np.full(len(k), up) for up in (1, 0, 0)]])


def test_edges_are_where_the_gradient_is_steep_and_nowhere_else() -> None:
    seed, threshold = 20261128, 100.0
    draws = np.random.default_rng(seed)
    voxels_hu = (1000 * (draws.random((6, 9, 37)) < 0.05)).astype(np.int16)
    rises = np.array(np.gradient(voxels_hu.astype(np.float64)))[:, 1:-1, 1:-1, 1:-1]
    steep = np.argwhere(np.square(rises).sum(axis=0) >= threshold**2) + 1
    assert 0 < len(steep) < 0.5 * rises[0].size, seed
    origins_mm = np.arange(6.0)[:, np.newaxis] * [0.0, 0.0, 1.0]
    edges = _find_edges(voxels_hu, origins_mm, np.ones(2), threshold, 1, 5)
    np.testing.assert_array_equal(edges[:3], steep.T[::-1], err_msg=str(seed))


def test_the_coarse_copy_keeps_every_voxel_at_its_place() -> None:
    volume = scan(balls([(3.2, -4.1, 1.7)]), small_stack(tilt_deg=15.0), noise_hu=0.0)
    coarse = coarsen(volume, 2.1)
    assert coarse.voxels_hu.shape == (22, 32, 32)

    def center_of_mass(which: CTVolume) -> np.ndarray:
        weights = which.voxels_hu.astype(np.float64) + 1000
        places = which.grid.positions_mm(np.moveaxis(np.indices(weights.shape), 0, -1).astype(np.float64))
        found: np.ndarray = np.tensordot(weights, places, 3) / weights.sum()
        return found

    assert center_of_mass(coarse) == pytest.approx(center_of_mass(volume), abs=0.02)


def test_the_candidates_do_not_depend_on_how_many_slices_vote_at_a_time(monkeypatch: pytest.MonkeyPatch) -> None:
    volume = scan(balls([(3.2, -4.1, 1.7), (-12.0, 9.0, -8.0)]), small_stack(tilt_deg=20.0))
    at_once = detect(volume, 8.0)
    monkeypatch.setattr("ronnaplan.localization.search.detect.SLAB_SLICES", 3)
    found = detect(volume, 8.0)
    assert len(found) > 0
    np.testing.assert_array_equal(found, at_once)
