"""Every way of doing what is asked for is tried."""

from __future__ import annotations

import numpy as np
import pytest

from ronnaplan.geometry import FloatArray
from ronnaplan.robot.arm.kuka import kr6_r900
from ronnaplan.robot.placement.tasks import Fineness, Task, drill_task, view_task, ways_of
from tests.robot.placement.cases import CENTER_MM, HEAD_MM, room

ROLLS = 16


def tips(task: Task) -> FloatArray:
    """Return each way's first pose of the tool's tip in the room (N, 4, 4)."""
    ways = ways_of([task], kr6_r900(), Fineness(ROLLS, 50.0))
    assert ways.firsts.tolist() == [0, len(ways.flanges)]
    found: FloatArray = ways.flanges[:, 0] @ task.flange_from_tip
    return found


def rolls_deg(poses: FloatArray) -> list[float]:
    """By how much (degrees) poses along one axis are rolled about it, from the first."""
    axis, first = poses[0, :3, 2], poses[0, :3, 0]
    aside = poses[:, :3, 0]
    angles = np.degrees(np.arctan2(aside @ np.cross(axis, first), aside @ first))
    return np.sort(np.round(angles, 6) % 360.0).tolist()  # type: ignore[no-any-return]


def test_an_instrument_is_turned_all_the_way_about_its_trajectory() -> None:
    entry_mm, target_mm = CENTER_MM + np.array([-20.0, 30.0, 90.0]), CENTER_MM
    tool = room().tool
    poses = tips(drill_task("T", entry_mm, target_mm, tool, 180.0, 2.4))
    inward = (target_mm - entry_mm) / np.linalg.norm(target_mm - entry_mm)
    np.testing.assert_allclose(poses[:, :3, 2], np.tile(inward, (ROLLS, 1)), atol=1e-12)
    np.testing.assert_allclose(
        poses[:, :3, 3], np.tile(entry_mm - tool.standoff_mm * inward, (ROLLS, 1)), atol=1e-9
    )
    assert rolls_deg(poses) == pytest.approx(np.arange(ROLLS) * 360.0 / ROLLS)


def test_a_camera_is_turned_all_the_way_where_it_looks_straight_and_from_every_fourth_side_in_quarters_between() -> (
    None
):
    marker_mm, camera = CENTER_MM + np.array([0.0, 0.0, 1.1]) * HEAD_MM, room().camera
    poses = tips(view_task("M", marker_mm, CENTER_MM, camera))
    sides, seen_from = np.unique(np.round(poses[:, :3, 2], 9), axis=0, return_inverse=True)
    tilts_deg = np.degrees(np.arccos(np.clip(-sides[:, 2], -1.0, 1.0)))
    straight, tilted = np.flatnonzero(tilts_deg < 0.1), np.flatnonzero(tilts_deg > 0.1)
    assert tilts_deg[tilted] == pytest.approx(24 * [camera.tilt_deg], abs=1e-4)
    rolls = [rolls_deg(poses[seen_from == side]) for side in range(len(sides))]
    for told in rolls:
        assert told == pytest.approx(np.arange(len(told)) * 360.0 / len(told))
    assert [len(rolls[side]) for side in straight] == [ROLLS]
    around = tilted[np.argsort(np.arctan2(sides[tilted, 1], sides[tilted, 0]))]
    counts = np.array([len(rolls[side]) for side in around])
    assert set(counts.tolist()) == {ROLLS, ROLLS // 4}
    assert np.diff(np.flatnonzero(counts == ROLLS)).tolist() == 5 * [4]
