"""The node as a program: receives, survives its receiver's death, and nothing outlives it."""

from __future__ import annotations

import io
import json
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

from ronnaplan.cli import main
from ronnaplan.node.hub import run_node
from ronnaplan.node.index import Index
from ronnaplan.node.logs import Log
from tests.ct import makers
from tests.node.peers import free_port, needs, save, send, until, write_toml


@needs("storescu")
def test_a_node_receives_through_its_receiver_s_death_and_ends_whole(tmp_path: Path) -> None:
    port = free_port()
    config = write_toml(tmp_path, port)
    log = tmp_path / "log"
    with log.open("w") as stream:
        node = subprocess.Popen(
            [sys.executable, "-m", "ronnaplan", "node", "--config", str(config)], stderr=stream
        )

    def events(kind: str) -> list[dict[str, object]]:
        return [one for one in map(json.loads, log.read_text().splitlines()) if one["event"] == kind]

    try:
        until(lambda: events("listening"))
        assert main(["node", "--config", str(config)]) == 1  # another one has the folder
        assert "(Success)" in send(port, save(makers.dataset(0), tmp_path / "0.dcm"))
        until(lambda: events("complete"))
        (receiver,) = (tmp_path / "node-data").glob("receiver.pid")
        os.kill(int(receiver.read_text()), signal.SIGTERM)
        until(lambda: len(events("listening")) == 2)
        assert "(Success)" in send(port, save(makers.dataset(1), tmp_path / "1.dcm"))
        until(lambda: len(events("complete")) == 2)
    finally:
        node.terminate()
        assert node.wait(120) == 0
    assert events("stopped")
    with Index(tmp_path / "node-data") as index:
        assert index.rows("SELECT instances, revision, complete FROM series") == [(2, 2, 2)]


def test_a_template_that_is_not_there_is_told_at_the_start(tmp_path: Path) -> None:
    path = tmp_path / "node.toml"
    path.write_text(
        "[[rule]]\nname = 'frame'\ntemplate = 'frame.json'\n[[rule]]\nname = 'here'\ntemplate = 'node.toml'\n"
    )
    stop, told = threading.Event(), io.StringIO()
    stop.set()
    run_node(path, stop, Log(told))
    lines = [json.loads(line) for line in told.getvalue().splitlines()]
    missing = [(one["rule"], one["file"]) for one in lines if one["event"] == "no template"]
    assert missing == [("frame", str(tmp_path / "frame.json"))]
