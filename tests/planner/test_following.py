"""Tools that a tracker sees are shown where they are in the scan, and told with their distance from the target."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from types import SimpleNamespace
from typing import ClassVar

import numpy as np
import pytest

from ronnaplan.documents.reading import to_json
from ronnaplan.documents.registration import Frames
from ronnaplan.documents.tool import pivot_document, read_pivot
from ronnaplan.errors import FrameMismatchError, UsageError
from ronnaplan.planner.following import Following, seen_tools, told
from ronnaplan.planner.head_view import HeadView
from ronnaplan.planner.over_cut import over_cut
from ronnaplan.planner.panels import following_panel
from ronnaplan.planner.panes import Pane
from ronnaplan.planner.state import PlannerState
from ronnaplan.planner.storage import Storage
from ronnaplan.robot.pivot import PivotCalibration
from ronnaplan.scene.head import HeadParts
from ronnaplan.tracking.recording import Recording, ToolReading
from tests import cases

TIP_MM = np.array([1.0, -2.0, 90.0])


@pytest.fixture
def state(storage: Storage) -> PlannerState:
    """A registered case with a calibrated pointer."""
    cases.write_case(storage.plan.parent)
    none = np.zeros(20, dtype=bool)
    touched = PivotCalibration(TIP_MM, np.eye(3), np.zeros(3), np.eye(3), np.zeros(20), none, 0.1, none, none)
    storage.plan.with_name("pivot.json").write_text(to_json(pivot_document(touched, "pointer")))
    return PlannerState(cases.volume(), storage)


def touching(state: PlannerState, place_mm: np.ndarray, tool: str = "pointer") -> Recording:
    """The tool as the tracker sees it while its tip touches a place in the scan."""
    assert state.following.ct_from_ots is not None
    ots_from_m = np.eye(4)
    ots_from_m[:3, 3] = (np.linalg.inv(state.following.ct_from_ots) @ [*place_mm, 1.0])[:3] - TIP_MM
    return Recording("test", tools=(ToolReading(0, tool, ots_from_m), ToolReading(1, "other", None)))


def followed(state: PlannerState, *moments: Recording) -> Following:
    """Follow until all has come; then the stream is held open."""
    came, held = threading.Event(), threading.Event()

    def stream() -> Iterator[Recording]:
        yield from moments
        came.set()
        held.wait(60)

    state.following.start(stream)
    assert came.wait(60)
    held.set()
    return state.following


def test_a_calibrated_tip_is_told_from_the_target_and_drawn_in_every_view(state: PlannerState) -> None:
    state.look.select("left")
    path, head = state.case.plan.trajectory("left"), HeadView(state)
    head.open(HeadParts())
    beside = path.target_mm + 3.0 * np.cross(path.inward, [1.0, 0.0, 0.0])
    seen: list[str] = []

    def notify() -> None:
        if state.following.seen:
            drawn = over_cut(state, "axial", False, Pane())["points"]
            seen.extend(one["label"] for one in drawn)
            head.update(state.case.plan)
            assert head.scene is not None
            seen.extend(one["name"] for one in head.scene.listed)
            seen.append(told(state.following.seen[0], path))

    state.following.notify = notify
    state.look.jump(path.target_mm)
    followed(state, touching(state, beside))
    assert "pointer" in seen[0]
    assert {"tool pointer", "tracker"} <= set(seen)
    away = float(np.linalg.norm(beside - path.target_mm))
    assert f"{away:.1f} mm from the target of left, {away:.1f} mm beside its line" in seen[-1]


def test_a_tool_without_a_calibration_is_told_by_its_origin(state: PlannerState) -> None:
    assert state.following.ct_from_ots is not None
    (one,) = seen_tools(touching(state, np.zeros(3), "drill"), state.following.ct_from_ots, None)
    assert not one.calibrated
    assert "origin of its frame (no pivot.json of it)" in told(one, None)
    np.testing.assert_allclose(one.tip_mm + state.following.ct_from_ots[:3, :3] @ TIP_MM, 0.0, atol=1e-9)


def test_a_tip_is_of_the_tool_that_its_calibration_names_also_where_no_other_is_seen(state: PlannerState) -> None:
    """As where the calibrated pointer is hidden, and the reference on the head is not."""
    tip, pose = read_pivot(state.storage.plan.with_name("pivot.json")), state.following.ct_from_ots
    assert pose is not None
    for name, known in (("pointer", True), ("reference", False)):
        alone = Recording("test", tools=(ToolReading(0, name, np.eye(4)),))
        (one,) = seen_tools(alone, pose, tip)
        assert one.calibrated == known
        np.testing.assert_allclose(one.tip_mm, (pose @ [*(known * TIP_MM), 1.0])[:3], atol=1e-9)


def test_a_tool_is_drawn_from_its_tip_to_where_its_markers_are(state: PlannerState) -> None:
    tip = read_pivot(state.storage.plan.with_name("pivot.json"))
    seen = Recording("test", tools=(ToolReading(0, "pointer", np.eye(4)),))
    for side in (1.0, -1.0):
        (one,) = seen_tools(seen, np.eye(4), tip.model_copy(update={"tip": tuple(side * TIP_MM)}))
        assert one.back.tolist() == [0.0, 0.0, -side]  # the frame's origin is there, 90 mm from the tip


@pytest.mark.parametrize(("hidden_s", "shown"), [(60.0, ["pointer:", "drill:"]), (0.0, ["no"])])
def test_a_tool_that_is_hidden_is_shown_no_longer_while_others_are(
    state: PlannerState, monkeypatch: pytest.MonkeyPatch, hidden_s: float, shown: list[str]
) -> None:
    monkeypatch.setattr("ronnaplan.planner.following.HIDDEN_S", hidden_s)
    seen: list[list[str]] = []
    state.following.notify = lambda: seen.append([line.split()[0] for line in following_panel(state)["lines"]])
    place = np.zeros(3)
    followed(state, touching(state, place), touching(state, place, "drill"), Recording("test"))
    assert seen[2] == shown


def test_a_registration_that_is_taken_away_as_it_is_looked_at_ends_no_thread_without_a_word(
    state: PlannerState,
) -> None:
    """The tools stayed where they had been seen last."""
    found = iter([state.case.registration])

    class Case:
        registration, outdated = property(lambda _: next(found, None)), False

    state.following.case = Case()  # type: ignore[assignment]
    assert state.following._required().shape == (4, 4)
    with pytest.raises(UsageError, match="once its markers are registered"):
        state.following._required()


def test_a_stream_that_ends_is_told_and_one_without_a_registration_not_begun(
    state: PlannerState, storage: Storage
) -> None:
    told_after = threading.Event()
    state.following.notify = lambda: None if state.following.active else told_after.set()
    state.following.start(lambda: [Recording("test", notes=("the stream stopped",))])
    assert told_after.wait(60)
    assert str(state.following.ended) == "the stream stopped"
    assert not state.following.seen
    storage.registration.unlink()
    with pytest.raises(UsageError, match="once its markers are registered"):
        PlannerState(cases.volume(), storage).following.start(list)


def test_tools_are_not_shown_by_a_registration_of_readings_in_another_frame_than_the_trackers(
    state: PlannerState,
) -> None:
    file = state.storage.plan.with_name("registration.json")
    file.write_text(to_json(cases.registration().model_copy(update={"frames": Frames(ots="LPS")})))
    with pytest.raises(FrameMismatchError, match="readings are in the frame LPS"):
        PlannerState(cases.volume(), state.storage).following.start(lambda: ())


def test_tools_in_the_coordinates_of_several_systems_are_not_shown_as_if_in_the_trackers(
    state: PlannerState,
) -> None:
    """As a stylus that is sent in the reference's, or a robot's own pose: one moment may tell one of them only."""
    told_after = threading.Event()
    state.following.notify = lambda: None if state.following.active else told_after.set()
    names = ("StylusToTracker", "TcpToBase")
    state.following.start(lambda: [touching(state, np.zeros(3), name) for name in names])
    assert told_after.wait(60)
    assert "the coordinates of Base, Tracker; expected one of them" in str(state.following.ended)
    assert not state.following.seen


class LateEvent(threading.Event):
    """One that is asked at the end of a stream just as another stream is begun."""

    ended: ClassVar[threading.Event] = threading.Event()
    begin: ClassVar[threading.Thread]

    def is_set(self) -> bool:
        was = super().is_set()
        if self.ended.is_set() and threading.current_thread() is not self.begin and not self.begin.ident:
            self.begin.start()
            self.begin.join(0.5)
        return was


def test_a_stream_that_ends_as_another_begins_does_not_stop_that(
    state: PlannerState, monkeypatch: pytest.MonkeyPatch
) -> None:
    late = SimpleNamespace(Event=LateEvent, Thread=threading.Thread, Lock=threading.Lock)
    monkeypatch.setattr("ronnaplan.planner.following.threading", late)
    held, notified = threading.Semaphore(0), threading.Semaphore(0)

    def first() -> Iterator[Recording]:
        LateEvent.ended.set()
        yield from ()

    def second() -> Iterator[Recording]:
        yield touching(state, np.zeros(3))
        held.acquire(timeout=60)

    LateEvent.begin = threading.Thread(target=lambda: state.following.start(second))
    state.following.notify = notified.release
    state.following.start(first)
    assert notified.acquire(timeout=60)
    LateEvent.begin.join(60)
    assert notified.acquire(timeout=60)
    assert state.following.active
    assert [one.name for one in state.following.seen] == ["pointer"]
    held.release()
