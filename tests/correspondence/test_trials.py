"""Trials of a pose counted in blocks: the same hits, and the same work, as one by one."""

from itertools import product

import numpy as np
import pytest
from scipy.special import bdtrc

from ronnaplan.correspondence.lookup import point_grid
from ronnaplan.correspondence.trials import NO_LINE, TRIAL_WORK, count_hits, hits_beyond, stopping_line
from ronnaplan.geometry import FloatArray
from tests.correspondence.scenes import ball

REACH_MM = 3.0


def one_by_one(
    met: FloatArray, pose: FloatArray, tried: FloatArray, total: int, least: int, line: tuple[float, float]
) -> tuple[int, int]:
    hits = 0
    for t in range(total):
        if hits + total - t < least or hits < line[0] * t - line[1]:
            return -1, TRIAL_WORK * t
        place = pose[:, :3] @ tried[:3, t] + pose[:, 3]
        hits += bool((np.linalg.norm(met - place, axis=1) < REACH_MM).any())
    return hits, TRIAL_WORK * total


@pytest.mark.parametrize("apart_mm", [1.0, 6.0])
def test_hits_counted_in_blocks_are_those_counted_one_by_one(apart_mm: float) -> None:
    """The line and the hits needed stop a count at the very trial at which they are out of reach."""
    rng, stopped = np.random.default_rng(5), 0
    points = 6.0 * np.array(
        list(product(range(5), repeat=3)), dtype=np.float64
    )  # never two within reach of a place
    _, _, near, places, cells = point_grid(points, 0.6, REACH_MM, 2.0 * REACH_MM)
    for test in range(200):
        tried = np.vstack((points[rng.permutation(125)[:40]].T, np.full(40, REACH_MM**2)))
        tried[:3] += ball(rng, 40, apart_mm).T
        pose = np.column_stack((np.eye(3), rng.normal(size=3)))
        line = NO_LINE if test % 3 == 0 else stopping_line(0.3, 0.9)
        least, total = int(rng.integers(0, 30)), int(rng.integers(0, 41))
        counted = count_hits(near, places, cells, pose, tried, total, least, line, np.empty((4, 40)))
        assert counted == one_by_one(points, pose, tried, total, least, line)
        stopped += counted[0] < 0
    assert 20 < stopped < 180


@pytest.mark.parametrize("chance", [1e-6, 0.013, 0.31])
@pytest.mark.parametrize("unlikely", [0.011, 1e-5])
def test_so_many_hits_are_needed_that_chance_makes_them_rarely(chance: float, unlikely: float) -> None:
    needed = hits_beyond(chance, 300, unlikely)[1:]
    tried = np.arange(1, 301)
    assert np.all(bdtrc(needed - 1, tried, chance) <= unlikely)
    assert np.all((bdtrc(needed - 2, tried, chance) > unlikely) | (needed == 1))
