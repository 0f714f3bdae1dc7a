"""Live OpenIGTLink readings from real servers on the loopback interface."""

import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

import numpy as np
import pyigtl
import pytest
from pyigtl.messages import CRC64

from ronnaplan.errors import InputError
from ronnaplan.tracking import find_markers, igtl_messages, openigtlink
from ronnaplan.tracking.igtl_messages import Stream
from ronnaplan.tracking.openigtlink import moments, record, rejoined_moments
from ronnaplan.tracking.recording import StreamEnd
from tests.tracking.files import AWAY
from tests.tracking.streams import named

POINTS = [[1.0, 2.0, -1000.0], [4.0, 5.0, -1001.0]]


@contextmanager
def server(chunks: list[bytes], hold: bool = True) -> Iterator[int]:
    """A plain TCP server that sends ``chunks`` to its first client, then holds or closes the connection."""
    listener = socket.create_server(("127.0.0.1", 0))
    done = threading.Event()

    def serve() -> None:
        connection, _ = listener.accept()
        with connection, suppress(ConnectionError):  # a client may leave early
            for chunk in chunks:
                connection.sendall(chunk)
                time.sleep(0.002)
            if hold:
                done.wait(10)

    thread = threading.Thread(target=serve, daemon=True)
    thread.start()
    try:
        yield listener.getsockname()[1]
    finally:
        done.set()
        thread.join(10)
        listener.close()


def points(positions: object = POINTS, device: str = "Polaris", time_s: float = 12.5) -> bytes:
    packed: bytes = pyigtl.PointMessage(
        positions=positions, names=["", "A"], device_name=device, timestamp=time_s
    ).pack()
    return packed


def pose(matrix: np.ndarray) -> bytes:
    packed: bytes = pyigtl.TransformMessage(matrix=matrix, device_name="ProbeToTracker").pack()
    return packed


def position(body: bytes) -> bytes:
    header = struct.pack(">H12s20sIIQQ", 1, b"POSITION", b"Pointer", 3, 0, len(body), CRC64(body))
    return header + body


def test_pyigtls_own_server_is_recorded() -> None:
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    source = pyigtl.OpenIGTLinkServer(port=port, local_server=True)
    stop = threading.Event()

    def send() -> None:
        while not stop.wait(0.02):
            if source.is_connected():
                source.send_message(pyigtl.PointMessage(positions=POINTS, device_name="Polaris"), wait=False)
                source.send_message(pyigtl.TransformMessage(matrix=AWAY, device_name="Probe"), wait=False)

    sender = threading.Thread(target=send, daemon=True)
    sender.start()
    try:
        recording = record("127.0.0.1", port, seconds=2.0)
    finally:
        stop.set()
        sender.join(10)
        source.stop()
    assert {tuple(p.position_mm) for p in recording.points} == {tuple(p) for p in POINTS}
    assert recording.tool_names == ("Probe",)
    np.testing.assert_array_equal(recording.poses("Probe")[0], AWAY)


def test_every_message_of_a_burst_is_kept_however_the_bytes_are_cut() -> None:
    stream = b"".join(points([[k, 0, 0], [0, k, 0]]) for k in range(200))
    cuts = [stream[k : k + 777] for k in range(0, len(stream), 777)]
    with server(cuts, hold=False) as port:
        recording = record("127.0.0.1", port, seconds=5)
    assert [p.position_mm[0] for p in recording.points[::2]] == list(range(200))
    assert [p.frame for p in recording.points[::2]] == list(range(200))
    assert [p.label for p in recording.points[:2]] == ["", "A"]
    assert recording.points[0].time_s == pytest.approx(12.5)


def test_what_a_program_fills_in_for_a_marker_that_is_not_seen_is_no_place_of_a_stream_either() -> None:
    sent = [points([[5.0, 6.0, -900.0 + k], [0.0, 0.0, 0.0] if k < 6 else [4.0, 5.0, -1001.0]]) for k in range(9)]
    with server(sent, hold=False) as port:
        recording = record("127.0.0.1", port, seconds=3.0)
    named = [one for one in recording.points if one.label == "A"]
    assert [one.usable for one in named] == [False] * 6 + [True] * 3
    assert named[0].status == "0, 0, 0, as is filled in for a marker that is not seen"


def test_a_pose_that_is_none_is_kept_flagged() -> None:
    with server(
        [pose(np.diag([-1.0, 1, 1, 1])), pose(np.full((4, 4), np.nan)), pose(np.eye(4)), pose(AWAY)], hold=False
    ) as port:
        recording = record("127.0.0.1", port, seconds=5)
    assert [tool.usable for tool in recording.tools] == [False, False, False, True]
    assert "left-handed" in recording.tools[0].status
    assert "it is the identity, as is filled in for a tool that is not seen" in recording.tools[2].status


def test_position_messages_in_the_protocols_layouts_and_in_pyigtls() -> None:
    half = np.sqrt(0.5)
    bodies = [
        struct.pack(">7f", 1, 2, 3, 0, 0, half, half),
        struct.pack(">6f", 1, 2, 3, 0, 0, half),
        struct.pack(">3f", 1, 2, 3),
    ]
    own = pyigtl.PositionMessage(
        positions=[[1, 2, 3]], quaternions=[[0, 0, half, half]], names=["P"], device_name="D"
    )
    other_name = named("QTRANS", b"Q", bodies[0])
    with server([*map(position, bodies), own.pack(), other_name], hold=False) as port:
        recording = record("127.0.0.1", port, seconds=5)
    quarter_turn = np.array([[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1.0]])
    np.testing.assert_allclose(recording.poses("Pointer"), [quarter_turn, quarter_turn], atol=1e-6)
    np.testing.assert_allclose(recording.poses("P")[0], quarter_turn, atol=1e-6)
    np.testing.assert_allclose(recording.poses("Q")[0], quarter_turn, atol=1e-6)


def test_a_place_without_a_rotation_is_a_point() -> None:
    """It was a pose whose rotation nobody had measured."""
    stream = Stream(1.0)
    stream.feed(position(struct.pack(">3f", 1, 2, 3)) + position(struct.pack(">3f", np.nan, 2, 3)))
    assert not stream.tools
    assert [(one.frame, one.label, one.device, one.usable) for one in stream.points] == [
        (0, "Pointer", "Pointer", True),
        (1, "Pointer", "Pointer", False),
    ]
    np.testing.assert_array_equal(stream.points[0].position_mm, [1, 2, 3])


def test_a_stream_that_closes_midway_keeps_what_came_and_says_so() -> None:
    with server([points(), points()[:70]], hold=False) as port:
        recording = record("127.0.0.1", port, seconds=5)
    assert len(recording.points) == 2
    assert recording.end is StreamEnd.CLOSED
    assert recording.notes == ("the server closed the stream after 1 messages in the middle of a message",)


def test_a_stream_that_falls_silent_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(openigtlink, "SILENCE_S", 1.0)
    with server([points()]) as port:
        recording = record("127.0.0.1", port, seconds=10)
    assert "the stream stopped" in recording.notes[0]


@pytest.mark.parametrize(("messages", "why"), [(1, "silent for 0.2 s"), (300, "its own time stands still")])
def test_moments_end_where_nothing_new_comes(messages: int, why: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A frozen tracker repeats its last reading, time and all."""
    monkeypatch.setattr(openigtlink, "SILENCE_S", 0.2)
    with server([points()] * messages) as port:
        last = list(moments("127.0.0.1", port, every_s=0.1, seconds=10))[-1]
    assert last.end is StreamEnd.STOPPED
    assert last.notes[-1].startswith(f"the stream stopped: {why}")


def test_moments_end_where_the_time_of_the_stream_leaps_back() -> None:
    """What was told before would stand otherwise, until its time has come again or the watch is over."""
    before = [points(time_s=1e9 + 0.05 * frame) for frame in range(10)]
    with server([*before, *(points(time_s=1e9 - 0.95 + 0.05 * frame) for frame in range(10))]) as port:
        *_, last = moments("127.0.0.1", port, every_s=0.1, seconds=1.0)
    assert last.end is StreamEnd.STOPPED
    assert last.notes[-1].startswith("the stream stopped: its own time leapt back by 1.4 s after")


def pose_of_robot(time_s: float) -> bytes:
    packed: bytes = pyigtl.TransformMessage(matrix=AWAY, device_name="Robot", timestamp=time_s).pack()
    return packed


@pytest.mark.parametrize("message", [pose_of_robot, lambda time_s: points(device="Camera", time_s=time_s)])
def test_a_device_whose_clock_lags_for_good_is_no_leap(message: Callable[[float], bytes]) -> None:
    late = [message(1e9 - 3.0 + 0.05 * frame) for frame in range(10)]
    frames = [points(time_s=1e9 + 0.05 * frame) for frame in range(10)]
    with server([one for pair in zip(frames, late, strict=True) for one in pair]) as port:
        *_, last = moments("127.0.0.1", port, every_s=0.1, seconds=1.0)
    assert last.end is None


@pytest.mark.parametrize(
    ("times_s", "told"),
    [
        ([5.0] * 9, [""] * 9),  # never set: of no time
        ([4.0, *[5.0] * 8], [*[""] * 4, *["of a time that stands still"] * 5]),
    ],
)
def test_a_robot_whose_time_was_never_another_one_states_none(
    times_s: list[float], told: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """It was late from two seconds on, for good, and nothing ever valid."""
    stream, why = Stream(2.0, resting=("Robot",)), []
    for second, time_s in enumerate(times_s):
        monkeypatch.setattr(time, "monotonic", lambda now=50.0 + second: now)
        moved = AWAY.copy()
        moved[0, 3] += 0.1 * second
        stream.feed(pyigtl.TransformMessage(moved, device_name="Robot", timestamp=time_s).pack())
        (one,) = stream.taken()
        why.append("" if one.usable else one.status)
    assert [said.split(",")[0] for said in why] == told
    assert bool(stream.clocks.notes) == (not any(told))
    assert all("state the time 5 in all of them, which is none" in note for note in stream.clocks.notes)


@pytest.mark.parametrize("untimed", ["the robot", "the head", "the head, which comes first"])
def test_readings_without_a_time_are_of_the_moment_of_those_before_them(untimed: str) -> None:
    """Though all come at once, as after a halt: they were all of the newest moment, and those before had none.

    A head's of no time were placed by this computer's clock at first, and no moment was whole beside another one.
    """
    frames = []
    for frame in range(9):
        head = points(time_s=0.0 if "head" in untimed else 1e9 + 0.05 * frame)
        others = pose_of_tool(frame) + pose_of_robot(1e9 + 0.05 * frame if "head" in untimed else 0.0)
        frames.append(others + head if untimed == "the head" else head + others)
    with server([b"".join(frames)]) as port:
        *told, _ = moments("127.0.0.1", port, every_s=0.1, seconds=0.5)
    assert [{one.tool for one in moment.tools} for moment in told] == [{"Tool", "Robot"}] * len(told)
    assert all(moment.points for moment in told)
    assert len(told) >= 3


def pose_of_tool(frame: int) -> bytes:
    stamp = 1e9 + 0.05 * frame
    packed: bytes = pyigtl.TransformMessage(matrix=AWAY, device_name="Tool", timestamp=stamp).pack()
    return packed


def test_a_stream_that_is_restarted_is_joined_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its end is told; its clock may be another one (set back, say), and it may be away for a while."""
    monkeypatch.setattr(openigtlink, "PAUSE_S", 0.05)
    listener = socket.create_server(("127.0.0.1", 0))
    port = listener.getsockname()[1]

    def serve() -> None:
        on = listener
        for start_s, away_s in ((1e9, 0.12), (1e9 - 3, 0.0)):
            connection, _ = on.accept()
            with connection:
                for frame in range(5):
                    connection.sendall(points(time_s=start_s + 0.05 * frame))
            on.close()
            if away_s:
                time.sleep(away_s)
                on = socket.create_server(("127.0.0.1", port))

    thread = threading.Thread(target=serve, daemon=True)
    thread.start()
    told = list(rejoined_moments("127.0.0.1", port, every_s=0.1, seconds=10, rejoin_s=0.3))
    thread.join(10)
    assert [one.end for one in told] == [None, None, StreamEnd.CLOSED] * 2
    assert told[2].notes[-1] == "the server closed the stream after 5 messages; it is tried again for 0.3 s"


@pytest.mark.parametrize("message", [pose_of_robot, lambda time_s: points(time_s=time_s)])
def test_readings_of_a_device_that_repeats_its_last_message_are_flagged(message: Callable[[float], bytes]) -> None:
    """Others go on, so that the stream's time does not stand still, and what has moved since would look at rest."""
    stream = Stream(0.0)
    for frame, time_s in enumerate([1e9, 1e9, 1e9, 1e9 + 0.05, 0.0, 0.0]):
        stream.feed(message(time_s))
        stream.feed(points(device="Other", time_s=1e9 + frame))
        taken = stream.taken()
        of_device = taken[:-2]
        assert {one.usable for one in of_device} == {frame not in (1, 2)}
        assert all(one.usable for one in taken[-2:])


def test_a_device_that_never_sets_its_time_again_is_not_frozen_while_its_places_change() -> None:
    stream = Stream(0.0)
    for frame in range(3):
        stream.feed(points(np.asarray(POINTS) + frame))
    taken = stream.taken()
    assert [one.usable for one in taken] == [True] * (3 * len(POINTS))


@pytest.mark.parametrize("times_s", [(1e9, 1e9 + 0.05, 1e9 + 0.1), (0.0, 0.0, 0.0)])
def test_what_is_watched_is_frozen_while_its_places_stay_to_the_last_digit(times_s: tuple[float, ...]) -> None:
    """A sender that repeats what it last heard of a tracker gives it a new time; a robot at rest tells the same."""
    stream, frozen = Stream(0.0, resting=("Robot",)), []
    for time_s in times_s:
        stream.feed(points(time_s=time_s) + pose_of_robot(time_s))
        *taken, robot = stream.taken()
        frozen.append({one.usable for one in taken})
        assert robot.usable
    assert frozen == [{True}, {False}, {False}]


@pytest.mark.parametrize(
    ("rate", "seconds", "resting", "counting"),
    [(0.5, range(10), ("Robot",), 5), (0.5, range(10), None, 10), (0.9995, range(0, 36_000, 600), ("Robot",), 60)],
)
def test_what_is_watched_counts_no_longer_once_its_stream_falls_behind(
    rate: float, seconds: range, resting: tuple[str, ...] | None, counting: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What waited in a slow sender's queue was told as of now. One clock may be a little slower than another."""
    stream, counted = Stream(2.0, resting), []
    for second in seconds:
        monkeypatch.setattr(time, "monotonic", lambda now=50.0 + second: now)
        time_s = 1e9 + rate * second
        stream.feed(points(np.asarray(POINTS) + 1e-3 * second, time_s=time_s) + pose_of_robot(time_s))
        counted.append({one.usable for one in stream.taken()})
    assert counted == [{True}] * counting + [{False}] * (len(seconds) - counting)


def test_a_moment_that_had_only_begun_when_the_time_was_up_is_left_out() -> None:
    frames = [points(time_s=1e9 + 0.05 * frame) for frame in range(3)]
    with server(frames) as port:
        told = list(moments("127.0.0.1", port, every_s=0.1, seconds=0.5))
        assert [len(one.points) for one in told] == [4, 0]
    with server(frames) as port:
        (only,) = moments("127.0.0.1", port, every_s=10, seconds=0.5)
        assert len(only.points) == 6
    with server(frames, hold=False) as port:
        told = list(moments("127.0.0.1", port, every_s=0.1, seconds=10))
        assert [len(one.points) for one in told] == [4, 2]


def point_item(name: bytes, place: tuple[float, float, float]) -> bytes:
    return struct.pack(">64s32s4B3ff20s", name, b"", 0, 0, 0, 0, *place, 0.0, b"")


def test_names_that_are_no_text_end_neither_the_stream_nor_their_message() -> None:
    items = (
        point_item(b"A\xff", (1, 2, 3)) + point_item(b"A\xfe", (4, 5, 6)) + point_item(b"B\0left over", (7, 8, 9))
    )
    with server([named("POINT", b"Pol\xff", items), points()], hold=False) as port:
        recording = record("127.0.0.1", port, seconds=5)
    assert [p.label for p in recording.points] == [r"A\xff", r"A\xfe", "B", "", "A"]
    np.testing.assert_array_equal(recording.points[2].position_mm, [7, 8, 9])
    assert recording.notes == ("the server closed the stream after 2 messages",)


def test_names_from_the_network_cannot_steer_a_terminal() -> None:
    escape = b"\x1b]0;owned\x07\x1b[2J"
    bad = bytearray(named("POINT", escape, b"short"))
    transform = named("TRANSFORM", escape, pose(AWAY)[58:])
    with server([bytes(bad), named("POINT", b"P", point_item(escape, (1, 2, 3))), transform], hold=False) as port:
        recording = record("127.0.0.1", port, seconds=5)
    told = [*recording.notes, recording.points[0].label, recording.tools[0].tool]
    assert all(text.isprintable() for text in told)
    assert r"\x1b]0;owned" in recording.notes[0]
    assert r"\x1b]0;owned" in recording.points[0].label


def test_a_message_of_thirty_thousand_points_is_read_whole_and_refused_as_markers() -> None:
    items = b"".join(point_item(f"M{k}".encode(), (k, 0, 0)) for k in range(30_000))
    with server([named("POINT", b"P", items)], hold=False) as port:
        recording = record("127.0.0.1", port, seconds=30)
    assert [p.label for p in recording.points] == [f"M{k}" for k in range(30_000)]
    with pytest.raises(InputError, match="names 30000 markers; expected 1000 at most"):
        find_markers(recording)


def test_a_message_with_metadata_is_read_as_pyigtl_packs_it() -> None:
    message = pyigtl.PointMessage(positions=POINTS, names=["F", "G"], device_name="P", timestamp=7.25)
    message.header_version, message.metadata = 2, {"unit": "mm", "key": "value"}
    with server([message.pack()], hold=False) as port:
        recording = record("127.0.0.1", port, seconds=5)
    assert [p.label for p in recording.points] == ["F", "G"]
    np.testing.assert_array_equal([p.position_mm for p in recording.points], POINTS)
    assert recording.points[0].time_s == pytest.approx(7.25)


@pytest.mark.parametrize(
    ("metadata", "status"),
    [
        ({"TransformStatus": "OUT_OF_VIEW", "TransformValid": "0"}, "out_of_view"),
        ({"TransformValid": "False"}, "not valid"),
        ({"TransformValid": "\0"}, "not valid"),
        ({"TransformStatus": "OK", "TransformValid": "\1", "Other": "MISSING"}, "ok"),
        ({}, "ok"),
    ],
)
def test_a_pose_that_plus_calls_invalid_is_flagged(metadata: dict[str, str], status: str) -> None:
    sent = pyigtl.TransformMessage(matrix=AWAY, device_name="ProbeToTracker")
    sent.header_version, sent.metadata = 2, metadata
    packed = sent.pack()
    numbers = ([1, 2, 3, 0, 0, 0.6, 0.8], [1, 2, 3])
    bodies = [packed[58:70] + np.array(one, dtype=">f4").tobytes() + packed[70 + 48 :] for one in numbers]
    with server([packed, *(named("POSITION", b"Pointer", body, 2) for body in bodies)], hold=False) as port:
        recording = record("127.0.0.1", port, seconds=5)
    assert [one.status for one in recording.tools] == [status] * 2
    assert [one.status for one in recording.points] == [status]


def test_a_message_whose_metadata_end_early_is_left_out_with_a_note() -> None:
    sent = pyigtl.TransformMessage(matrix=AWAY, device_name="Probe")
    sent.header_version, sent.metadata = 2, {"TransformStatus": "OK"}
    packed = bytearray(sent.pack())
    packed[58 + 12 + 48 + 1] = 9  # entries, of which there is one
    packed[50:58] = CRC64(bytes(packed[58:])).to_bytes(8, "big")
    with server([bytes(packed), points()], hold=False) as port:
        recording = record("127.0.0.1", port, seconds=5)
    assert recording.tools == ()
    assert "TRANSFORM messages of Probe cannot be read" in recording.notes[0]


def test_matrices_that_are_nearly_rotations_are_the_nearest() -> None:
    rough = np.eye(4)
    rough[0, 1] = 5e-4
    with server([pose(rough), pose(1.01 * np.eye(4))], hold=False) as port:
        recording = record("127.0.0.1", port, seconds=5)
    (matrix,) = recording.poses("ProbeToTracker")
    np.testing.assert_allclose(matrix[:3, :3] @ matrix[:3, :3].T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(matrix, rough, atol=3e-4)
    assert "1 of 2 poses" in recording.notes[0]


def test_what_was_recorded_until_ctrl_c_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    feed = Stream.feed

    def interrupted(self: Stream, data: bytes) -> None:
        feed(self, data)
        raise KeyboardInterrupt

    monkeypatch.setattr(Stream, "feed", interrupted)
    with server([points()]) as port:
        recording = record("127.0.0.1", port, seconds=60)
    assert len(recording.points) == 2
    assert recording.notes == ("stopped by hand after 1 messages",)
    with server([points()[:70]]) as port, pytest.raises(KeyboardInterrupt):
        record("127.0.0.1", port, seconds=60)


def test_a_server_that_never_answers_is_not_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    let_go = threading.Event()

    def never(*_: object, **__: object) -> socket.socket:
        let_go.wait(30)
        raise OSError

    monkeypatch.setattr(openigtlink, "CONNECT_S", 0.2)
    monkeypatch.setattr(socket, "create_connection", never)
    with pytest.raises(InputError, match=r"nothing within 0\.2 s"):
        record("nowhere", 1, seconds=5)
    let_go.set()


def test_a_recording_does_not_take_the_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(igtl_messages, "MOST_READINGS", 100)
    with server([points()] * 60) as port:
        recording = record("127.0.0.1", port, seconds=10)
    assert len(recording.points) == 100
    assert "100 readings came" in recording.notes[0]
    lost = named("POINT", b"P", b"")[:42] + struct.pack(">QQ", 1 << 40, 0)
    with server([lost]) as port, pytest.raises(InputError, match="a body of 1099511627776 bytes"):
        record("127.0.0.1", port, seconds=5)


@pytest.mark.parametrize(
    "message",
    [
        lambda n: points(device=f"P{n}"),
        lambda n: named("POSITION", b"P%d" % n, struct.pack(">3f", 1.0, 2.0, 3.0)),
        lambda n: named("POINT", b"P%d" % n, b"none"),
        lambda n: named(f"K{n}", b"P", b""),
    ],
    ids=["devices", "tools", "faults", "kinds"],
)
def test_a_sender_that_makes_up_names_ends_the_stream(
    message: Callable[[int], bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each name would be remembered for as long as the stream lasts."""
    monkeypatch.setattr(igtl_messages, "MOST_NAMES", 20)
    stream = Stream(openigtlink.SILENCE_S)
    stream.feed(b"".join(message(n) for n in range(20)) * 2)
    assert stream.broken is None
    stream.feed(b"".join(message(n) for n in range(20, 60)))
    assert (stream.broken or "").startswith("21 names of devices, tools or faults came")


def test_alike_faults_are_told_once() -> None:
    damaged = bytearray(points())
    damaged[-30] ^= 0xFF
    with server([bytes(damaged) * 500 + points()], hold=False) as port:
        recording = record("127.0.0.1", port, seconds=10)
    assert recording.notes[0] == "500 POINT messages of Polaris failed their checksum and were left out"


def test_a_damaged_message_is_left_out_with_a_note() -> None:
    damaged = bytearray(points())
    damaged[-30] ^= 0xFF
    with server([bytes(damaged), points()], hold=False) as port:
        recording = record("127.0.0.1", port, seconds=5)
    assert len(recording.points) == 2
    assert "checksum" in recording.notes[0]


@pytest.mark.parametrize("kind", ["RTS_TDATA", "GET_CAPABIL", "STT_QTDATA"])
def test_what_asks_or_answers_ends_no_stream(kind: str) -> None:
    with server([points(), named(kind, b"Tracker", b"\0\0"), points(time_s=12.6)], hold=False) as port:
        recording = record("127.0.0.1", port, seconds=5)
    assert [one.frame for one in recording.points] == [0, 0, 1, 1]
    assert recording.end is StreamEnd.CLOSED


def test_other_messages_are_passed_over() -> None:
    with server([pyigtl.StringMessage("hello", device_name="S").pack(), points()], hold=False) as port:
        assert len(record("127.0.0.1", port, seconds=5).points) == 2


@pytest.mark.parametrize(
    ("chunks", "says"),
    [
        ([b"HTTP/1.1 400 Bad Request\r\n" * 10], "not OpenIGTLink"),
        ([], "no readable message"),
        (
            [pyigtl.StringMessage("a", device_name="S").pack()] * 3,
            "3 STRING came; POINT, TRANSFORM, POSITION, TDATA and QTDATA are read",
        ),
    ],
)
def test_a_server_that_speaks_something_else_is_named(chunks: list[bytes], says: str) -> None:
    with server(chunks, hold=False) as port, pytest.raises(InputError, match=says):
        record("127.0.0.1", port, seconds=1)


def test_no_server_is_named() -> None:
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    with pytest.raises(InputError, match="no OpenIGTLink server"):
        record("127.0.0.1", port, seconds=1)
    with pytest.raises(InputError, match="above zero"):
        record("127.0.0.1", port, seconds=0)
