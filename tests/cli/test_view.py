"""``ronnaplan view`` finds its scan, names nobody unless asked to, and refuses what it cannot open."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pytest

from ronnaplan.cli import main
from ronnaplan.cli.view import _address
from ronnaplan.ct.slices import Instance
from ronnaplan.errors import UsageError
from ronnaplan.planner import server
from ronnaplan.planner.state import PlannerState
from tests import cases


def test_what_cannot_be_opened_is_told_in_a_sentence(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["view", str(tmp_path / "nowhere"), "--plan", str(tmp_path / "plan.json")]) == 1
    assert main(["view", str(cases.CT), "--plan", str(tmp_path / "no" / "plan.json")]) == 1
    assert main(["view", str(cases.CT), "--tracker", "here"]) == 2
    assert main(["view", str(cases.CT), "--plan", str(tmp_path / "plan.json"), "--host", "0.0.0.0"]) == 2
    (tmp_path / "plan.json").write_text("{}")
    assert main(["view", str(cases.CT), "--plan", str(tmp_path / "plan.json")]) == 1
    assert len(capsys.readouterr().err.splitlines()) == 5
    assert (tmp_path / "plan.json").read_text() == "{}"


@pytest.mark.parametrize(
    ("given", "told"),
    [
        (["CT", "--plan", "p.json", "--root", "."], "CT and --plan belong to one case; leave out --root"),
        (["--plan", "p.json", "--root", "."], "--plan belongs to one case; leave out --root"),
        (["--second", "mr.nii"], "--second belongs to one case; name its scan, too: ronnaplan view CT"),
    ],
)
def test_what_belongs_to_one_case_is_refused_at_the_start_page(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    given: list[str],
    told: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["view", *(str(cases.CT) if one == "CT" else one for one in given)]) == 2
    assert told in capsys.readouterr().err


def test_a_root_that_is_no_folder_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The start page said of it that it is no place below the root."""
    monkeypatch.setattr("ronnaplan.cli.view._Planner.serve_any", lambda *given: None)
    (tmp_path / "plan.json").write_text("{}")
    for name in ("nowhere", "plan.json"):
        assert main(["view", "--root", str(tmp_path / name)]) == 1
        assert f"{name} is no folder" in capsys.readouterr().err


def test_a_trackers_address_is_host_and_port() -> None:
    assert _address("localhost:18944") == ("localhost", 18944)
    for bad in ("localhost", ":1", "h:0", "h:99999", "h:x"):
        with pytest.raises(UsageError, match="HOST:PORT"):
            _address(bad)


@pytest.fixture
def served(monkeypatch: pytest.MonkeyPatch) -> list[tuple[PlannerState, dict[str, Any]]]:
    """What would have been served."""
    calls: list[tuple[PlannerState, dict[str, Any]]] = []
    monkeypatch.setattr(server, "serve", lambda state, **options: calls.append((state, options)))
    return calls


def test_the_scan_of_the_case_is_found_beside_the_plan(
    tmp_path: Path, served: list[tuple[PlannerState, dict[str, Any]]], monkeypatch: pytest.MonkeyPatch
) -> None:
    cases.write_case(tmp_path)
    (tmp_path / "ct").symlink_to(cases.CT)
    assert main(["view", "--plan", str(tmp_path / "plan.json")]) == 0
    monkeypatch.chdir(tmp_path)
    assert main(["view"]) == 0
    flat = tmp_path / "flat"
    shutil.copytree(cases.CT, flat)
    assert main(["view", "--plan", str(flat / "plan.json")]) == 0
    assert [state.case.volume.voxel_sha256 for state, _ in served] == 3 * [cases.volume().voxel_sha256]
    assert [len(state.case.plan.trajectories) for state, _ in served] == [1, 1, 0]


def test_without_a_scan_one_sentence_says_what_to_give(
    tmp_path: Path, served: list[tuple[PlannerState, dict[str, Any]]], capsys: pytest.CaptureFixture[str]
) -> None:
    cases.write_case(tmp_path)
    assert main(["view", "--plan", str(tmp_path / "plan.json")]) == 2
    assert main(["view", "--plan", str(tmp_path / "nowhere" / "plan.json")]) == 1
    told = capsys.readouterr().err.splitlines()
    assert len(told) == 2
    assert told[0].endswith("or beside plan.json; name one: ronnaplan view CT")
    assert served == []


def test_the_patients_name_is_read_only_when_asked_for(
    tmp_path: Path, served: list[tuple[PlannerState, dict[str, Any]]], monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = str(tmp_path / "plan.json")
    assert main(["view", str(cases.CT), "--plan", plan, "--patient"]) == 0
    assert served[0][1]["patient"] == "PHANTOM^SYNTHETIC"
    monkeypatch.setattr(Instance, "patient_name", property(lambda _: pytest.fail("the patient's name was read")))
    assert main(["view", str(cases.CT), "--plan", plan]) == 0
    assert served[1][1]["patient"] is None
    assert all(b"SYNTHETIC" not in path.read_bytes().upper() for path in tmp_path.iterdir())
