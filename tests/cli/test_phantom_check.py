"""``ronnaplan phantom-check`` keeps its contract on the committed scan, whose markers' places are known."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ronnaplan.cli import main
from ronnaplan.documents.phantom_check import read_known_phantom
from ronnaplan.errors import InputError
from tests.cohort.scans import phantom

SCAN = Path(__file__).parents[2] / "data" / "synthetic_ct"


def template(folder: Path, **changes: Any) -> str:
    """Write the committed scan's truth as a template."""
    markers = json.loads((SCAN / "truth.json").read_text())["markers"]
    centers = [one["center"] for one in markers]
    labels = [one["label"] for one in markers]
    content = {"format": "ronnaplan.template", "version": 1, "unit": "mm", "name": "demo"}
    path = folder / "truth.json"
    path.write_text(json.dumps({**content, "labels": labels, "centers": centers, **changes}))
    return str(path)


def distances() -> list[list[float]]:
    centers = np.array([one["center"] for one in json.loads((SCAN / "truth.json").read_text())["markers"]])
    apart = np.linalg.norm(centers[:, np.newaxis] - centers, axis=-1)
    found: list[list[float]] = ((apart + apart.T) / 2).tolist()
    return found


def test_a_scan_that_holds_what_it_states_passes_and_one_with_another_truth_does_not(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "check.json"
    truth = template(tmp_path, centers=[], distances=distances())
    assert main(["phantom-check", str(SCAN), "--truth", truth, "--diameter", "11.5", "-o", str(out)]) == 0
    printed = capsys.readouterr()
    assert printed.out == ""
    assert "passes" in printed.err
    assert "better: slice thickness" in printed.err
    (scan,) = json.loads(out.read_text())["scans"]
    assert scan["passed"]
    assert scan["worst_error_mm"] < 0.01
    assert {one["name"] for one in scan["stretches"]} == {"in_plane", "along", "shear_u", "shear_v"}

    centers = np.array([one["center"] for one in json.loads((SCAN / "truth.json").read_text())["markers"]])
    centers[2, 0] += 0.3
    wrong = template(tmp_path, centers=centers.tolist())
    arguments = [str(SCAN), str(tmp_path), "--truth", wrong, "--diameter", "11.5", "-o", str(out)]
    assert main(["phantom-check", *arguments]) == 3
    printed = capsys.readouterr()
    assert "times as large as stated" in printed.err
    assert "2 of 2 scans do not pass" in printed.err
    assert not json.loads(out.read_text())["scans"][0]["passed"]


def test_a_scan_is_not_compared_with_what_was_found_in_itself(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scan, truth, out = phantom(tmp_path / "scan"), tmp_path / "fiducials.json", tmp_path / "check.json"
    assert main(["localize", str(scan), "--diameter", "11.5", "-o", str(truth)]) == 0
    check = ["phantom-check", str(scan), "--truth", str(truth), "--diameter", "11.5", "-o", str(out)]
    for sigma in ([], ["--sigma-truth", "0.01"]):
        capsys.readouterr()
        assert main([*check, *sigma]) == 1
        assert "the truth 'fiducials.json' was found in this very scan" in capsys.readouterr().err
        assert not out.exists()

    document = json.loads(truth.read_text())
    document["source"]["voxel_sha256"] = "0" * 64  # some slices less, say: each center would be the same
    truth.write_text(json.dumps(document))
    assert main(check) == 1
    document["source"]["series_instance_uid"] = "1.2.3"
    truth.write_text(json.dumps(document))
    assert main(check) == 0


def test_a_truth_that_is_none_is_told_before_the_scan_is_read(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for changes, expected in (
        ({"centers": []}, "distances or centers are needed"),
        ({"distances": distances()}, "and not both"),
        ({"centers": [[0, 0, 0.0]] * 6}, "two markers are at the same place"),
        ({"centers": [[0, 0, 0.0]] * 5}, "5 centers for 6 labels"),
    ):
        truth = template(tmp_path, **changes)
        assert main(["phantom-check", "nowhere", "--truth", truth, "--diameter", "11.5"]) == 1
        assert expected in capsys.readouterr().err
    assert main(["phantom-check", "nowhere", "--truth", template(tmp_path), "--diameter", "11,5"]) == 2
    another = str(SCAN / "readings_truth.json")
    assert main(["phantom-check", "nowhere", "--truth", another, "--diameter", "11.5"]) == 1
    assert "is no template ('ronnaplan.template'), fiducials.json or truth.json" in capsys.readouterr().err


def test_the_truth_of_a_simulated_scan_is_one(tmp_path: Path) -> None:
    stated = json.loads((SCAN / "truth.json").read_text())
    phantom = read_known_phantom(SCAN / "truth.json", None)
    assert phantom.name == stated["scene"]
    assert phantom.has_hand
    assert dict(zip(phantom.labels, phantom.centers_mm.tolist(), strict=True)) == {
        one["label"]: one["center"] for one in stated["markers"]
    }
    first, *others = stated["markers"]
    for changes, expected in (
        ({"markers": [first | {"path": [[0, 1, 2, 3]]}, *others]}, "M1 moved during the scan"),
        ({"markers": [first | {"center": "here"}, *others]}, "centers"),
        ({"markers": 6}, "lists no markers"),
        ({"coordinate_system": "RAS"}, "is in RAS; expected LPS"),
        ({"version": 2}, "version"),
        ({"unit": "m"}, "unit"),
    ):
        (tmp_path / "truth.json").write_text(json.dumps(stated | changes))
        with pytest.raises(InputError, match=expected):
            read_known_phantom(tmp_path / "truth.json", None)
