"""Proposed entries keep every limit, avoid what is in the way, and are the best there are."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from ronnaplan.errors import InputError
from ronnaplan.geometry import Frame
from ronnaplan.planning import Instrument, Limits, Trajectory, measure, propose
from ronnaplan.planning.candidates import Field, cast, spread_directions
from ronnaplan.planning.limits import all_pass, judge
from ronnaplan.planning.obstacles import Kind, Obstacle, PostedMarker, Voxels
from ronnaplan.planning.uncertainty import Basis, Expectation, ExpectedPose
from tests.long import few_and_others
from tests.planning.heads import SCALP, SKULL, normal, reach, scanned

TARGET = np.array([10.0, -6.0, 25.0])
LIMITS = Limits(longest_path_mm=75.0, greatest_skull_angle_deg=25.0, least_no_go_distance_mm=4.0)


def vessel(center: tuple[float, float, float], radius_mm: float, stack: str = "plain") -> Voxels:
    head = scanned(stack)
    grid, mask = head.volume.grid, np.zeros(head.volume.voxels_hu.shape, dtype=bool)
    corners = grid.indices(np.array(center) + radius_mm * np.array(list(product((-1, 1), repeat=3))))
    low, high = np.floor(corners.min(axis=0)).astype(int), np.ceil(corners.max(axis=0)).astype(int) + 1
    box = tuple(slice(*ends) for ends in zip(low, high, strict=True))
    index = np.moveaxis(np.mgrid[box].astype(np.float64), 0, -1)
    mask[box] = np.linalg.norm(grid.positions_mm(index) - center, axis=-1) < radius_mm
    return Voxels.of(Kind.NO_GO, "vessel", mask, head)


@few_and_others("stack", ["tilted"], ["plain"])
def test_no_proposal_breaks_a_limit(stack: str) -> None:
    head = scanned(stack)
    other = Trajectory("other", np.array([20.0, -10, 74]), np.array([15.0, 0, 40]), Frame("CT", "1.2.3"))
    obstacles: list[Obstacle] = [vessel((25.0, -10.0, 45.0), 8.0, stack)]
    obstacles.append(PostedMarker("F1", np.array([60.0, 0, 60.0]), np.array([50.0, 0, 52.0]), 11.5))
    found = propose(TARGET, head, LIMITS, obstacles=obstacles, others=[other], count=6, directions=6000)
    assert len(found.best) == 6
    for proposal in found.best:
        again = measure(proposal.trajectory, head, obstacles=obstacles, others=[other])
        assert all_pass(judge(again, LIMITS))
        assert all_pass(proposal.verdicts)
        assert again.entry_below_scalp_mm == pytest.approx(0.0, abs=0.5)
        outward, length = -proposal.trajectory.inward, proposal.trajectory.length_mm
        assert length < 75.0
        cosine = outward @ normal(TARGET + reach(TARGET, outward, SKULL) * outward, SKULL)
        assert np.degrees(np.arccos(cosine)) < 25.1
        assert proposal.reasons[0] == f"{length:.1f} mm long"
    entries = np.array([proposal.trajectory.entry_mm for proposal in found.best])
    apart = np.linalg.norm(entries[:, None] - entries, axis=-1)[~np.eye(6, dtype=bool)]
    assert apart.min() >= 10.0
    assert [p.score for p in found.best] == sorted((p.score for p in found.best), reverse=True)


def test_candidates_agree_with_the_full_measure() -> None:
    head = scanned("plain")
    obstacle = vessel((25.0, -10.0, 45.0), 8.0)
    upward = spread_directions(400)
    upward = upward[upward[:, 2] > 0.3]
    found = cast(head, TARGET, upward, Field.of([obstacle], head))
    for m in range(0, len(upward), 19):
        entry = TARGET + reach(TARGET, upward[m], SCALP) * upward[m]
        exact = measure(Trajectory("A", entry, TARGET, head.volume.frame), head, obstacles=[obstacle])
        assert np.linalg.norm(found.entries_mm[m] - entry) < 0.3
        assert exact.skull_angle_deg == pytest.approx(found.angle_deg[m], abs=3.0)
        assert exact.skull_thickness_mm == pytest.approx(found.outer_mm[m] - found.inner_mm[m], abs=1.2)
        assert exact.clearances[0].distance_mm == pytest.approx(max(found.distance_mm[m], 0.0), abs=1.2)


def test_a_wall_in_the_way_leaves_only_the_ways_round_it() -> None:
    head = scanned("plain")
    free = propose(TARGET, head, Limits(), count=1, directions=3000)
    best = free.best[0].trajectory
    wall = vessel(tuple(best.at_depth(np.array(best.length_mm * 0.6))), 7.0)
    found = propose(TARGET, head, Limits(), obstacles=[wall], count=1, directions=3000)
    assert np.linalg.norm(found.best[0].trajectory.entry_mm - best.entry_mm) > 8.0
    assert found.excluded["too near a no-go region or metal"] > 0
    assert not found.best[0].measures.clearances[0].crosses


def test_impossible_limits_leave_no_proposal_and_the_reasons_why() -> None:
    found = propose(TARGET, scanned("plain"), Limits(longest_path_mm=20.0), directions=2000)
    assert found.best == ()
    assert found.excluded["path too long"] > 500
    assert np.isnan(found.scores).all()


def test_a_limit_that_only_the_full_measure_knows_counts_too(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ronnaplan.planning.proposals.MOST_CHECKED", 10)
    limits = Limits(greatest_target_error_mm=1.0)
    for variance, found in ((0.1, 2), (1.0, 0)):
        pose = np.diag([1e-8, 1e-8, 1e-8, variance, variance, variance])
        expected = Expectation(planned=ExpectedPose(pose, Basis.PLANNED, ("F1", "F2", "F3"), 0.56, 0.17))
        best = propose(TARGET, scanned("plain"), limits, expected=expected, count=2, directions=800).best
        assert len(best) == found


def test_the_instrument_must_reach() -> None:
    short = Instrument("short probe", 2.0, 60.0)
    found = propose(TARGET, scanned("plain"), Limits(), instrument=short, count=2, directions=3000)
    assert [one.trajectory.instrument for one in found.best] == [short, short]
    assert max(one.trajectory.length_mm for one in found.best) <= 60.0
    assert found.excluded["path too long"] > 500


@pytest.mark.parametrize("target", [[0.0, 0, 300], [90.0, 0, 10]])
def test_a_target_outside_the_head_is_refused(target: list[float]) -> None:
    with pytest.raises(InputError, match="outside the scan or in air"):
        propose(np.array(target), scanned("plain"), Limits())
