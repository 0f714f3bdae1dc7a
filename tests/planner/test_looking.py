"""What is looked at: cuts that hang together, zoom, the selected trajectory, and regions that are shown."""

from __future__ import annotations

import numpy as np
import pytest

from ronnaplan.errors import UsageError
from ronnaplan.planner.over_cut import over_cut
from ronnaplan.planner.panes import Pane
from ronnaplan.planner.state import PlannerState
from ronnaplan.planner.storage import Storage
from tests import cases

E, T = cases.ENTRY_MM, cases.TARGET_MM


def test_the_view_does_not_jump_when_an_end_is_dragged(state: PlannerState) -> None:
    before = {view: state.look.cut(view).center_mm for view in ("axial", "coronal", "sagittal")}
    state.case.drag("left", "target", T + 9)
    state.case.end_drag()
    for view, center in before.items():
        assert state.look.cut(view).center_mm == pytest.approx(center, abs=0)


def test_the_place_under_the_pointer_stays_there_when_zooming(state: PlannerState) -> None:
    state.look.jump(T)
    before = state.look.cut("coronal").on_screen_mm(T) / state.look.field_mm
    state.look.zoom("coronal", 1.7, T)
    after = state.look.cut("coronal").on_screen_mm(T) / state.look.field_mm
    assert after == pytest.approx(before)
    for _ in range(50):
        state.look.zoom("axial", 1.7, T)
    assert state.look.field_mm == 10.0
    state.look.fit()
    assert state.look.field_mm == pytest.approx(256 * 250 / 256, rel=0.01)


def test_the_cuts_are_linked_by_the_crosshair(state: PlannerState) -> None:
    state.look.jump([10.0, 20.0, 30.0])
    for view in ("axial", "coronal", "sagittal"):
        assert state.look.cut(view).on_screen_mm(state.look.crosshair_mm)[2] == pytest.approx(0.0, abs=1e-9)
    state.look.scroll("axial", 2)
    assert abs(state.look.crosshair_mm[2] - 30.0) == pytest.approx(2 * 1.5)
    for _ in range(500):
        state.look.scroll("axial", 1)
    low, high = state.look.bounds_mm
    assert low[2] <= state.look.crosshair_mm[2] <= high[2]


def test_a_label_map_is_shown_and_judges_nothing(storage: Storage) -> None:
    volume = cases.volume()
    mask = np.zeros(volume.voxels_hu.shape, dtype=np.bool_)
    k, j, i = np.rint(volume.grid.indices((E + T) / 2)).astype(int)
    mask[k - 4 : k + 5, j - 4 : j + 5, i - 4 : i + 5] = True
    state = PlannerState(volume, storage, no_go={"vessel": mask}, labels={"vessel": mask, "tumor": mask})
    about = [one.measure for one in state.case.judge(state.case.plan.trajectory("left")).verdicts]
    assert "distance to vessel" in about
    assert not any("tumor" in measure for measure in about)
    state.look.jump((E + T) / 2)
    drawn = over_cut(state, "axial", False, Pane())["regions"]
    assert [one["name"] for one in drawn] == ["vessel", "vessel (shown only)", "tumor"]
    assert len({one["colour"] for one in drawn}) == 3
    page, other = state.beside(), state.beside()
    page.look.show_region("tumor", "#123456", 0.0)
    assert "tumor" not in [one["name"] for one in over_cut(page, "axial", False, Pane())["regions"]]
    assert "tumor" in [one["name"] for one in over_cut(other, "axial", False, Pane())["regions"]]
    other.look.show_region("vessel", "#654321", 0.5)
    plain = PlannerState(volume, storage)
    plain.look.save()
    again = PlannerState(volume, storage, labels={"vessel": mask, "tumor": mask}).look.regions
    assert [(one.colour, one.opacity) for one in again.values()] == [("#654321", 0.5), ("#123456", 0.0)]


def test_without_a_trajectory_there_is_nothing_to_look_along(state: PlannerState) -> None:
    state.case.remove("left")
    assert state.look.selected is None
    with pytest.raises(UsageError, match="select one"):
        state.look.cut("inline")
    state.case.undo()
    assert state.look.selected == "left"
    assert state.look.cut("probe").away == pytest.approx(state.case.plan.trajectory("left").inward)
