"""The simulated sessions are asked for on the command line, and say what is wrong with what they were given."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest

from phantoms import live_room, robot_session

CASE = str(Path(__file__).resolve().parents[2] / "data" / "synthetic_ct")


@pytest.mark.parametrize(
    ("serves", "arguments", "said"),
    [
        (robot_session, ["nowhere", "session"], "nowhere holds no readings_truth.json"),
        (robot_session, [CASE, "."], ". is there already; name a new folder"),
        (robot_session, [CASE], "required: SESSION"),
        (live_room, ["nowhere", "18944"], "nowhere holds no readings_truth.json"),
        (live_room, [CASE, "igtl"], "invalid int value: 'igtl'"),
    ],
)
def test_what_cannot_be_used_is_said_in_a_sentence(
    serves: object,
    arguments: list[str],
    said: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as ended:
        serves.main(arguments)  # type: ignore[attr-defined]
    assert ended.value.code == 2
    assert said in capsys.readouterr().err


def test_a_listener_that_leaves_ends_the_session() -> None:
    room = live_room.LiveRoom.of_case(Path(CASE))
    with socket.create_server(("127.0.0.1", 0)) as listener:
        socket.create_connection(listener.getsockname()).close()
        live_room.serve(listener, [(room, 600.0)], in_real_time=False)
