"""Names of trajectories are written within the picture, and none on another."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from ronnaplan.scene.files import PAGE
from ronnaplan.scene.names import GAP, LINE_EM, LINES, Names, Room
from ronnaplan.text import ELLIPSIS, abridged
from tests.long import few_and_others
from tests.loops import apart
from tests.planner.browser import chromium, needs_browser

ROOM = Room(2.0, 1.0, 0.12)
LINE = LINE_EM * ROOM.em


def written(*paths: tuple[str, float, float], marker: tuple[float, float] | None = None) -> list[dict[str, Any]]:
    """Where the names of paths (name and entry) are written."""
    markers = [] if marker is None else [{"label": "F1", "x": marker[0], "y": marker[1], "r": 0.0}]
    names = Names(ROOM)
    names.of_places(markers)
    return [one["written"] for one in names.of_paths([{"name": name, "entry": [x, y]} for name, x, y in paths])]


def test_a_name_stands_to_the_right_of_its_entry_and_to_the_left_where_the_picture_ends() -> None:
    right, left = written(("STN", 0.0, 0.0), ("hippocampus", 1.5, 0.5))
    assert (right["anchor"], left["anchor"]) == ("start", "end")
    assert 0.0 < right["x"] < 0.1
    assert 1.4 < left["x"] < 1.5


def test_the_selected_path_is_named_first_and_drawn_last() -> None:
    paths = [{"name": name, "entry": [0.0, 0.0], "selected": name == "chosen"} for name in ("chosen", "other")]
    spots = [{"label": label, "x": 0.0, "y": 0.0, "r": GAP} for label in ("marker", "point")]
    drawn = Names(ROOM).of_all(paths, spots[:1], spots[1:])
    assert [one["name"] for one in drawn["paths"]] == ["other", "chosen"]
    named = [drawn["paths"][1], *drawn["markers"], drawn["paths"][0], *drawn["points"]]
    assert [round((one["written"]["y"] + GAP) / LINE) for one in named] == list(LINES[:4])


def test_a_name_that_fits_on_neither_side_begins_within_the_picture() -> None:
    (one,) = written(("\u6d77" * 16 + "x", 0.0, 0.0))
    assert one["anchor"] == "start"
    assert one["x"] + ROOM.length(one["text"]) == pytest.approx(ROOM.wide)
    (one,) = written(("a name that is rather longer than this picture is wide, as nobody would give it", 0.0, 0.0))
    assert one["anchor"] == "start"
    assert -ROOM.wide <= one["x"] <= ROOM.wide - ROOM.length(one["text"]) + 1e-9


@pytest.mark.parametrize(
    "name",
    ["a name that is longer than this picture is wide " * 2, "\u6d77\u99ac" * 30, "x" * 1_000_000],
    ids=["words", "Chinese", "a million letters"],
)
def test_a_long_name_takes_half_of_the_picture_and_shows_its_beginning_and_its_end(name: str) -> None:
    """Two of one head often differ at their ends only."""
    (one,) = written((name, 0.0, 0.0))
    beginning, end = one["text"].split("\u2026")
    assert name.startswith(beginning)
    assert name.endswith(end)
    assert abs(len(beginning) - len(end)) <= 2
    assert 0.85 * ROOM.wide < ROOM.length(one["text"]) <= ROOM.wide


def test_no_name_covers_another_nor_that_of_a_marker() -> None:
    first, second, third = written(("left", 0.0, 0.0), ("right", 0.05, 0.02), ("far", 0.0, 0.6))
    assert second["y"] == pytest.approx(first["y"] + 0.02 + LINE)
    assert third["y"] == pytest.approx(first["y"] + 0.6)
    (beside_a_marker,) = written(("left", 0.0, 0.0), marker=(0.05, 0.0))
    assert beside_a_marker["y"] == pytest.approx(first["y"] - LINE)


def test_a_name_for_which_there_is_no_room_is_not_written_on_another() -> None:
    told = written(*((f"E{number}", 0.0, 0.0) for number in range(30)))
    shown = [one for one in told if one["text"]]
    assert [one["text"] for one in shown] == [
        f"E{number}" for number in range(len(shown))
    ]  # the first keep theirs
    assert 5 <= len(shown) == len({one["y"] for one in shown}) < 10


def test_a_name_at_the_upper_edge_is_whole() -> None:
    (one,) = written(("left", 0.0, -0.99))
    assert one["y"] == pytest.approx(ROOM.em - 1.0)


def label(text: str, x: float, y: float, room: Room = ROOM) -> dict[str, Any]:
    """Where the label of a marker at a place is written."""
    (one,) = Names(room).of_places([{"label": text, "x": x, "y": y, "r": 0.1}])
    written: dict[str, Any] = one["written"]
    return written


def test_the_label_of_a_marker_is_shortened_and_stands_within_the_picture() -> None:
    assert label("F1", 0.0, 0.0) == {"x": 0.1, "y": -0.1, "anchor": "start", "text": "F1"}
    assert label("F1", 1.95, 0.0) == {"x": pytest.approx(1.85), "y": -0.1, "anchor": "end", "text": "F1"}
    long = label("behind the left ear, where the skin is thin, put on again", 0.0, 0.0)
    assert long["text"].startswith("behind")
    assert long["text"].endswith("put on again")
    assert ROOM.length(long["text"]) <= ROOM.wide


def test_the_label_of_a_place_outside_is_not_written() -> None:
    """Of "left A12" to the left of the picture "A12" would be seen, or "12"."""
    for place in ((2.5, 0.0), (0.0, -1.5), (-2.01, 0.0)):
        assert label("left A12", *place)["text"] == ""


def test_labels_of_neighbouring_markers_do_not_cover_each_other() -> None:
    """Nor those of points beside them; what is written nowhere, as a crosshair's empty label, takes no place."""
    close = [{"label": f"F{n}", "x": 0.02 * n, "y": 0.01 * n, "r": 0.05} for n in range(5)]
    names = Names(ROOM)
    first, *others = names.of_places(close)
    assert first["written"] == {"x": 0.05, "y": -0.05, "anchor": "start", "text": "F0"}
    names.of_places([{"label": "", "x": 0.1, "y": 0.6, "r": 0.0}])
    more = names.of_places(
        [{"label": "AC", "x": 0.03, "y": 0.0, "r": 0.05}, {"label": "PC", "x": 0.0, "y": 0.6, "r": 0.0}]
    )
    boxes = [ROOM.box(**one["written"]) for one in (first, *others, *more)]
    for n, one in enumerate(boxes):
        for other in boxes[:n]:
            assert one[0] >= other[2] or other[0] >= one[2] or one[1] >= other[3] or other[1] >= one[3]
    assert more[1]["written"]["y"] == 0.6


def test_neither_names_nor_labels_stand_in_the_title() -> None:
    room = replace(ROOM, title=0.2)
    names = Names(room)
    markers = names.of_places([{"label": "F1", "x": 0.0, "y": -0.95, "r": 0.0}])
    paths = [{"name": f"path {number}", "entry": [0.0, -0.97]} for number in range(9)]
    written = [one["written"] for one in (*markers, *names.of_paths(paths))]
    assert min(one["y"] for one in written) == pytest.approx(-room.high + room.title + room.em)


def test_a_shortened_name_counts_its_ellipsis_as_wide_as_it_is_drawn() -> None:
    assert ROOM.length("\u6d77\u2026") == pytest.approx(2 * ROOM.em)


def test_no_name_is_cut_off_at_the_lower_edge() -> None:
    named = written(*((f"path {number}", 0.0, 0.95) for number in range(4)))
    assert len({one["y"] for one in named}) == 4
    assert max(one["y"] for one in named) <= ROOM.high


def test_the_name_of_an_entry_outside_is_not_written() -> None:
    assert [one["text"] for one in written(("left", 2.5, 0.0), ("left", -2.01, 0.0))] == ["", ""]


def test_capitals_are_counted_as_wide_as_they_are() -> None:
    """Liberation Sans, which measures as Arial does, has an X of 0.67 and an H of 0.72 of the letters' height."""
    assert 0.65 * 90 * ROOM.em < ROOM.length("X" * 90) < 0.75 * 90 * ROOM.em
    assert ROOM.length("x" * 90) == pytest.approx(0.54 * 90 * ROOM.em)


@pytest.mark.parametrize(
    ("letter", "share"), [("W", 0.944), ("M", 0.833), ("m", 0.833), ("w", 0.722), ("%", 0.889), ("@", 1.015)]
)
def test_a_name_of_the_broadest_letters_stays_within_the_picture(letter: str, share: float) -> None:
    """By the widths of Liberation Sans, in the letters' height: such a name began outside, and its end was cut off."""
    (one,) = written((letter * 300, 0.5, 0.0))
    drawn = (len(one["text"]) - 1) * share * ROOM.em + ROOM.em  # with its ellipsis
    assert one["anchor"] == "end"
    assert -ROOM.wide <= one["x"] - drawn
    assert drawn <= 1.1 * ROOM.wide


PIXELS, LINE_PIXELS, GAP_PIXELS = 800, 15, 10
"""A square page on which lines and gaps of `names.js` are as large, beside it, as those of `names.py`."""
STEP = 7.5
"""Names stand whole or half lines apart: the page takes a line to be full, the picture leaves a gap between two."""


def left_and_base(names: list[tuple[str, float, float]], room: Room) -> list[tuple[float, float] | None]:
    """Where names begin and stand by `names.py`, in a page's pixels from its upper left corner, None for no room."""
    paths = [{"name": name, "entry": [x - room.wide, y - room.high]} for name, x, y in names]
    lefts: list[tuple[float, float] | None] = []
    for one in Names(room).of_paths(paths):
        if not one["written"]["text"]:
            lefts.append(None)
            continue
        ends = one["written"]["anchor"] == "end"
        left = one["written"]["x"] - (room.length(one["written"]["text"]) if ends else 0.0)
        lefts.append((left + room.wide, one["written"]["y"] + room.high))
    return lefts


def by_the_page(widths: list[float], places: list[tuple[float, float]]) -> list[list[float] | None]:
    """Left and top of names so wide by `names.js`, None for no room."""
    with chromium() as browser:
        page = browser.new_page()
        page.add_script_tag(content=(PAGE / "names.js").read_text(encoding="utf-8"))
        found: list[list[float] | None] = page.evaluate(
            """([size, widths, places]) => {
                const beside = window.ronnaplanNames({ clientWidth: size, clientHeight: size });
                return widths.map((width, n) => beside(width, ...places[n]));
            }""",
            [PIXELS, widths, places],
        )
    return found


def shortened_by_the_page(names: list[str], most: int) -> list[str]:
    """What `names.js` makes of names of which so many letters fit."""
    with chromium() as browser:
        page = browser.new_page()
        page.add_script_tag(content=(PAGE / "names.js").read_text(encoding="utf-8"))
        shortened: list[str] = page.evaluate(
            """([names, most]) => {
                const fits = (text) => [...text].length <= most;
                return names.map((name) => window.ronnaplanShortened(name, fits));
            }""",
            [names, most],
        )
    return shortened


@needs_browser
@few_and_others("most", [3], [1, 12])
def test_the_page_of_a_scene_shortens_names_as_a_picture_does(most: int) -> None:
    names = ["left STN", "left amygdala, second", "\U0001d400" * 30, "left a b c d e f g right", "x" * 500]
    rule = [abridged(name, most) if most > 2 else ELLIPSIS for name in names]
    assert apart(shortened_by_the_page, names, most) == [
        name if len(name) <= most else short for name, short in zip(names, rule, strict=True)
    ]


@needs_browser
def test_the_page_of_a_scene_writes_names_where_a_picture_has_them() -> None:
    room = Room(PIXELS / 2, PIXELS / 2, LINE_PIXELS / LINE_EM)
    assert pytest.approx(GAP_PIXELS) == GAP * PIXELS / 2
    generator = np.random.default_rng(5)
    lengths = [*generator.integers(3, 40, 60), 100, 130]  # the last two are shortened, and fit on neither side
    places = STEP * generator.integers(6, int(PIXELS / STEP) - 1, (len(lengths), 2))
    places[-2:, 0] = PIXELS / 2
    places[0, 0] = -STEP  # outside
    names = [("n" * int(length), float(x), float(y)) for length, (x, y) in zip(lengths, places, strict=True)]
    pictured = left_and_base(names, room)
    written_by_page = apart(
        by_the_page, [room.length(room.shortened(name)) for name, _, _ in names], [(x, y) for _, x, y in names]
    )
    assert pictured[0] is None
    assert [place is None for place in pictured] == [place is None for place in written_by_page]
    lines = set()
    for place, by_page, (_, _, y) in zip(pictured, written_by_page, names, strict=True):
        if place is not None and by_page is not None:
            assert (by_page[0], by_page[1] + LINE_PIXELS) == pytest.approx(place, abs=1e-6)
            lines.add(place[1] - y)
    assert len(lines) > 3  # so many were tried
    assert 0 < pictured.count(None) < len(names) / 4
