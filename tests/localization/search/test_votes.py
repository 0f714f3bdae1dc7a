"""Votes are counted in cells, and where most gather may be a ball."""

from __future__ import annotations

import numpy as np

from ronnaplan.localization.search.votes import MOST_VOTES, Ballot

CORNER_MM, FAR_MM = np.zeros(3), np.array([20.0, 20.0, 20.0])


def _counted(*, times: int) -> Ballot:
    """Return votes for a ball of 6 mm at (10, 8, 9) mm, so many times by the edge on either of its sides."""
    ballot = Ballot.over(CORNER_MM, FAR_MM, 6.0, 1.0)
    edges = np.array([[7, 8, 9, 1, 0, 0], [13, 8, 9, -1, 0, 0]], dtype=np.float32)
    ballot.count([np.repeat(edges, times, axis=0)])
    return ballot


def test_edges_vote_one_radius_up_their_gradient() -> None:
    ballot = _counted(times=2)
    assert ballot.votes.sum() == ballot.votes.max() == 4
    found = ballot.counted(0.01, np.eye(3))
    np.testing.assert_allclose(found.centers_mm, [[10.0, 8.0, 9.0]])


def test_a_cell_that_is_full_stays_a_peak() -> None:
    ballot = _counted(times=MOST_VOTES)
    assert ballot.votes.max() == MOST_VOTES
    np.testing.assert_allclose(ballot.counted(0.01, np.eye(3)).centers_mm, [[10.0, 8.0, 9.0]])
