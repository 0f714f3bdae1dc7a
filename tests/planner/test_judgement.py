"""What a trajectory is measured against is looked at once, and it is measured anew only where something changed."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from ronnaplan.planner import judgement
from ronnaplan.planner.judgement import Surroundings
from ronnaplan.planning import Limits, Trajectory
from tests import cases


def test_moving_one_trajectory_measures_only_that_one_again(monkeypatch: pytest.MonkeyPatch) -> None:
    counted: list[str] = []
    measure = judgement.measure

    def counting(trajectory: Trajectory, *arguments: Any, **options: Any) -> Any:
        counted.append(trajectory.name)
        return measure(trajectory, *arguments, **options)

    monkeypatch.setattr(judgement, "measure", counting)
    around = Surroundings(cases.volume(), cases.fiducials(), {})
    plan = cases.plan()
    shift = np.array([6.0, 0.0, 0.0])
    plan = plan.add(Trajectory("other", cases.ENTRY_MM + shift, cases.TARGET_MM + shift, plan.frame))
    limits = Limits()

    def judged() -> list[judgement.Judgement]:
        return [around.judge(one, plan, limits) for one in plan.trajectories]

    first = judged()
    assert counted == ["left", "other"]
    plan = plan.edit("other", entry_mm=cases.ENTRY_MM + 2 * shift, target_mm=cases.TARGET_MM + 2 * shift)
    second = judged()
    assert counted == ["left", "other", "other"]
    apart = [one[0].measures.spacings[0].distance_mm for one in (first, second)]  # type: ignore[union-attr]
    assert apart[1] == pytest.approx(2 * apart[0], rel=1e-6)
    limits = replace(limits, tolerance_mm=3.0)
    error = judged()[0].measures.error  # type: ignore[union-attr]
    assert error is not None
    assert error.tolerance_mm == 3.0
