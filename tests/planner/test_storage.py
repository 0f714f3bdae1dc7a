"""The files of a case where they lie, also while that place is away."""

from __future__ import annotations

import os

import pytest

from ronnaplan.documents.plan import read_plan
from ronnaplan.errors import InputError
from ronnaplan.planner.state import PlannerState
from ronnaplan.planner.tab import Tab
from tests import cases

NOBODY = 65_534

posix_only = pytest.mark.skipif(not hasattr(os, "geteuid"), reason="folders are closed otherwise here")


@pytest.mark.parametrize("how", ["renamed", pytest.param("closed", marks=posix_only)])
def test_a_case_whose_folder_is_away_is_shown_on_and_goes_on_once_it_is_back(
    state: PlannerState, how: str
) -> None:
    """As where somebody renames it, or a share is gone for a while."""
    tab, folder = Tab(state), state.storage.plan.parent
    tab.painter.refresh()
    me, away = getattr(os, "geteuid", int)(), folder.with_name("away")
    if how == "renamed":
        folder.rename(away)
    else:
        folder.chmod(0)
        if me == 0:
            os.seteuid(NOBODY)
    try:
        tab.painter.refresh()
        for refused in (
            lambda: state.case.edit("left", notes="mine"),
            state.case.look_again,
            state.case.require_files,
        ):
            with pytest.raises(InputError, match=r"cannot write|cannot be read|was removed"):
                refused()
    finally:
        if me == 0:
            os.seteuid(me)
        away.rename(folder) if how == "renamed" else folder.chmod(0o700)
    assert not state.case.look_again()
    state.case.edit("left", notes="mine")
    assert read_plan(state.storage.plan).trajectory("left").notes == "mine"


def test_points_that_are_none_of_the_frame_s_are_not_taken_from_where_one_looked(state: PlannerState) -> None:
    """As where the file was edited by hand: with a third point of any name the plan would have had its frame."""
    state.set_landmark("AC", cases.TARGET_MM)
    file = state.storage.look
    file.write_text(file.read_text().replace('"AC"', '"middle"'))
    again = PlannerState(cases.volume(), state.storage)
    again.set_landmark("PC", cases.TARGET_MM + 20.0)
    again.set_landmark("AC", cases.TARGET_MM - 20.0)
    assert list(again.landmarks_mm) == ["PC", "AC"]
