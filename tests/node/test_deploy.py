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


def steps_of(container: Path) -> list[list[str]]:
    return [line.split(maxsplit=1) for line in container.read_text().splitlines() if re.match("[A-Z]+ ", line)]


@pytest.mark.parametrize("container", [CONTAINER, Path("Containerfile")], ids=str)
def test_a_container_is_made_of_what_there_is_and_runs_as_no_root(container: Path) -> None:
    steps = steps_of(container)
    sources = [rest.split()[:-1] for name, rest in steps if name == "COPY" and "--from" not in rest]
    assert all(Path(source).exists() for each in sources for source in each)
    assert len(sources) > 1
    assert dict(steps)["USER"] not in ("0", "root")  # the last of each


def test_the_container_starts_the_node() -> None:
    said = dict(steps_of(CONTAINER))
    assert parse(json.loads(said["ENTRYPOINT"])[1:] + json.loads(said["CMD"])).config == "/data/node.toml"
