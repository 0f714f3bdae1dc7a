"""What an archive has comes whole, by DIMSE and by DICOMweb."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from ronnaplan.cli import main
from ronnaplan.ct import read_ct
from ronnaplan.errors import UsageError
from ronnaplan.node.config import Config
from ronnaplan.node.pull import Wanted, peer_at, pull
from tests.ct import makers
from tests.node.peers import Orthanc, free_port

STUDY = "1.2.3.500"


@pytest.fixture
def archive(orthanc: Orthanc, tmp_path: Path) -> Orthanc:
    def named(made: object, _: int) -> None:
        made.StudyInstanceUID, made.PatientID = STUDY, "PULLED"  # type: ignore[attr-defined]

    for path in makers.write_series(tmp_path / "sent", change=named).iterdir():
        orthanc.post("/instances", path.read_bytes())
    return orthanc


@pytest.mark.parametrize("way", ["dimse", "web"])
def test_a_study_is_fetched_whole(way: str, archive: Orthanc, tmp_path: Path) -> None:
    address = (
        f"ORTHANC@127.0.0.1:{archive.port}" if way == "dimse" else f"http://127.0.0.1:{archive.http}/dicom-web"
    )
    out = tmp_path / "out"
    assert main(["pull", "--from", address, "--patient", "PULLED", "-o", str(out)]) == 0
    assert read_ct(out).voxel_sha256 == read_ct(tmp_path / "sent").voxel_sha256
    assert main(["pull", "--from", address, "--study", "1.2.3.404", "-o", str(out)]) == 1


def test_what_says_too_little_is_wrong_usage(tmp_path: Path) -> None:
    for text in ("pacs", "A@b", "A@b:0", "A@b:70000"):
        with pytest.raises(UsageError, match="is no peer"):
            peer_at(text, Config())
    with pytest.raises(UsageError, match="nothing says which study"):
        pull(Config(), peer_at("A@127.0.0.1:1", Config()), Wanted(), tmp_path)


def test_an_archive_that_is_not_there_is_told(tmp_path: Path) -> None:
    # in a process of its own: pynetdicom leaves the socket open that could not be connected
    command = [sys.executable, "-m", "ronnaplan", "pull", "--from", f"A@127.0.0.1:{free_port()}", "--study", "1.2"]
    done = subprocess.run([*command, "-o", str(tmp_path / "x")], capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "cannot be reached" in done.stderr
