"""What a trajectory is measured against is looked at once, and it is measured anew only where something changed."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from ronnaplan.case import surroundings
from ronnaplan.case.surroundings import Judgement, Rules, Surroundings, Terrain
from ronnaplan.planning import Trajectory
from ronnaplan.planning.obstacles import Clearance
from tests import cases


def test_moving_one_trajectory_measures_only_that_one_again(monkeypatch: pytest.MonkeyPatch) -> None:
    counted: list[str] = []
    measure = surroundings.measure

    def counting(trajectory: Trajectory, *arguments: Any, **options: Any) -> Any:
        counted.append(trajectory.name)
        return measure(trajectory, *arguments, **options)

    monkeypatch.setattr(surroundings, "measure", counting)
    around = Surroundings(Terrain(cases.volume()), Rules(), cases.fiducials())
    plan = cases.plan()
    shift = np.array([6.0, 0.0, 0.0])
    plan = plan.add(Trajectory("other", cases.ENTRY_MM + shift, cases.TARGET_MM + shift, plan.frame))

    def judged() -> list[Judgement]:
        return [around.judge(one, plan) for one in plan.trajectories]

    first = judged()
    assert counted == ["left", "other"]
    plan = plan.edit("other", entry_mm=cases.ENTRY_MM + 2 * shift, target_mm=cases.TARGET_MM + 2 * shift)
    second = judged()
    assert counted == ["left", "other", "other"]
    apart = [one[0].measures.spacings[0].distance_mm for one in (first, second)]  # type: ignore[union-attr]
    assert apart[1] == pytest.approx(2 * apart[0], rel=1e-6)


def test_while_an_end_is_dragged_a_no_go_region_is_its_voxels_and_then_the_surface_behind_them() -> None:
    volume = cases.volume()
    index = np.moveaxis(np.indices(volume.voxels_hu.shape), 0, -1).astype(np.float64)
    axis, middle = np.array([0.36, 0.8, 0.48]), (cases.ENTRY_MM + cases.TARGET_MM) / 2
    off = volume.grid.positions_mm(index) - middle - 9.0 * np.array([0.8, -0.36, 0.0]) / np.hypot(0.8, 0.36)
    vessel = np.linalg.norm(np.cross(off, axis), axis=-1) < 5.0
    around = Surroundings(Terrain(volume, {"vessel": vessel}), Rules())
    plan = cases.plan()
    (path,) = plan.trajectories

    def judged(rough: bool) -> Clearance:
        measures = around.judge(path, plan, rough=rough).measures
        assert measures is not None
        return next(one for one in measures.clearances if one.name == "vessel")

    dragged = judged(rough=True)
    assert not dragged.smooth
    assert dragged.at_least_mm < dragged.clearance_mm
    let_go = judged(rough=False)
    assert let_go.smooth
    assert judged(rough=True) is let_go  # known better already
