"""What a trajectory is measured against is looked at once, and it is measured anew only where something changed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ronnaplan.case.expectation import expectation
from ronnaplan.case.judgement import Judgement
from ronnaplan.case.surroundings import Rules, Surroundings, Terrain
from ronnaplan.documents.plan import read_plan, write_plan
from ronnaplan.documents.registration import RegistrationDocument
from ronnaplan.documents.registration_made import registration_document
from ronnaplan.geometry import Points
from ronnaplan.planning import Landmarks, Limits, Measures, Plan, Trajectory, Verdict, judge, measure
from ronnaplan.planning.limits import is_near
from ronnaplan.planning.obstacles import Clearance
from ronnaplan.registration.marker_registration import register_markers
from tests import cases


@pytest.fixture
def counted(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The names of the trajectories that were measured, in this order."""
    counted: list[str] = []

    def counting(trajectory: Trajectory, *arguments: Any, **options: Any) -> Any:
        counted.append(trajectory.name)
        return measure(trajectory, *arguments, **options)

    monkeypatch.setattr("ronnaplan.case.surroundings.measure", counting)
    return counted


def test_moving_one_trajectory_measures_only_that_one_again(counted: list[str]) -> None:
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


def test_what_is_read_anew_or_held_against_other_limits_is_measured_only_where_it_changed(
    counted: list[str], tmp_path: Path
) -> None:
    """Another hand's change of one trajectory, or of the limits, leaves the verdicts on the others to be seen."""
    found = cases.fiducials()
    around = Surroundings(Terrain(cases.volume()), Rules(), found)
    plan = cases.plan().with_landmarks(Landmarks(np.zeros(3), np.array([0.0, 25.0, 0.0]), np.array([0.0, 0, 40])))
    for name, along in (("second", np.array([6.0, 0.0, 0.0])), ("third", np.array([12.0, 0.0, 0.0]))):
        plan = plan.add(replace(plan.trajectories[0], name=name, target_mm=cases.TARGET_MM + along))
    around.judge_all(plan)
    write_plan(tmp_path / "plan.json", plan.edit("second", target_mm=cases.TARGET_MM))
    theirs = read_plan(tmp_path / "plan.json")
    assert [around.knows(one, theirs) for one in theirs.trajectories] == [True, False, True]
    around.judge_all(theirs)
    assert counted == ["left", "second", "third", "second"]
    stricter = around.with_documents(Rules(Limits(longest_path_mm=10.0)), found, None)
    assert all(stricter.knows(one, theirs) for one in theirs.trajectories)
    assert all(judged.broken for judged in stricter.judge_all(theirs))
    assert len(counted) == 4
    others = (Rules(Limits(tolerance_mm=1.0)), found), (Rules(sigma_ct_mm=1.0), found), (Rules(), None)
    for rules, markers in others:
        anew = stricter.with_documents(rules, markers, None)
        assert not any(anew.knows(one, theirs) for one in theirs.trajectories)


def test_a_glance_after_a_change_judges_only_what_changed_and_what_is_near_to_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The list of a plan of hundreds is to follow every change at once."""
    around = Surroundings(Terrain(cases.volume()), Rules(Limits(least_trajectory_distance_mm=2.0)))
    plan = cases.plan()
    for name, shift in (("beside", 6.0), ("far", -12.0), ("farther", -20.0)):
        off = np.array([shift, 0.0, 0.0])
        plan = plan.add(Trajectory(name, cases.ENTRY_MM + off, cases.TARGET_MM + off, plan.frame))
    assert around.glance(plan) == (None,) * 4
    around.judge_all(plan)

    def said(plan: Plan) -> list[int]:
        judged.clear()
        return [len(one.broken) for one in around.glance(plan) if one is not None]

    def counted(one: Measures, limits: Limits) -> tuple[Verdict, ...]:
        judged.append(one.trajectory.name)
        return judge(one, limits)

    judged = list[str]()
    monkeypatch.setattr("ronnaplan.case.surroundings.judge", counted)
    clear = said(plan)
    assert judged == ["left", "beside", "far", "farther"]
    assert said(plan) == clear
    assert judged == []
    nearer = np.array([1.0, 0.0, 0.0])
    moved = plan.edit("beside", entry_mm=cases.ENTRY_MM + nearer, target_mm=cases.TARGET_MM + nearer)
    around.judge_all(moved)
    met = said(moved)
    assert judged == ["left", "beside"]
    assert [now - then for now, then in zip(met, clear, strict=True)] == [1, 1, 0, 0]
    assert said(moved.edit("beside", name="called otherwise")) == [met[0], *met[2:]]
    assert judged == ["left"]


def test_a_glance_finds_what_a_limit_between_trajectories_is_broken_or_nearly_broken_by() -> None:
    """Where others stand beside a trajectory from where their limit is broken to beyond where it is near."""
    around, plan = (
        Surroundings(Terrain(cases.volume()), Rules(Limits(least_trajectory_distance_mm=2.0))),
        cases.plan(),
    )
    (path,) = plan.trajectories
    aside = np.cross(path.inward, [0.0, 0.0, 1.0])
    for n, clearance_mm in enumerate((-0.5, 0.1, 1.9, 2.1, 2.19, 2.21, 6.0)):
        off = aside / np.linalg.norm(aside) * (clearance_mm + path.instrument.diameter_mm) * (-1) ** n
        plan = plan.add(Trajectory(f"{n}", path.entry_mm + off, path.target_mm + off, plan.frame))
    (judged, *_), (glanced, *_) = around.judge_all(plan), around.glance(plan)
    assert glanced is not None
    assert [one.measure for one in judged.broken] == ["distance to 0", "distance to 1", "distance to 2"]
    for others in ("broken", "near"):
        by_each = [
            [one for one in found.verdicts if (is_near(one) if others == "near" else not one.passes)]
            for found in (judged, glanced)
        ]
        assert by_each[0] == by_each[1] != []
    assert len(glanced.verdicts) < len(judged.verdicts)


def test_limits_may_change_while_another_thread_measures(monkeypatch: pytest.MonkeyPatch) -> None:
    around, plan = Surroundings(Terrain(cases.volume()), Rules()), cases.plan()
    (path,) = plan.trajectories
    around.judge(path, plan)

    def replace_later(kept: Any, **changes: Any) -> Any:
        patched.undo()
        around.judge(replace(path, name="measured meanwhile"), plan)
        return replace(kept, **changes)

    with monkeypatch.context() as patched:
        patched.setattr("ronnaplan.case.surroundings.replace", replace_later)
        stricter = around.with_documents(Rules(Limits(longest_path_mm=10.0)), None, None)
    assert stricter.judge(path, plan).broken


def test_while_an_end_is_dragged_a_no_go_region_is_its_voxels_and_then_the_surface_behind_them() -> None:
    volume = cases.volume()
    axis, middle = np.array([0.36, 0.8, 0.48]), (cases.ENTRY_MM + cases.TARGET_MM) / 2
    near = tuple(slice(int(at) - 30, int(at) + 30) for at in volume.grid.indices(middle))
    index = np.moveaxis(np.mgrid[near], 0, -1).astype(np.float64)
    off = volume.grid.positions_mm(index) - middle - 9.0 * np.array([0.8, -0.36, 0.0]) / np.hypot(0.8, 0.36)
    vessel = np.zeros(volume.voxels_hu.shape, dtype=np.bool_)
    vessel[near] = (off**2).sum(axis=-1) - (off @ axis) ** 2 < 5.0**2
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


def registered_with(count: int) -> RegistrationDocument:
    """A registration with the first markers only."""
    seen = cases.readings()
    few = Points(seen.positions_mm[:count], seen.covariances_mm2[:count], seen.labels[:count], seen.frame)
    known = tuple((f"F{number}", str(number)) for number in range(1, count + 1))
    found = register_markers(cases.fiducials().points, few, known_pairs=known)
    return registration_document(found, cases.fiducials().source)


def test_a_registration_with_few_markers_counts_and_not_what_was_planned_for_all() -> None:
    plan = cases.plan()
    (path,) = plan.trajectories
    terrain, fiducials = Terrain(cases.volume()), cases.fiducials()

    def judged(registration: RegistrationDocument | None, limit_mm: float = 1.0) -> Judgement:
        rules = Rules(Limits(greatest_target_error_mm=limit_mm))
        return Surroundings(terrain, rules, fiducials, registration).judge(path, plan)

    before = judged(None).measures
    assert before is not None
    assert before.error is not None
    assert before.planned_error is None
    assert before.error.expected.markers == ("F1", "F2", "F3", "F4", "F5", "F6")
    after = judged(registered_with(3)).measures
    assert after is not None
    assert after.error is not None
    assert after.planned_error is not None
    assert str(after.error.expected) == "as registered with F1, F2, F3 (0.56 mm in CT, 0.17 mm tracked, per axis)"
    assert after.planned_error.target_rms_mm == before.error.target_rms_mm
    assert after.error.target_rms_mm > 1.2 * before.error.target_rms_mm
    between = (after.error.target_rms_mm + before.error.target_rms_mm) / 2
    assert judged(None, between).broken == ()
    (broken,) = judged(registered_with(3), between).broken
    assert (broken.measure, broken.remark) == ("expected error at target", "as registered")


def test_a_registration_of_other_markers_or_one_refused_does_not_count() -> None:
    found, known = cases.fiducials(), registered_with(4)
    fewer = found.model_copy(update={"fiducials": found.fiducials[1:]})
    refused = known.model_copy(update={"status": "ambiguous", "reason": "two ways fit"})
    for fiducials, registration, remark in (
        (fewer, known, "the registration uses marker F1, which is no longer there; register again"),
        (found, refused, "the registration is ambiguous: two ways fit"),
    ):
        expected = expectation(fiducials, registration, 0.5, 0.2)
        assert expected.registered is None
        assert expected.remarks == (remark,)
        assert expected.counted is not None
        assert (expected.counted.basis, expected.counted.sigma_ct_mm) == ("planned", 0.5)


def test_planned_and_registered_agree_where_they_rest_on_the_same() -> None:
    expected = expectation(cases.fiducials(), registered_with(6), 0.56, 0.17)
    assert expected.registered is not None
    assert expected.planned is not None
    # A registration takes off what noise adds to the width of its layout: some millionths here.
    np.testing.assert_allclose(
        expected.registered.tre_rms_mm([cases.TARGET_MM]),
        expected.planned.tre_rms_mm([cases.TARGET_MM]),
        rtol=1e-4,
    )
