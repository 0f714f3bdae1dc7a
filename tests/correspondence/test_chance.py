"""How probable the pairs and the points of a pose are."""

import numpy as np
import pytest
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from ronnaplan.correspondence import match_points
from ronnaplan.correspondence.chance import Chance, connected
from ronnaplan.correspondence.inputs import ErrorModel
from ronnaplan.correspondence.pairing import no_pairs
from ronnaplan.correspondence.problem import Problem
from ronnaplan.correspondence.told import Told
from ronnaplan.correspondence.weighing import PairedPose
from tests.correspondence.scenes import SIGMA_CT, SIGMA_OTS, ball, bodies


def test_outliers_beside_markers_make_no_body_the_larger() -> None:
    """Of three points only two can pair, whichever set two of them are of. They counted as two where both sets did."""
    rng = np.random.default_rng(4)
    markers = ball(rng, 22, 90.0)
    beside = markers[:2] + np.array([0.4, 0.0, 0.0])
    ct, ots = np.vstack((markers, beside[:1])), np.vstack((markers, beside[1:]))
    errors = [
        ErrorModel(np.full(len(points), sigma**2), None) for points, sigma in ((ct, SIGMA_CT), (ots, SIGMA_OTS))
    ]
    chance = Chance.of(Problem(ct, ots, errors[0], errors[1], Told(), no_pairs(), 3e6, 60.0))
    partner = np.where(np.arange(len(ct)) < len(markers), np.arange(len(ct)), -1)
    pose = PairedPose(np.eye(3, 4), partner, 0.0, 0.0)
    assert chance.point_probabilities(pose).sum() == pytest.approx(len(markers), abs=0.05)
    assert chance.pair_probabilities(np.eye(3, 4), partner)[:2].max() < 0.9


def test_a_pair_is_less_sure_where_outliers_lie_beside_markers() -> None:
    """One may stand for a marker that its set lacks. As many that lie anywhere among the markers hardly ever do.

    They counted alike: by how many there are, not by where they lie.
    """
    rng = np.random.default_rng(5)
    markers, anywhere = ball(rng, 24, 90.0), ball(rng, 8, 90.0)
    read = markers + np.array([1.0, 0.5, 0.5])
    partner = np.arange(len(markers))
    errors = [ErrorModel(np.full(count, sigma**2), None) for count, sigma in ((24, SIGMA_CT), (32, SIGMA_OTS))]
    doubts = []
    for outliers in (anywhere, markers[:8] + 3.0 * anywhere / np.linalg.norm(anywhere, axis=1, keepdims=True)):
        chance = Chance.of(
            Problem(markers, np.vstack((read, outliers)), errors[0], errors[1], Told(), no_pairs(), 3e6, 60.0)
        )
        doubts.append(1.0 - chance.sure_pairs(np.eye(3, 4), partner)[8:])
    assert (doubts[1] > 3.0 * doubts[0]).all()


@pytest.mark.parametrize("seed", range(4))
def test_a_stray_is_never_surely_the_marker_that_its_set_lacks(seed: int) -> None:
    """Ten markers have a second reading within the errors of a pair, of two it is the only one: it had over 0.9998.

    Where none has any, all markers pair.
    """
    rng = np.random.default_rng([52, seed])
    markers, aside = ball(rng, 26, 90.0), rng.normal(size=(10, 3))
    strays = markers[:10] + 1.5 * aside / np.linalg.norm(aside, axis=1, keepdims=True)
    ct, read = (markers + sigma * rng.normal(size=markers.shape) for sigma in (SIGMA_CT, SIGMA_OTS))
    answer = match_points(ct, np.vstack((read[2:], strays)))
    assert len(answer) > 10
    assert answer.pair_probabilities[answer.pairs[:, 0] < 2].max(initial=0.0) < 0.9995
    assert len(match_points(ct, read[2:])) == 24


def test_of_two_equal_bodies_none_is_the_larger_for_the_outliers_in_it() -> None:
    """The dense one was accepted at 0.998: outliers of both sets beside its markers counted as more of these."""
    ct, ots, _ = bodies(67, [30, 30], [18.0, 60.0], 30, 18.0)
    assert match_points(ct, ots).status == "ambiguous"


@pytest.mark.parametrize("pairs", [0, 30, 90, 300])
def test_points_are_connected_through_any_number_of_others(pairs: int) -> None:
    rng = np.random.default_rng(pairs)
    row = np.array((np.arange(99), np.arange(1, 100)))
    for ends in (*(rng.integers(100, size=(2, pairs)) for _ in range(20)), row, rng.permutation(100)[row]):
        joined = coo_matrix((np.ones(ends.shape[1]), (ends[0], ends[1])), (100, 100))
        _, cluster = connected_components(joined, directed=False)
        found = connected(ends[0], ends[1], 100)
        assert np.array_equal(found[:, None] == found, cluster[:, None] == cluster)
