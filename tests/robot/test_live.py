"""The live chain: what moved is told apart by simulated moments, and no pose is given when anything did."""

from __future__ import annotations

import json
import re
import signal
import socket
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from itertools import groupby
from pathlib import Path

import numpy as np
import pyigtl
import pytest
from scipy.spatial.transform import Rotation

from phantoms.live_room import RATE_HZ, LiveRoom, serve
from phantoms.robot_session import READING_SD_MM, placed
from ronnaplan.cli import main
from ronnaplan.geometry import FloatArray
from ronnaplan.pose import Pose
from ronnaplan.robot.chain import TCP, M
from ronnaplan.robot.live import LiveStatus
from ronnaplan.tracking import openigtlink
from ronnaplan.tracking.recording import PointReading
from tests.robot.live_documents import write_documents
from tests.robot.live_moments import CASE, live, recording

TURN = placed(Rotation.from_rotvec([0, 0, 0.004]), np.array([1.5, -2.0, 1.0]))


@pytest.fixture
def room() -> LiveRoom:
    return LiveRoom.of_case(CASE)


@pytest.mark.parametrize(
    ("changes", "status"),
    [
        ({}, LiveStatus.VALID),
        ({"head_moved": TURN}, LiveStatus.HEAD_MOVED),
        ({"base_moved": TURN}, LiveStatus.ROBOT_MOVED),
        ({"tracker_moved": TURN}, LiveStatus.TRACKER_MOVED),
        ({"head_moved": TURN, "base_moved": np.linalg.inv(TURN)}, LiveStatus.BOTH_MOVED),
        ({"loose": 1}, LiveStatus.MARKER_MOVED),
    ],
)
def test_what_moved_is_told_apart(room: LiveRoom, changes: dict[str, FloatArray], status: LiveStatus) -> None:
    chain = live(room)
    assert chain.judge(recording(room)).status is LiveStatus.VALID
    moment = chain.judge(recording(replace(room, **changes)))  # type: ignore[arg-type]
    assert moment.status is status
    assert (moment.robot_from_ct is not None) == (status is LiveStatus.VALID)


def test_a_moment_of_more_readings_than_a_tracker_makes_tells_nothing_and_ends_no_watch(room: LiveRoom) -> None:
    chain, whole = live(room), recording(room)
    crowd = tuple(PointReading(0, np.array([k, 0.0, -900.0])) for k in range(1500))
    moment = chain.judge(replace(whole, points=(*whole.points, *crowd)))
    assert (moment.status, moment.robot_from_ct) == (LiveStatus.UNSEEN, None)
    assert re.fullmatch("frame 0 holds 15.. readings; expected 1200 at most", moment.why)
    assert chain.judge(whole).status is LiveStatus.VALID


def test_a_head_whose_readings_do_not_count_is_unseen_with_the_reason(room: LiveRoom) -> None:
    chain, whole = live(room), recording(room)
    frozen = tuple(replace(one, status="repeated") for one in whole.points)
    moment = chain.judge(replace(whole, points=frozen))
    assert moment.status is LiveStatus.UNSEEN
    assert moment.why.endswith(f"off one line are seen; {len(frozen)} readings say 'repeated'")


@pytest.mark.parametrize("by_mm", [1.2, 7.0, 40.0])
def test_a_head_that_moved_is_not_valid_where_its_former_places_are_sent_along(
    room: LiveRoom, by_mm: float
) -> None:
    chain = live(room)
    moved = recording(replace(room, head_moved=placed(Rotation.identity(), np.array([by_mm, 0, 0]))))
    both = replace(moved, points=(*moved.points, *recording(room).points))
    moment = chain.judge(both)
    assert moment.status is LiveStatus.UNSEEN
    assert moment.robot_from_ct is None
    assert "markers are read at two places of one frame, of which one may be of before" in moment.why


def test_a_head_that_moved_is_not_valid_where_its_former_places_come_in_frames_of_their_own(
    room: LiveRoom,
) -> None:
    """The last frame alone told the moment, which was that of its former places as often as not."""
    chain, whole = live(room), recording(room)
    moved = recording(replace(room, head_moved=placed(Rotation.identity(), np.array([1.2, 0, 0]))))
    new = [replace(one, frame=2 * one.frame) for one in moved.points]
    former = [replace(one, frame=2 * one.frame + 1) for one in whole.points]
    for points in (
        [*new, *former],
        [replace(one, frame=one.frame + 1) for one in new] + former[: len(former) // 2],
    ):
        moment = chain.judge(replace(moved, points=tuple(points)))
        assert (moment.status, moment.robot_from_ct) == (LiveStatus.HEAD_MOVED, None)
    assert chain.judge(whole).status is LiveStatus.VALID


def test_a_head_that_is_seen_far_from_where_it_was_is_told_so(room: LiveRoom) -> None:
    """A jump farther than markers are followed was told as if none of them were seen."""
    chain = live(room)
    room.head_moved[:3, 3] = (0.0, 30.0, 0.0)
    moment = chain.judge(recording(room))
    assert moment.status is LiveStatus.UNSEEN
    assert re.search(r"seen; most points are (2\d|30) mm and more from where markers were last: ", moment.why)
    room.head_moved[:3, 3] = 0.0
    whole = recording(room)
    two = tuple(one for n, one in enumerate(whole.points) if n % len(live(room).head) < 2)
    assert live(room).judge(replace(whole, points=two)).why.endswith("off one line are seen")


@pytest.mark.parametrize(("device", "told"), [("tool", "the tool"), ("robot", "the robot's pose")])
def test_poses_that_do_not_count_are_told_as_a_streams_and_not_as_a_files(
    room: LiveRoom, device: str, told: str
) -> None:
    """A stream of NaN was advised to have a ';' between its columns."""
    whole = recording(room)
    hidden = tuple(
        replace(one, matrix=None, status="no pose") if one.tool == device else one for one in whole.tools
    )
    for tool_device in ("tool", None):
        moment = live(room, tool_device=tool_device).judge(replace(whole, tools=hidden))
        assert moment.status is LiveStatus.UNSEEN
        assert moment.why == f"{told} is not seen; 10 readings say 'no pose'"
    moment = live(room, tool_device="other").judge(whole)
    assert moment.why == "simulated has no tool 'other'; it has tool"


def test_what_moved_by_more_than_the_gate_in_steps_is_followed(room: LiveRoom) -> None:
    chain = live(room)
    for far in np.arange(1, 6) * 8.0:
        moment = chain.judge(
            recording(replace(room, head_moved=placed(Rotation.identity(), np.array([far, 0, 0]))))
        )
        assert moment.status is LiveStatus.HEAD_MOVED
        assert moment.head is not None
        assert moment.head.shift_mm == pytest.approx(far, abs=0.3)


def test_the_live_pose_is_right_within_its_covariance_wherever_the_arm_stands(room: LiveRoom) -> None:
    chain, session = live(room), room.session
    truth = session.robot_from_ots @ session.ots_from_ct
    middle = np.linalg.inv(session.ots_from_ct)[:3] @ np.append(session.markers_ots_mm.mean(axis=0), 1)
    for k in range(6):
        driven = room.robot_from_tcp @ placed(
            Rotation.from_rotvec([0.1 * k, -0.05 * k, 0]), np.array([10.0 * k, 0, -5])
        )
        pose = chain.judge(recording(replace(room, robot_from_tcp=driven))).robot_from_ct
        assert pose is not None
        off = pose.apply(middle[None])[0] - truth[:3] @ np.append(middle, 1)
        spread = pose.point_covariances(middle[None])[0]
        assert off @ np.linalg.solve(spread, off) < 16.3  # of three, 99.9 %


def test_a_resting_room_is_called_valid_and_its_robots_chances_are_even(room: LiveRoom) -> None:
    """With the arm where it was and one frame a moment, the chances stated are those of errors as stated."""
    chances = []
    for _ in range(50):
        chain = live(room)
        moment = chain.judge(recording(room, frames=1))
        assert moment.status is LiveStatus.VALID
        assert moment.robot is not None
        chances.append(moment.robot.probability)
    # errors are overstated (averaged looks, robot counted twice): 0.83, and 0.6 with covariances 1.5 times too small
    assert np.mean(np.array(chances) > 0.5) > 0.65
    assert min(chances) > 1e-4


def test_the_tools_calibration_blurs_a_movement_only_when_the_arm_has_turned(room: LiveRoom) -> None:
    chain = live(room)
    loose = Pose(chain.capture.m_from_tcp.matrix, chain.capture.m_from_tcp.covariance * 1e4, M, TCP)
    blurred = replace(chain, capture=replace(chain.capture, m_from_tcp=loose))
    turned = room.robot_from_tcp @ placed(Rotation.from_rotvec([0.5, 0, 0]), np.zeros(3))
    for arm, least, most in ((room.robot_from_tcp, 0.9, 1.2), (turned, 20.0, 1e4)):
        seen = recording(replace(room, robot_from_tcp=arm))
        spreads = [
            np.trace(one.robot.pose.covariance) for one in (c.judge(seen) for c in (chain, blurred)) if one.robot
        ]
        assert least < spreads[1] / spreads[0] < most


def test_without_the_robots_poses_a_moved_arm_counts_as_a_moved_robot(room: LiveRoom) -> None:
    chain = live(room, robot_device=None)
    assert chain.judge(recording(room, robot=False)).status is LiveStatus.VALID
    driven = room.robot_from_tcp @ placed(Rotation.identity(), np.array([5.0, 0, 0]))
    moved = recording(replace(room, robot_from_tcp=driven), robot=False)
    assert chain.judge(moved).status is LiveStatus.ROBOT_MOVED


def test_what_is_hidden_or_moving_is_not_judged(room: LiveRoom) -> None:
    chain, whole = live(room), recording(room)
    headless = chain.judge(replace(whole, points=whole.points[:2]))
    assert (headless.status, headless.robot_from_ct) == (LiveStatus.UNSEEN, None)
    toolless = chain.judge(replace(whole, tools=tuple(one for one in whole.tools if one.tool == "robot")))
    assert toolless.status is LiveStatus.UNSEEN
    away = replace(room, robot_from_tcp=room.robot_from_tcp @ placed(Rotation.identity(), np.array([0, 40.0, 0])))
    moving = replace(whole, tools=whole.tools + recording(away).tools)
    moving = replace(moving, tools=tuple(replace(one, frame=k) for k, one in enumerate(moving.tools)))
    moment = chain.judge(moving)
    assert moment.status is LiveStatus.MOVING
    assert moment.why.endswith("let it rest")  # nobody can name one frame of a stream


def test_tools_of_several_systems_are_not_taken_for_the_trackers(room: LiveRoom) -> None:
    """The robot's own poses are named, and may be in its own; a tool in a reference's coordinates may not."""
    chain, names = live(room, robot_device="TcpToBase", tool_device="ToolToTracker"), {"robot": "TcpToBase"}
    whole = recording(room)
    for other, status in (("OtherToTracker", LiveStatus.VALID), ("OtherToReference", LiveStatus.UNSEEN)):
        known = names | {"tool": "ToolToTracker"}
        tools = tuple(replace(one, tool=known[one.tool]) for one in whole.tools)
        tools += (replace(tools[0], tool=other),)
        moment = chain.judge(replace(whole, tools=tools))
        assert moment.status is status
    assert "coordinates of Reference, Tracker" in moment.why


def watched(
    room: LiveRoom, folder: Path, send: Callable[[socket.socket], None], *options: str
) -> tuple[int, Path]:
    """Watch what ``send`` does to who connects to a listener; return the exit status and the lines that were written.

    The documents are those of the chain in ``room``.
    """
    write_documents(live(room), room, folder)
    told = [f"--{name}={folder / name}.json" for name in ("chain", "registration")]
    told += [f"--geometry={folder / 'tool.json'}", "--tool=tool", "--robot-device=robot"]
    out = folder / "live.jsonl"
    with socket.create_server(("127.0.0.1", 0)) as listener:
        thread = threading.Thread(target=send, args=(listener,), daemon=True)
        thread.start()
        told += [
            f"--sigma-ots={READING_SD_MM}",
            f"--port={listener.getsockname()[1]}",
            f"--output={out}",
            *([] if any(one.startswith("--rejoin") for one in options) else ["--rejoin=0"]),
            *options,
        ]
        status = main(["robot", "watch", *told])
    return status, out


def statuses(lines: Path) -> list[str]:
    """Return what was told, without what was told again."""
    return [status for status, _ in groupby(json.loads(line)["status"] for line in lines.read_text().splitlines())]


def test_the_command_follows_a_stream_to_its_end_which_is_no_pose(
    room: LiveRoom, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The server closes while all is well: nobody looks any more, so that the last valid pose does not stand."""
    begun = datetime.now(UTC) - timedelta(milliseconds=1)  # in which the lines are told
    parts = [
        (room, 1.5),
        (replace(room, head_moved=TURN), 1.0),
        (room, 1.0),
        (replace(room, base_moved=TURN), 1.0),
    ]
    status, out = watched(
        room, tmp_path, lambda listener: serve(listener, [*parts, (room, 1.0)], in_real_time=False)
    )
    assert status == 3
    assert statuses(out) == ["valid", "head_moved", "valid", "robot_moved", "valid", "unseen"]
    rows = [json.loads(line) for line in out.read_text().splitlines()]
    assert all((row["robot_from_ct"] is None) == (row["status"] != "valid") for row in rows)
    times = [datetime.fromisoformat(row["time"]) for row in rows]
    assert times == sorted(times)
    assert begun <= times[0] <= times[-1] <= datetime.now(UTC)
    told = capsys.readouterr().err
    assert re.search(r"the head moved; register again; head: \d\.\d\d mm, 0\.\d\d degrees", told)
    assert re.search(r"nothing is known; the server closed the stream after \d+ messages\n$", told)


def test_what_was_watched_is_in_the_file_at_once(room: LiveRoom, tmp_path: Path) -> None:
    """So that it is there, too, where the computer or the program stops without a word."""
    out, seen = tmp_path / "live.jsonl", threading.Event()
    out.write_text("of an earlier watch\n")

    def send(listener: socket.socket) -> None:
        connection, _ = listener.accept()
        with connection:
            for frame in range(round(RATE_HZ)):
                for message in room.messages(1e9 + frame / RATE_HZ):
                    connection.sendall(message)
            for _ in range(15):
                if "status" in out.read_text():
                    seen.set()
                time.sleep(0.1)

    watched(room, tmp_path, send, "--seconds=30")
    assert seen.is_set()
    assert statuses(out) == ["valid", "unseen"]


def test_a_tool_that_is_repeated_under_new_times_is_not_seen(
    room: LiveRoom, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A sender goes on with what it last heard of a tracker that stopped, while the base is moved."""
    monkeypatch.setattr(openigtlink, "SILENCE_S", 0.2)

    def send(listener: socket.socket) -> None:
        connection, _ = listener.accept()
        tool = room.tool()
        with connection:
            for frame in range(round(2 * RATE_HZ)):
                head, _, robot = room.messages(1e9 + frame / RATE_HZ)
                repeated = pyigtl.TransformMessage(
                    tool, device_name="tool", timestamp=1e9 + frame / RATE_HZ
                ).pack()
                connection.sendall(head + repeated + robot)
                time.sleep(0.012)

    _, out = watched(room, tmp_path, send, "--seconds=30")
    *told, _ = (json.loads(line)["status"] for line in out.read_text().splitlines())  # but for the stream's end
    assert (told[0], told[-1]) == ("valid", "unseen")


def test_no_pose_is_valid_once_the_stream_falls_behind(
    room: LiveRoom, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A slow sender's queue grows: what it tells is over by more and more, and the head may have moved since."""
    monkeypatch.setattr(openigtlink, "SILENCE_S", 1.2)
    lines = tmp_path / "live.jsonl"

    def send(listener: socket.socket) -> None:
        connection, _ = listener.accept()
        with connection:
            stated_s = 1e9
            while not (lines.exists() and lines.read_text()):  # a crowded machine may take seconds to look
                stated_s += 0.5  # sooner than it says, so that none of these is late
                for message in room.messages(stated_s):
                    connection.sendall(message)
                time.sleep(1.0 / RATE_HZ)
            for _ in range(20):
                stated_s += 1.0 / RATE_HZ
                for message in room.messages(stated_s):
                    connection.sendall(message)
                time.sleep(3.0 / RATE_HZ)

    _, out = watched(room, tmp_path, send, "--every=0.1", "--seconds=30")
    rows = [json.loads(line) for line in out.read_text().splitlines()]
    assert statuses(out) == ["valid", "unseen"]
    assert "readings say 'late: it took longer" in rows[-2]["why"]


@pytest.mark.parametrize(
    ("again_s", "frames", "called", "is_valid_again"),
    [(-3.0, 20, b"skin", True), (0.5, 4, b"head", False)],
    ids=["its clock set back, its devices called otherwise", "it goes on from a queue, 0.4 s late"],
)
def test_a_server_that_was_restarted_is_joined_again_and_nothing_is_valid_meanwhile(
    room: LiveRoom,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    again_s: float,
    frames: int,
    called: bytes,
    is_valid_again: bool,
) -> None:
    """What it had kept while nobody was connected is over: it is no more valid than it was before the line dropped."""
    monkeypatch.setattr(openigtlink, "SILENCE_S", 0.2)
    monkeypatch.setattr(openigtlink, "PAUSE_S", 0.05)

    def send(listener: socket.socket) -> None:
        for start_s, count, name in ((1e9, 20, b"head"), (1e9 + again_s, frames, called)):
            connection, _ = listener.accept()
            with connection:
                for frame in range(count):
                    for message in room.messages(start_s + frame / RATE_HZ):
                        connection.sendall(message.replace(b"head", name))

    _, out = watched(room, tmp_path, send, "--rejoin=0.3", "--seconds=30", "--every=0.1")
    rows = [json.loads(line) for line in out.read_text().splitlines()]
    dropped = next(n for n, row in enumerate(rows) if "the server closed the stream" in row["why"])
    before, after = ([row["status"] for row in part] for part in (rows[:dropped], rows[dropped:]))
    assert "valid" in before
    assert after[0] == after[-1] == "unseen"
    assert ("valid" in after) == is_valid_again


@pytest.mark.parametrize(
    ("named", "told", "why"),
    [
        (None, ["unseen"], "several devices show the head's markers (copy, head)"),
        ("head", ["valid", "head_moved", "unseen"], "the head moved"),
        ("had", ["unseen"], "no points come from the device had, but from copy, head"),
    ],
)
def test_of_two_devices_that_show_the_head_none_counts_unless_it_is_named(
    room: LiveRoom,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    named: str | None,
    told: list[str],
    why: str,
) -> None:
    """The head moves, further than it is followed in one step, and what comes last shows it where it was."""
    leapt = placed(Rotation.identity(), np.array([30.0, 0, 0]))

    def send(listener: socket.socket) -> None:
        connection, _ = listener.accept()
        with connection:
            for frame in range(round(3 * RATE_HZ)):
                time_s = 1e9 + frame / RATE_HZ
                moved = (np.eye(4), TURN, leapt)[int(frame / RATE_HZ)]
                for message in replace(room, head_moved=moved).messages(time_s):
                    connection.sendall(message)
                copy = pyigtl.PointMessage(positions=room.head_mm(), device_name="copy", timestamp=time_s)
                connection.sendall(copy.pack())

    options = [] if named is None else [f"--head-device={named}"]
    _, out = watched(room, tmp_path, send, *options)
    assert statuses(out) == told
    assert why in capsys.readouterr().err
    first = json.loads(out.read_text().splitlines()[0])
    assert (why in first["why"]) == (told[0] == "unseen")


def test_an_error_of_poses_that_are_not_read_is_wrong_usage(capsys: pytest.CaptureFixture[str]) -> None:
    named = [f"--{name}=x.json" for name in ("chain", "registration", "geometry")]
    assert main(["robot", "watch", *named, "--sigma-robot-deg=1"]) == 2
    assert "--sigma-robot-deg is of the poses of --robot-device; name that, too" in capsys.readouterr().err


def test_what_ends_a_service_keeps_what_was_watched_as_ctrl_c_does(room: LiveRoom, tmp_path: Path) -> None:
    heeded = []
    signal.signal(signal.SIGTERM, signal.SIG_DFL)  # pyigtl's server, in other tests, leaves its own there

    def send(listener: socket.socket) -> None:
        connection, _ = listener.accept()
        with connection:
            heeded.append(signal.getsignal(signal.SIGTERM))

    watched(room, tmp_path, send)
    assert heeded == [signal.default_int_handler]
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL


def test_a_place_that_cannot_be_written_is_told_before_anything_is_watched(
    room: LiveRoom, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Else it is told when the time is up, and the lines of an hour are lost."""
    write_documents(live(room), room, tmp_path)
    told = [f"--{name}={tmp_path / name}.json" for name in ("chain", "registration")]
    told += [f"--geometry={tmp_path / 'tool.json'}", "--port=1", f"--output={tmp_path / 'none' / 'live.jsonl'}"]
    assert main(["robot", "watch", *told]) == 1
    assert f"the folder {tmp_path / 'none'} does not exist" in capsys.readouterr().err


@pytest.mark.parametrize(("changes", "status"), [({}, 0), ({"base_moved": TURN}, 3)])
def test_what_was_told_last_stands_where_the_time_was_up_before_the_stream(
    room: LiveRoom, tmp_path: Path, changes: dict[str, FloatArray], status: int
) -> None:
    over = threading.Event()
    now = replace(room, **changes)  # type: ignore[arg-type]
    assert watched(room, tmp_path, lambda listener: stall(listener, now, over), "--seconds=1")[0] == status
    over.set()


def test_a_stream_that_falls_silent_ends_without_a_pose(
    room: LiveRoom, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The server stays connected, but sends no more: the last valid pose does not stand."""
    monkeypatch.setattr(openigtlink, "SILENCE_S", 0.3)
    over = threading.Event()
    status, out = watched(room, tmp_path, lambda listener: stall(listener, room, over), "--seconds=30")
    over.set()
    assert (status, statuses(out)) == (3, ["valid", "unseen"])


def stall(listener: socket.socket, room: LiveRoom, over: threading.Event) -> None:
    """Send a second of a room at once, and then nothing."""
    connection, _ = listener.accept()
    with connection:
        for frame in range(round(RATE_HZ)):
            for message in room.messages(1e9 + frame / RATE_HZ):
                connection.sendall(message)
        over.wait(120)
