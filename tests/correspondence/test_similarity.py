from typing import Any

import numpy as np
import pytest

from ronnaplan.correspondence import match_by_similarity
from ronnaplan.correspondence.similarity import (
    shared_distances,
    similarity_match_many,
    similarity_matrix,
    unique_partners,
)
from ronnaplan.errors import InputError, UsageError
from tests.correspondence.scenes import HEAD, is_right, scene


@pytest.mark.parametrize(("markers", "outliers"), [(4, 2), (6, 4), (8, 4)])
def test_markers_are_paired_among_outliers(markers: int, outliers: int) -> None:
    right = sum(
        is_right(match_by_similarity(ct, ots, markers), partner)
        for ct, ots, partner in (scene(seed, markers, outliers) for seed in range(40))
    )
    assert right >= 39


def test_similarity_counts_shared_distances_as_equation_11() -> None:
    """An independent count: the largest one-to-one matching of distances closer than e."""
    from scipy.optimize import linear_sum_assignment

    ct, ots, _ = scene(2, markers=5, outliers=2)
    e = 6.0
    d_ct = np.linalg.norm(ct[:, None] - ct[None], axis=-1)
    d_ots = np.linalg.norm(ots[:, None] - ots[None], axis=-1)
    sim = similarity_matrix(ct, ots, e, True)
    for i in range(7):
        for j in range(7):
            close = np.abs(np.delete(d_ct[i], i)[:, None] - np.delete(d_ots[j], j)[None]) < e
            rows, columns = linear_sum_assignment(~close)
            assert sim[i, j] == close[rows, columns].sum()


@pytest.mark.parametrize("one_to_one", [True, False])
def test_similarity_never_exceeds_the_smaller_set_less_one(one_to_one: bool) -> None:
    ct, ots, _ = scene(3, markers=4, outliers=0)
    assert similarity_matrix(np.vstack((ct, HEAD)), ots, 500.0, one_to_one).max() == 3


def test_a_distance_is_shared_once_only() -> None:
    assert shared_distances(np.array([50.0, 50.1, 50.2]), np.array([50.1]), 1.0) == 1


def test_only_pairs_without_competitors_are_unique() -> None:
    candidates = np.array([[True, False, False], [False, True, True], [False, False, True]])
    assert unique_partners(candidates).tolist() == [0, -1, -1]


def test_step_4b_pairs_the_rest_by_coordinates() -> None:
    """Markers 3 and 4 share all their distances to the others: only coordinates tell them apart."""
    layout = np.array([[0, 0, 0], [100, 0, 0], [30, 70, 0], [60, 30, 4.0], [60, 30, -4.0]])
    pairing = match_by_similarity(layout, layout, 5, e_start_mm=1.0, e_stop_mm=1.0)
    assert pairing.status == "unique"
    assert np.array_equal(pairing.pairs[:, 0], pairing.pairs[:, 1])


@pytest.mark.parametrize(
    "layout",
    [
        np.array([[0, 0, 0], [100, 0, 0], [50, 50 * 3**0.5, 0]]),
        np.array([[0, 0, 0], [80, 0, 0], [80, 80, 0], [0, 80, 0.0]]),
    ],
    ids=["equilateral triangle", "square"],
)
def test_symmetric_layouts_are_refused(layout: Any) -> None:
    pairing = match_by_similarity(layout, layout + 5.0, len(layout))
    assert pairing.status == "unmatched"
    assert len(pairing.pairs) == 0


def test_a_larger_tolerance_is_tried_only_when_a_smaller_fails() -> None:
    ct = HEAD[:4].copy()
    ct[0] += [3.0, 0.0, 0.0]
    assert match_by_similarity(ct, HEAD[:4], 4, e_stop_mm=1.0).status == "unmatched"
    assert match_by_similarity(ct, HEAD[:4], 4, e_stop_mm=6.0).status == "unique"


def test_many_sets_at_once_give_the_same_answers() -> None:
    scenes = [scene(seed, 4, 3) for seed in range(20)]
    ct, ots = (np.array([one[k] for one in scenes]) for k in (0, 1))
    partners = similarity_match_many(ct, ots, 4, 1.0, 6.0, 0.1, True)
    for one, two, partner in zip(ct, ots, partners, strict=True):
        pairs = match_by_similarity(one, two, 4).pairs
        assert np.array_equal(np.flatnonzero(partner >= 0), pairs[:, 0])
        assert np.array_equal(partner[partner >= 0], pairs[:, 1])


@pytest.mark.parametrize(
    "arguments",
    [{"e_start_mm": 0.0}, {"e_start_mm": 7.0}, {"e_step_mm": 0.0}, {"e_stop_mm": np.inf}, {"e_step_mm": 1e-30}],
)
def test_an_impossible_range_of_tolerances_is_an_error(arguments: Any) -> None:
    with pytest.raises(InputError, match="tolerance"):
        match_by_similarity(HEAD, HEAD, 8, **arguments)


def test_without_a_number_it_is_not_run() -> None:
    with pytest.raises(InputError, match="give a whole number"):
        match_by_similarity(HEAD, HEAD, None)  # type: ignore[arg-type]


def test_a_tolerance_that_is_no_number_is_told() -> None:
    wrong: Any = "1"
    with pytest.raises(UsageError, match="str is given for e_start_mm"):
        match_by_similarity(HEAD, HEAD, len(HEAD), wrong)
