"""The files that start the node as a service and in a container say what systemd and the program understand."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from ronnaplan.cli import parse

SERVICE, CONTAINER = Path("deploy/ronnaplan-node.service"), Path("deploy/Containerfile")


def test_the_service_starts_a_command_that_there_is() -> None:
    (command,) = re.findall(r"^ExecStart=\S*/ronnaplan (.+)$", SERVICE.read_text(), re.MULTILINE)
    assert parse(command.split()).config == "/etc/ronnaplan/node.toml"


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd is not installed")
def test_systemd_finds_no_fault_with_the_service(tmp_path: Path) -> None:
    unit = tmp_path / SERVICE.name
    unit.write_text(SERVICE.read_text().replace("/opt/ronnaplan/bin/ronnaplan", "/bin/true"))
    done = subprocess.run(["systemd-analyze", "verify", str(unit)], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


def test_the_container_is_made_of_what_there_is_and_runs_as_no_root() -> None:
    steps = [line.split(maxsplit=1) for line in CONTAINER.read_text().splitlines() if re.match("[A-Z]+ ", line)]
    for name, rest in steps:
        if name == "COPY" and "--from" not in rest:
            assert all(Path(source).exists() for source in rest.split()[:-1])
    said = dict(steps)  # the last of each
    assert int(said["USER"]) > 0
    assert parse(json.loads(said["ENTRYPOINT"])[1:] + json.loads(said["CMD"])).config == "/data/node.toml"
