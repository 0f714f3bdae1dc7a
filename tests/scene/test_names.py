"""Names of trajectories are written within the picture, and none on another."""

from __future__ import annotations

from typing import Any

import pytest

from ronnaplan.scene.names import LINE_EM, Room, write_names

ROOM = Room(2.0, 1.0, 0.12)
LINE = LINE_EM * ROOM.em


def written(*paths: tuple[str, float, float], marker: tuple[float, float] | None = None) -> list[dict[str, Any]]:
    """Where the names of paths (name and entry) are written."""
    markers = [] if marker is None else [{"label": "F1", "x": marker[0], "y": marker[1], "r": 0.0}]
    named = write_names([{"name": name, "entry": [x, y]} for name, x, y in paths], markers, ROOM)
    return [one["written"] for one in named]


def test_a_name_stands_to_the_right_of_its_entry_and_to_the_left_where_the_picture_ends() -> None:
    right, left = written(("STN", 0.0, 0.0), ("hippocampus", 1.5, 0.5))
    assert (right["anchor"], left["anchor"]) == ("start", "end")
    assert 0.0 < right["x"] < 0.1
    assert 1.4 < left["x"] < 1.5


def test_a_name_that_fits_on_neither_side_begins_within_the_picture() -> None:
    (one,) = written(("a name that is longer than this picture is wide, as nobody would give it", 0.0, 0.0))
    assert one["anchor"] == "start"
    assert one["x"] == -2.0


def test_no_name_covers_another_nor_that_of_a_marker() -> None:
    first, second, third = written(("left", 0.0, 0.0), ("right", 0.05, 0.02), ("far", 0.0, 0.6))
    assert second["y"] == pytest.approx(first["y"] + 0.02 + LINE)
    assert third["y"] == pytest.approx(first["y"] + 0.6)
    (beside_a_marker,) = written(("left", 0.0, 0.0), marker=(0.05, 0.0))
    assert beside_a_marker["y"] == pytest.approx(first["y"] - LINE)


def test_a_name_at_the_upper_edge_is_whole() -> None:
    (one,) = written(("left", 0.0, -0.99))
    assert one["y"] == pytest.approx(ROOM.em - 1.0)


def test_the_name_of_an_entry_outside_goes_with_it() -> None:
    (one,) = written(("left", 2.5, 0.0))
    assert one["x"] > 2.5
