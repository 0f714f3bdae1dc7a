"""``ronnaplan track`` as a person uses it: it ends when told to, and keeps what it has."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest

from ronnaplan.cli import main, parse
from ronnaplan.documents.reading import to_json
from ronnaplan.tracking import read_recording
from ronnaplan.tracking.openigtlink import DEFAULT_PORT
from tests.documents.registrations import refused, registered
from tests.long import few_and_others
from tests.tracking.files import AWAY
from tests.tracking.test_openigtlink import points, pose, server

ROOT = Path(__file__).resolve().parents[2]
POSIX = pytest.mark.skipif(sys.platform == "win32", reason="Ctrl-C is sent to a process otherwise")


def started(port: int, out: Path) -> subprocess.Popen[str]:
    call = [sys.executable, "-m", "ronnaplan", "track", "--port", str(port), "--seconds", "600", "-o", str(out)]
    # A shell that runs tests in the background has them, and their children, ignore Ctrl-C; nohup a lost terminal.
    return subprocess.Popen(call, cwd=ROOT, text=True, stderr=subprocess.PIPE, preexec_fn=heed_all)


def heed_all() -> None:
    for each in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(each, signal.SIG_DFL)


@POSIX
@few_and_others("ends", ["SIGINT"], ["SIGTERM", "SIGHUP"])
def test_ctrl_c_and_the_like_end_a_recording_and_keep_it(tmp_path: Path, ends: str) -> None:
    """SIGTERM is what `timeout` and a service's end send, SIGHUP a lost terminal."""
    for seconds in (2.0, 10.0, 30.0):  # for the message to be read: the machine may be busy
        with socket.create_server(("127.0.0.1", 0)) as listener:
            process = started(listener.getsockname()[1], tmp_path / "readings.csv")
            connection, _ = listener.accept()
            with connection:
                for _ in range(int(seconds / 0.5)):  # a stream that is silent for long ends by itself
                    connection.sendall(points())
                    time.sleep(0.5)
                process.send_signal(getattr(signal, ends))
                _, told = process.communicate(timeout=60)
        if process.returncode == 0:
            break
    assert process.returncode == 0, told
    assert "stopped by hand after" in told
    assert len(read_recording(tmp_path / "readings.csv").points) >= 2


def test_a_place_that_cannot_be_written_is_told_before_anything_is_recorded(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["track", "--port", "1", "-o", str(tmp_path / "none" / "readings.csv")]) == 1
    assert f"the folder {tmp_path / 'none'} does not exist" in capsys.readouterr().err


@POSIX
def test_ctrl_c_before_anything_came_leaves_nothing(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        process = started(listener.getsockname()[1], tmp_path / "readings.csv")
        connection, _ = listener.accept()
        with connection:
            time.sleep(0.5)
            process.send_signal(signal.SIGINT)
            _, told = process.communicate(timeout=60)
    assert process.returncode == 130, told
    assert told.count("\n") == 1
    assert not (tmp_path / "readings.csv").exists()


def test_thousands_of_names_are_told_in_a_few_lines(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    many = b"".join(points([[k, 0, 0], [0, k, 50.0]], device=f"D{k}")[:-5] + b"\xff" * 5 for k in range(1, 200))
    with server([many + points()], hold=False) as port:
        assert main(["track", "--port", str(port), "--seconds", "5", "-o", str(tmp_path / "r.csv")]) == 0
    told = capsys.readouterr().err
    assert told.count("\n") < 60
    assert "more messages were left out" in told


def test_a_registration_that_was_refused_is_told_before_anything_is_recorded(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "registration.json").write_text(to_json(refused()))
    call = ["track", "--port", "1", "--registration", str(tmp_path / "registration.json")]
    assert main(call) == 1
    assert "this registration was refused" in capsys.readouterr().err


def test_a_stream_of_tools_alone_is_told_to_show_none_of_the_registered_markers(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "registration.json").write_text(to_json(registered()))
    with server([pose(AWAY)], hold=False) as port:
        call = ["track", "--port", str(port), "--registration", str(tmp_path / "registration.json")]
        assert main([*call, "-o", str(tmp_path / "r.csv")]) == 0
    assert "only poses of tools came (ProbeToTracker), and no points" in capsys.readouterr().err


def test_the_port_that_is_listened_at_is_that_of_the_library() -> None:
    assert parse(["track"]).port == DEFAULT_PORT
