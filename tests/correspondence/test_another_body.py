"""What a pairing leaves may hold another body: it is found whatever way errors are stated, and nothing else is one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ronnaplan.correspondence.another_body import best_body, odds_of_another_body
from ronnaplan.correspondence.pairing import IntArray
from ronnaplan.correspondence.problem import Problem
from ronnaplan.correspondence.rivals import BODY_GATE_CHI2
from tests.correspondence.scenes import bodies
from tests.correspondence.test_poses import problem_of


def moved_apart(counts: tuple[int, int]) -> tuple[Problem, IntArray]:
    """Return the problem of two bodies, and the pairing of the first alone."""
    ct, ots, partner = bodies(5, counts, (70.0, 70.0))
    first = np.where(np.arange(len(ct)) < counts[0], partner, -1)
    return problem_of(ct, ots), first


def in_full(problem: Problem) -> Problem:
    """Return the problem with the same errors, stated as covariances."""
    ct_errors, ots_errors = (
        replace(errors, covariances=errors.variances[:, None, None] * np.eye(3))
        for errors in (problem.ct_errors, problem.ots_errors)
    )
    return replace(problem, ct_errors=ct_errors, ots_errors=ots_errors)


def test_the_body_that_is_left_is_found_and_is_real() -> None:
    problem, first = moved_apart((6, 5))
    count, real = best_body(problem, first, BODY_GATE_CHI2)
    assert count == 5
    assert real > 0.99
    assert best_body(in_full(problem), first, BODY_GATE_CHI2) == pytest.approx(
        (5, real), abs=1e-5
    )  # of these all pairings count


def test_two_points_are_no_body() -> None:
    problem, first = moved_apart((6, 2))
    assert best_body(problem, first, BODY_GATE_CHI2) == (0, 0.0)
    assert odds_of_another_body(problem, first) == 0.0


def test_a_pair_that_is_known_tells_which_body_is_the_patient() -> None:
    problem, first = moved_apart((6, 6))
    assert odds_of_another_body(problem, first) == pytest.approx(1.0, rel=0.05)
    assert odds_of_another_body(replace(problem, known=np.array([[0, first[0]]])), first) == 0.0
