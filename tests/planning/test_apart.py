"""How far trajectories are apart is measured once: after a change, of those only that it changed."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from ronnaplan.geometry import Frame
from ronnaplan.planning import Trajectory
from ronnaplan.planning.apart import Apart, spacings
from ronnaplan.planning.segments import segment_distances

SEED, COUNT = 20261128, 60


def crowd(count: int) -> tuple[Trajectory, ...]:
    random = np.random.default_rng(SEED)
    ends = random.uniform(-60.0, 60.0, (count, 2, 3))
    return tuple(Trajectory(f"E{n}", entry, target, Frame("CT")) for n, (entry, target) in enumerate(ends))


def by_each(among: tuple[Trajectory, ...], reach_mm: float) -> list[tuple[Trajectory, ...]]:
    """The others that come near to each, every pair measured by itself."""
    named = {one.name: one for one in among}
    return [
        tuple(named[near.other] for near in spacings(one, among) if near.clearance_mm <= reach_mm) for one in among
    ]


def test_those_that_are_near_are_those_that_a_measurement_of_every_pair_finds_also_after_changes() -> None:
    known, among = Apart(), crowd(COUNT)
    moved = replace(among[7], target_mm=among[7].target_mm + 5.0)
    for those in (
        among,
        (*among[:7], moved, *among[8:]),
        (*among[8:], moved, *among[:3]),
        (*among[:7], replace(moved, name="renamed"), *crowd(COUNT + 2)[COUNT:]),
        (),
        among[:1],
    ):
        for reach_mm in (0.0, 2.0, 20.0):
            assert known.near(those, reach_mm) == by_each(those, reach_mm)


def test_after_a_change_of_one_of_many_only_its_own_distances_are_measured(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Of 300 all would be 90,000, at every change."""
    pairs = list[int]()

    def counted(start: Any, stop: Any, starts: Any, stops: Any) -> Any:
        pairs.append(len(starts))
        return segment_distances(start, stop, starts, stops)

    monkeypatch.setattr("ronnaplan.planning.apart.segment_distances", counted)
    known, plan = Apart(), crowd(COUNT)
    known.near(plan, 2.0)
    assert sum(pairs) >= COUNT * (COUNT - 1) / 2
    pairs.clear()
    known.near((*plan[:7], replace(plan[7], target_mm=plan[7].target_mm + 5.0), *plan[8:]), 2.0)
    known.near(plan[:7], 2.0)
    assert sum(pairs) == COUNT
