"""Readings are registered, doubted when outdated, and an ambiguous pairing is settled by pointing, never guessed."""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from ronnaplan.documents.plan_exchange import CONTACTS_HEADER, line_markups
from ronnaplan.documents.reading import to_json
from ronnaplan.errors import UsageError
from ronnaplan.geometry import Points
from ronnaplan.planner.panels import pointing_panel, registration_panel
from ronnaplan.planner.pixels import Pixel
from ronnaplan.planner.pointer import Pointer
from ronnaplan.planner.state import PlannerState
from ronnaplan.tracking.readers import BEGINNING_BYTES, READERS
from tests import cases
from tests.planner.conftest import reopened

T = cases.TARGET_MM
RECTANGLE = [(60.0, 40.0, 0.0), (-60.0, 40.0, 0.0), (-60.0, -40.0, 0.0), (60.0, -40.0, 0.0)]


@pytest.fixture
def ambiguous(state: PlannerState) -> PlannerState:
    """Four markers in a rectangle, which three half turns map onto itself, read as a, b, c, d."""
    found = state.case.found
    few = tuple(
        one.model_copy(update={"center": place}) for one, place in zip(found.fiducials, RECTANGLE, strict=False)
    )
    state.case.fiducials = found.model_copy(update={"fiducials": few})
    seen = cases.TURN.apply(np.array(RECTANGLE)) + cases.SHIFT_MM
    state.registering.register(
        Points(seen, np.tile(0.01 * np.eye(3), (4, 1, 1)), tuple("abcd"), cases.readings().frame)
    )
    return state


def pairs(state: PlannerState) -> dict[str, str]:
    assert state.case.registration is not None
    return {pair.ct: pair.ots for pair in state.case.registration.pairs}


def test_readings_are_registered_and_the_error_at_the_target_follows_the_plan(
    state: PlannerState, tmp_path: Path
) -> None:
    cases.write_readings(tmp_path / "readings.csv")
    assert state.storage.readings() == ["readings.csv"]
    state.registering.load_readings("readings.csv")
    assert state.case.registration is not None
    assert state.case.registration.status == "unique"
    assert json.loads((tmp_path / "registration.json").read_text())["status"] == "unique"
    assert registration_panel(state)["summary"].endswith("probability > 0.999999"), "nothing is certain"
    before = state.registering.expected_errors_mm()
    state.case.edit("left", target_mm=T - [0, 0, 60])
    assert state.registering.expected_errors_mm()["left target"] > before["left target"]
    assert state.registering.expected_errors_mm()["left entry"] == before["left entry"]


def test_the_page_offers_files_that_begin_as_readings_and_no_others(state: PlannerState, tmp_path: Path) -> None:
    state.case.keep_registration(cases.registration())
    sequence, points = "ObjectType = Image\nSeq_Frame0000_Timestamp = 0\n", '{"markups": []}'
    wanted = {
        **{f"table{suffix}": "name;x_in;y_in;z_in\n" for suffix in (".csv", ".tsv", ".txt")},  # why not, is told
        **{f"sequence{suffix}": sequence for suffix in (".mha", ".mhd", ".nrrd", ".nhdr")},
        **{"a.mrk.json": points, "points.FCSV": "# columns = id,x,y,z\n", "no header.csv": "1,2,3\n4,5,6\n"},
    }
    others = {
        **{"truth.json": '{"markers": [], "told": "\\"markups\\": ["}', "cut.mha": "ObjectType = Image\n"},
        **{"limits.json": points, "pivot.json": points, "readings.pdf": "x,y,z", "notes.txt": "of today\n1,2,3"},
        **{"lines.mrk.json": line_markups(state.case.plan), "contacts.csv": ",".join(CONTACTS_HEADER)},
        **{"paths.csv": "name,entry_x,entry_y,entry_z\nleft,1,2,3\n", "empty.csv": ""},
    }
    for name, text in {**wanted, **others}.items():
        (tmp_path / name).write_text(text)
    assert {Path(name).suffix.lower() for name in wanted} == set(READERS)
    assert state.storage.readings() == sorted(wanted)
    (tmp_path / "empty.csv").write_text("x,y,z\n1,2,3\n")
    assert state.storage.readings() == sorted([*wanted, "empty.csv"])
    with pytest.raises(UsageError, match=r"'truth\.json' is no readings file of this case"):
        state.registering.load_readings("truth.json")


def test_many_large_files_are_listed_at_once_and_once_read_no_more(
    state: PlannerState, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each page asks for the list whenever it is drawn."""
    asked: list[int] = []

    class Asked(io.FileIO):
        def read(self, size: int | None = -1, /) -> bytes:
            asked.append(-1 if size is None else size)
            return super().read(size)

    for number in range(20):
        with (tmp_path / f"{number}.json").open("wb") as file:
            file.truncate(2**30)
    monkeypatch.setattr(Path, "open", lambda path, _: Asked(path))
    assert state.storage.readings() == []
    assert asked == [BEGINNING_BYTES] * 20
    monkeypatch.setattr(Path, "open", None)
    assert state.storage.readings() == []


def test_a_registration_of_markers_since_rejected_predicts_nothing(state: PlannerState, tmp_path: Path) -> None:
    cases.write_readings(tmp_path / "readings.csv")
    state.registering.load_readings("readings.csv")
    assert state.case.outdated is None
    state.case.reject_marker("F2")
    assert "F2" in (state.case.outdated or "")
    assert reopened(state).registering.expected_errors_mm() == state.registering.expected_errors_mm() == {}
    state.registering.load_readings("readings.csv")
    assert state.case.outdated is None
    assert set(state.registering.expected_errors_mm()) == {"left entry", "left target"}


def test_no_file_outside_the_case_is_read(state: PlannerState, tmp_path: Path) -> None:
    outside = tmp_path / "case"
    outside.mkdir()
    cases.write_readings(outside / "readings.csv")
    (tmp_path / "link.csv").symlink_to(outside / "readings.csv")
    for name in ("case/readings.csv", "../readings.csv", str(outside / "readings.csv"), "link.csv"):
        with pytest.raises(UsageError, match="no readings file of this case"):
            state.registering.load_readings(name)


def test_an_ambiguous_reading_is_settled_by_pointing_at_one_marker(ambiguous: PlannerState) -> None:
    assert ambiguous.case.registration is not None
    assert ambiguous.case.registration.status == "ambiguous"
    assert ambiguous.registering.expected_errors_mm() == {}
    ambiguous.registering.point_at("F1", "a")
    assert pairs(ambiguous) == {"F1": "a", "F2": "b", "F3": "c", "F4": "d"}


@pytest.mark.parametrize("marker_first", [True, False])
@pytest.mark.parametrize(("reading", "expected"), [("a", "abcd"), ("c", "cdab")])
def test_a_marker_and_a_reading_are_picked_in_any_order(
    ambiguous: PlannerState, marker_first: bool, reading: str, expected: str
) -> None:
    assert ambiguous.registering.pointing
    picks: list[Callable[[], None]] = [
        lambda: ambiguous.jump_to_marker("F1"),
        lambda: ambiguous.registering.pick_reading(reading),
    ]
    for pick in picks if marker_first else picks[::-1]:
        assert not pairs(ambiguous)
        pick()
    assert pairs(ambiguous) == dict(zip(("F1", "F2", "F3", "F4"), expected, strict=True))
    assert not ambiguous.registering.pointing
    assert pointing_panel(ambiguous)["known"] == f"F1 is {reading}"


def test_a_marker_is_picked_by_a_press_in_a_cut(ambiguous: PlannerState) -> None:
    ambiguous.look.jump(RECTANGLE[2])
    cut = ambiguous.look.cut("axial")
    across, down, _ = cut.on_screen_mm(np.array(RECTANGLE[2]) + np.array([2.0, -3.0, 0.0]))
    scale = 500 / cut.field_mm
    pointer = Pointer(ambiguous)
    pointer.press("axial", Pixel(350 + across * scale, 250 + down * scale, 700.0, 500.0))
    pointer.release()
    assert ambiguous.registering.pointed_marker == ambiguous.look.marker == "F3"
    ambiguous.registering.pick_reading("c")
    assert pairs(ambiguous)["F1"] == "a"


def test_what_was_clicked_before_the_question_is_no_answer_to_it(state: PlannerState, tmp_path: Path) -> None:
    state.pick_marker("F1")
    assert state.registering.pointed_marker is None
    cases.write_readings(tmp_path / "readings.csv")
    state.registering.load_readings("readings.csv")
    with pytest.raises(UsageError, match="not ambiguous"):
        state.registering.pick_reading("1")


def test_what_was_pointed_at_is_forgotten_when_markers_change(ambiguous: PlannerState) -> None:
    """Another marker may have the label then; and there may be no markers at all."""
    ambiguous.registering.point_at("F1", "a")
    assert pointing_panel(ambiguous)["known"] == "F1 is a"
    ambiguous.case.rename_marker("F1", "nose")
    ambiguous.case.rename_marker("F2", "F1")
    assert pointing_panel(ambiguous)["known"] == ""
    ambiguous.case.fiducials = None
    assert pointing_panel(ambiguous)["known"] == ""


def test_a_marker_that_was_clicked_is_no_other_one_that_has_its_label_since(ambiguous: PlannerState) -> None:
    ambiguous.pick_marker("F1")
    ambiguous.case.rename_marker("F1", "nose")
    ambiguous.case.rename_marker("F2", "F1")
    assert ambiguous.registering.pointing
    ambiguous.registering.pick_reading("a")
    assert not pairs(ambiguous)
    assert pointing_panel(ambiguous)["marker"] == ""


def test_pointing_is_forgotten_when_it_is_left_or_readings_are_loaded(ambiguous: PlannerState) -> None:
    ambiguous.pick_marker("F1")
    ambiguous.registering.leave_pointing()
    ambiguous.registering.pick_reading("a")
    assert not pairs(ambiguous)
    assert ambiguous.registering.readings_mm is not None
    ambiguous.registering.register(ambiguous.registering.readings_mm)
    ambiguous.pick_marker("F1")
    assert not pairs(ambiguous)
    with pytest.raises(UsageError, match="no reading z"):
        ambiguous.registering.pick_reading("z")


def test_without_the_readings_an_ambiguity_is_not_settled(ambiguous: PlannerState) -> None:
    ambiguous.storage.fiducials.write_text(to_json(ambiguous.case.found))
    again = reopened(ambiguous)
    assert again.case.registration is not None
    assert again.case.registration.status == "ambiguous"
    assert not again.registering.pointing
    again.pick_marker("F1")
    assert again.registering.pointed_marker is None


def test_rivals_stand_beside_each_other_with_what_they_differ_in(ambiguous: PlannerState) -> None:
    panel = pointing_panel(ambiguous)
    assert panel["asked"]
    assert panel["heads"][:4] == ["most probable", "as probable", "as probable", "as probable"]
    answers = {"".join(cells[n] for _, cells, _ in panel["rivals"]) for n in range(4)}
    assert answers == {"abcd", "cdab", "badc", "dcba"}
    assert all(differs for _, _, differs in panel["rivals"])
    assert panel["touch"] in {"F1", "F2", "F3", "F4"}
    assert [label for label, _ in panel["readings"]] == list("abcd")
    assert registration_panel(ambiguous)["status"] == "ambiguous"
