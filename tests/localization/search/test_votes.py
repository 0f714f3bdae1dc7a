"""Votes are counted in cells, and where most gather may be a ball."""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from ronnaplan.localization.search.votes import MOST_VOTES, Ballot, _gather_peaks

CORNER_MM, FAR_MM = np.zeros(3), np.array([20.0, 20.0, 20.0])


def _counted(*, times: int) -> Ballot:
    """Return votes for a ball of 6 mm at (10, 8, 9) mm, so many times by the edge on either of its sides."""
    ballot = Ballot.over(CORNER_MM, FAR_MM, 6.0, 1.0)
    edges = np.array([[7, 8, 9, 1, 0, 0], [13, 8, 9, -1, 0, 0]], dtype=np.float32)
    ballot.count([np.repeat(edges, times, axis=0).T.copy()])
    return ballot


def test_edges_vote_one_radius_up_their_gradient() -> None:
    ballot = _counted(times=2)
    assert ballot.votes.sum() == ballot.votes.max() == 4
    found = ballot.counted(0.01, np.eye(3))
    np.testing.assert_allclose(found, [[10.0, 8.0, 9.0]])


def test_a_cell_that_is_full_stays_a_peak() -> None:
    ballot = _counted(times=MOST_VOTES)
    assert ballot.votes.max() == MOST_VOTES
    np.testing.assert_allclose(ballot.counted(0.01, np.eye(3)), [[10.0, 8.0, 9.0]])


def test_peaks_are_the_cells_that_gather_most_of_all_about_them_and_the_first_of_equals() -> None:
    seed = 20261126
    votes = np.random.default_rng(seed).integers(0, 2, (9, 14, 11)).astype(np.uint8)
    around = sliding_window_view(np.pad(votes, 1).astype(int), (3, 3, 3))
    sums = around.sum(axis=(3, 4, 5)) * (votes > 0)
    least = 17
    expected = [
        cell
        for cell in np.ndindex(votes.shape)
        if all(0 < at < end - 1 for at, end in zip(cell, votes.shape, strict=True))
        and sums[cell] >= least
        and max(np.ndindex(3, 3, 3), key=lambda to: _rank(sums, cell, to)) == (1, 1, 1)
    ]
    for parts in ([(0, 9)], [(0, 3), (3, 4), (4, 9)]):
        found = [_gather_peaks(votes, float(least), *part) for part in parts]
        assert [tuple(place) for some in found for place in some[0]] == expected, seed
        assert [total for some in found for total in some[1]] == [sums[cell] for cell in expected], seed
    assert len(expected) > 5, seed


def _rank(sums: NDArray[np.int64], cell: tuple[int, ...], to: tuple[int, ...]) -> tuple[int, int]:
    """Order the cell ``to`` which a step leads by what it gathers; of equals the first is highest."""
    at = tuple(place + step - 1 for place, step in zip(cell, to, strict=True))
    return int(sums[at]), -int(np.ravel_multi_index(to, (3, 3, 3)))
