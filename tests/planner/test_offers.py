"""Entries and marker places that are proposed hold only for what they were asked for."""

from __future__ import annotations

import numpy as np
import pytest

from ronnaplan.documents.plan import change_plan
from ronnaplan.errors import InputError
from ronnaplan.geometry import Points
from ronnaplan.planner.panels import placement_line, proposal_rows
from ronnaplan.planner.state import PlannerState
from ronnaplan.planner.tab import Tab
from ronnaplan.planner.worker import Job
from ronnaplan.planning import Ruler
from ronnaplan.planning.uncertainty import ExpectedPose
from tests import cases
from tests.loops import run

E, T = cases.ENTRY_MM, cases.TARGET_MM


def test_proposals_hold_only_for_what_they_were_asked_for(state: PlannerState) -> None:
    with pytest.raises(InputError, match="another target"):
        state.offers.take_proposal(0)
    state.add_trajectory(E + np.array([-50, 0, 0]), T + np.array([-20, 0, 0]), "right")
    state.look.select("left")
    state.offers.propose("left")
    assert state.offers.proposals is not None
    best = state.offers.proposals.best[0].trajectory.entry_mm
    state.add_trajectory(E + np.array([5, 0, 0]), T + np.array([5, 0, 0]))
    assert state.offers.proposals is None  # another trajectory is selected
    with pytest.raises(InputError, match="another target"):
        state.offers.take_proposal(0)
    state.look.select("left")
    assert state.offers.proposals is None  # and there is one more to keep away from
    state.case.undo()
    change_plan(state.storage.plan, lambda plan: plan.add_ruler(Ruler("D1", np.stack([E, T]))))
    assert state.case.look_again()
    assert state.offers.proposals is not None  # another hand left alone what they rest upon
    state.offers.take_proposal(0)
    assert state.case.plan.trajectory("left").entry_mm == pytest.approx(best, abs=0)
    assert state.offers.proposals is not None
    promised, kept = (
        state.offers.proposals.best[0].measures,
        state.case.judge(state.case.plan.trajectory("left")).measures,
    )
    assert kept is not None
    assert kept.error is not None
    assert promised.error is not None
    np.testing.assert_array_equal(promised.error.tre_rms_mm, kept.error.tre_rms_mm)
    assert promised.error.probability == kept.error.probability
    state.case.edit("left", target_mm=T + np.array([0, 0, 1]))
    assert proposal_rows(state) == {"rows": [], "none": ""}
    state.case.undo()
    assert len(proposal_rows(state)["rows"]) > 0
    state.case.reject_marker("F2")
    assert state.offers.proposals is None


def test_marker_places_hold_for_the_trajectories_they_were_asked_for(state: PlannerState) -> None:
    state.offers.propose_markers(4)
    assert state.offers.placement is not None
    assert len(state.offers.placement.centers_mm) == 4
    placed = state.offers.placement
    points = Points(placed.centers_mm, np.zeros((4, 3, 3)), tuple("ABCD"))
    told = ExpectedPose.planned(points).tre_rms_mm([cases.TARGET_MM])
    assert placed.largest_tre_mm == told[0]  # as `plan check` tells it of markers that stand there
    assert "4 places" in placement_line(state)
    assert placed.doubt is not None
    assert placement_line(state).endswith(placed.doubt)
    state.case.edit("left", target_mm=T + np.array([0, 0, 1]))
    assert placement_line(state) == ""
    state.case.undo()
    assert placement_line(state)
    found = state.case.found
    state.case.replace_markers(
        found.model_copy(update={"marker": found.marker.model_copy(update={"diameter_mm": 20.0})})
    )
    assert placement_line(state) == ""  # larger balls need more room


def test_as_many_marker_places_as_the_page_offers_at_first_are_proposed(state: PlannerState) -> None:
    jobs: list[Job] = []
    state.start = jobs.append

    async def press() -> None:
        tab = Tab(state)
        await tab.answer("placement", (tab.shown["marker_count"],))
        assert tab.shown["message"] == ""

    run(press())
    assert [job.what for job in jobs] == ["finding places for 6 markers"]
