"""Poses refined by their pairs: each pose the best proper rotation, each pair the nearest."""

from itertools import product
from typing import Any

import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from ronnaplan.correspondence.lookup import point_grid
from ronnaplan.correspondence.refining import fit_to_pairs, partners_under
from ronnaplan.rigid import fit_closed_form
from tests.correspondence.scenes import ball


def fit(ct: Any, ots: Any, partner: Any) -> np.ndarray:
    pose = np.empty((3, 4))
    fit_to_pairs(np.ascontiguousarray(ct), np.ascontiguousarray(ots), np.asarray(partner, np.int64), pose)
    return pose


@pytest.mark.parametrize(
    "shape", [[1.0, 1.0, 1.0], [1.0, 1.0, 0.0], [1.0, 0.01, 0.003]], ids=["ball", "flat", "row"]
)
@pytest.mark.parametrize("mirrored", [False, True])
def test_a_pose_is_the_best_rotation_and_never_a_reflection(shape: list[float], mirrored: bool) -> None:
    rng = np.random.default_rng(3)
    for count in range(3, 40):
        turn = Rotation.from_quat(rng.normal(size=4))
        ct = ball(rng, count + 5, 60.0) * shape
        moved = turn.apply(ct * [1.0, 1.0, -1.0 if mirrored else 1.0]) + rng.uniform(-500.0, 500.0, 3)
        ots = moved[::-1] + 0.3 * rng.normal(size=moved.shape)
        partner = np.arange(count + 5)[::-1].copy()
        partner[rng.permutation(count + 5)[:5]] = -1
        pose, i = fit(ct, ots, partner), np.flatnonzero(partner >= 0)
        assert np.allclose(pose, fit_closed_form(ct[i], ots[partner[i]])[:3], atol=1e-8)
        assert np.linalg.det(pose[:, :3]) == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize(
    "ct",
    [np.arange(12.0).reshape(4, 3), np.ones((5, 3)), 1e-9 * np.eye(3)],
    ids=["on a line", "at one place", "nearly at one place"],
)
def test_pairs_that_leave_the_turn_open_give_a_rotation_all_the_same(ct: np.ndarray) -> None:
    for to in (ct + 7.0, ct[::-1], np.zeros_like(ct)):
        pose = fit(ct, to, np.arange(len(ct)))
        assert np.allclose(pose[:, :3] @ pose[:, :3].T, np.eye(3), atol=1e-9)
        assert np.linalg.det(pose[:, :3]) == pytest.approx(1.0, abs=1e-9)
        assert np.allclose(pose[:, :3] @ ct.mean(axis=0) + pose[:, 3], to.mean(axis=0))


@pytest.mark.parametrize("field", [15.0, 60.0])
@pytest.mark.parametrize("radius", [2.0, 3.0, 4.5, 5.5, 7.0], ids="within {} mm".format)
def test_a_point_pairs_with_the_nearest_of_all(field: float, radius: float) -> None:
    """Also where it is sought farther than the cells know who is near, and beside all of them."""
    rng = np.random.default_rng(int(field))
    ots = np.vstack((ball(rng, 90, field), np.array(list(product([0.0, 4.0, 8.0], repeat=3)))))
    ct, pose = ball(rng, 3000, field + 15.0), np.column_stack((np.eye(3), np.array([1.0, -2.0, 0.5])))
    distance, nearest = map(np.asarray, cKDTree(ots).query(ct + pose[:, 3]))
    expected = np.full(len(ct), -1)
    for j in range(len(ots)):
        mine = np.flatnonzero((nearest == j) & (distance < radius))
        if len(mine):
            expected[mine[distance[mine].argmin()]] = j
    grid = point_grid(ots, 0.6, 3.0, 5.0)
    assert np.array_equal(partners_under(ct, ots, grid, pose, radius), expected)
