"""OpenIGTLink messages that hold several tools (TDATA and QTDATA)."""

import struct
from types import SimpleNamespace

import numpy as np
import pytest

from ronnaplan.tracking.igtl_messages import MOST_NAMES, Stream
from tests.tracking.files import AWAY, turned
from tests.tracking.streams import named, quaternions_of_tools, tool_items, tools_of_plus


def stream_of(*messages: bytes, silence_s: float = 1.0, resting: tuple[str, ...] | None = None) -> Stream:
    stream = Stream(silence_s, resting)
    stream.feed(b"".join(messages))
    return stream


def test_each_tool_of_a_message_is_read_as_if_it_had_been_sent_by_itself() -> None:
    body = tool_items([("Reference", 1, turned(1)), ("Probe", 2, turned(2))])
    stream = stream_of(named("TDATA", b"Tracker", body), named("TDATA", b"Tracker", body, time_s=4))
    assert [(one.tool, one.frame, one.time_s, one.usable) for one in stream.tools] == [
        *(("Reference", 0, 3.0, True), ("Probe", 0, 3.0, True)),
        *(("Reference", 1, 4.0, True), ("Probe", 1, 4.0, True)),
    ]
    for one, sent in zip(stream.tools, [turned(1), turned(2)], strict=False):
        assert one.matrix is not None
        np.testing.assert_allclose(one.matrix, sent, rtol=1e-6, atol=1e-7)
    assert stream.notes == []


def test_a_quaternion_has_its_scalar_last_and_one_that_is_none_is_no_pose() -> None:
    stream = stream_of(
        quaternions_of_tools({"Probe": (2, (1, 2, 3, 0, 0, 0.6, 0.8)), "Lost": (2, (0, 0, 0, 0, 0, 0, 0))})
    )
    probe, lost = stream.tools
    expected = np.array([[0.28, -0.96, 0, 1], [0.96, 0.28, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]])
    assert probe.matrix is not None
    np.testing.assert_allclose(probe.matrix, expected, atol=1e-7)
    assert (lost.usable, lost.status) == (False, "no pose")


def test_a_tip_alone_is_a_point_and_a_tool_without_its_turn_is_no_pose() -> None:
    """The protocol fills in a rotation that nobody measured."""
    body = tool_items([("Tip", 3, AWAY), ("Needle", 4, turned(1)), ("Odd", 7, turned(2))])
    stream = stream_of(named("TDATA", b"Camera", body), named("TDATA", b"Camera", body))
    assert [(one.label, one.device, one.frame, one.usable) for one in stream.points] == [
        ("Tip", "Camera", 0, True),
        ("Tip", "Camera", 1, True),
    ]
    np.testing.assert_array_equal(stream.points[0].position_mm, AWAY[:3, 3])
    assert [one.status for one in stream.tools[:2]] == [
        "its turn about its own axis was not measured (5D)",
        "a tool of type 7, which OpenIGTLink does not know",
    ]


def test_tools_that_plus_calls_lost_are_flagged_each_by_itself() -> None:
    tools = {"ProbeToTracker": (2, turned(1)), "HeadToTracker": (2, turned(2)), "Tip": (3, AWAY)}
    told = {"ProbeToTrackerStatus": "OUT_OF_VIEW", "HeadToTrackerStatus": "OK", "TipStatus": "MISSING"}
    stream = stream_of(tools_of_plus(tools, told))
    assert [one.status for one in stream.tools] == ["out_of_view", "ok"]
    assert [one.status for one in stream.points] == ["missing"]


def test_what_is_filled_in_for_a_tool_and_what_is_no_pose_is_flagged() -> None:
    body = tool_items([("A", 2, np.eye(4)), ("B", 2, np.full((4, 4), np.nan)), ("C", 2, 2 * turned(1))])
    stream = stream_of(named("TDATA", b"Tracker", body))
    assert [one.usable for one in stream.tools] == [False] * 3


def test_tools_whose_names_were_cut_to_the_same_letters_are_not_taken_for_one() -> None:
    body = tool_items([(name, 2, turned(k)) for k, name in enumerate(["R" * 21 + "1", "R" * 21 + "2", "Probe"])])
    stream = stream_of(named("TDATA", b"Tracker", body))
    assert [one.usable for one in stream.tools] == [False, False, True]
    assert "20 letters" in stream.tools[0].status


def test_tools_of_one_message_have_the_same_frame_though_one_was_left_out_before() -> None:
    """They would be paired with those of another moment."""
    head, both = (
        tool_items([("Head", 2, turned(1))]),
        tool_items([("Head", 2, turned(2)), ("Probe", 2, turned(3))]),
    )
    stream = stream_of(named("TDATA", b"T", head), named("TDATA", b"T", both))
    assert [(one.tool, one.frame) for one in stream.tools] == [("Head", 0), ("Head", 1), ("Probe", 1)]


def test_a_tool_that_is_frozen_is_flagged_though_others_of_its_message_move() -> None:
    """A tracker's server goes on with the last pose of a tool that it does not see."""
    stream = Stream(0.0, resting=())
    for k in range(3):
        stream.feed(named("TDATA", b"T", tool_items([("Head", 2, AWAY), ("Probe", 2, turned(k))]), time_s=3 + k))
    assert [one.usable for one in stream.tools if one.tool == "Head"] == [True, False, False]
    assert all(one.usable for one in stream.tools if one.tool == "Probe")


def test_what_two_messages_tell_of_a_tool_counts_once() -> None:
    """PLUS sends TRANSFORM and TDATA of the same moment; frames that one of them counted paired other moments."""
    stream = Stream(1.0)
    for k in range(2):
        for device, seed in ((b"Probe", 2 * k), (b"Head", 2 * k + 1)):
            pose = struct.pack(">12f", *turned(seed)[:3].T.ravel())
            stream.feed(named("TRANSFORM", device, pose, time_s=3 + k))
        stream.feed(named("TDATA", b"T", tool_items([("Probe", 2, turned(2 * k))]), time_s=3 + k))
    assert [(one.tool, one.frame) for one in stream.tools] == [
        ("Probe", 0),
        ("Head", 0),
        ("Probe", 1),
        ("Head", 1),
    ]
    assert stream.notes == [
        "2 readings of Probe in TDATA messages of T were left out: TRANSFORM messages of Probe tell of it, too"
    ]


def test_a_tool_that_two_trackers_call_alike_is_that_of_the_first() -> None:
    stream = stream_of(
        *(named("TDATA", device, tool_items([("Probe", 2, turned(k))])) for k, device in enumerate([b"L", b"R"]))
    )
    assert len(stream.tools) == 1
    assert "TDATA messages of R were left out" in stream.notes[0]


def test_a_tool_stays_that_of_its_first_messages_though_these_fall_silent(monkeypatch: pytest.MonkeyPatch) -> None:
    """What others tell may be of another frame; they were left out, so that a live stream seemed to stand still."""
    stream = Stream(0.5)

    def tell(time_s: int, *, first: bool) -> None:
        monkeypatch.setattr("ronnaplan.tracking.igtl_messages.time", SimpleNamespace(monotonic=lambda: time_s))
        pose = struct.pack(">12f", *turned(time_s)[:3].T.ravel())
        stream.feed(named("TRANSFORM", b"Probe", pose, time_s=time_s) if first else b"")
        stream.feed(named("TDATA", b"Probe", tool_items([("Probe", 2, turned(time_s))]), time_s=time_s))

    tell(3, first=True)
    tell(4, first=False)
    tell(5, first=True)
    assert [one.status for one in stream.tools] == [
        "ok",
        "told by TDATA messages of Probe only, since TRANSFORM messages of Probe fell silent",
        "ok",
    ]


@pytest.mark.parametrize("body", [b"", bytes(69), bytes(71)])
def test_a_message_of_another_length_is_left_out_with_a_note(body: bytes) -> None:
    stream = stream_of(named("TDATA", b"T", body), named("QTDATA", b"T", struct.pack("51x")))
    assert (stream.tools, stream.broken) == ([], None)
    assert len(stream.notes) == 2
    assert "cannot be read" in stream.notes[0]


def test_a_tool_without_a_name_is_called_as_its_device() -> None:
    assert [one.tool for one in stream_of(named("TDATA", b"Tracker", tool_items([("", 2, AWAY)]))).tools] == [
        "Tracker"
    ]


def test_tools_that_are_made_up_end_the_stream() -> None:
    stream = stream_of(named("TDATA", b"T", tool_items([(f"{k}", 2, turned(1)) for k in range(MOST_NAMES + 1)])))
    assert "names" in str(stream.broken)
