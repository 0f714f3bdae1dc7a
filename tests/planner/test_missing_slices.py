"""A scan that lacks slices is planned in with that before one's eyes: above the panels, and in cuts without one."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pytest

from ronnaplan.ct import read_ct
from ronnaplan.ct.volume import VolumeFlag
from ronnaplan.planner.over_cut import over_cut
from ronnaplan.planner.panes import Pane
from ronnaplan.planner.state import PlannerState
from ronnaplan.planner.storage import Storage
from tests import cases
from tests.planner.browser import needs_browser, opened, planner


@pytest.fixture
def lacking(tmp_path: Path) -> Path:
    """The scan without five of its slices."""
    folder = tmp_path / "ct"
    folder.mkdir()
    for number, file in enumerate(sorted(cases.CT.glob("*.dcm"))):
        if not 60 <= number < 65:
            shutil.copy(file, folder / file.name)
    return folder


def test_a_cut_where_slices_are_missing_says_between_which_it_lies(lacking: Path, tmp_path: Path) -> None:
    volume = read_ct(lacking)
    state = PlannerState(volume, Storage.of(str(tmp_path / "plan.json"), None, None))
    grid = volume.grid
    below = int(grid.spacings_mm.argmax())
    gap_mm = grid.spacings_mm[below]
    middle = state.look.crosshair_mm.copy()
    for share, told in ((0.0, False), (0.3, True), (0.9, True), (1.0, False), (2.0, False)):
        middle[2] = grid.slice_positions_mm[below] + share * gap_mm
        state.look.jump(middle)
        title = over_cut(state, "axial", False, Pane())["title"]
        assert (f", gap {gap_mm:.1f} mm" in title) == told, share
        assert "gap" not in over_cut(state, "coronal", False, Pane())["title"]


@needs_browser
def test_doubts_about_the_scan_are_told_before_anything_is_planned(
    browser: Any, lacking: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cases, "CT", lacking)
    with planner(tmp_path) as running:
        page = opened(browser, running.url)
        for panel in ("Trajectories", "Files"):
            page.click(f".rp-tab >> text={panel}")
            assert page.locator(f".rp-doubt >> text={VolumeFlag.MISSING_SLICE}").is_visible()
