"""A report is drawn when the answer is refused, too: that is when people want to look."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import SimpleITK as sitk
from PIL import Image

from ronnaplan.cli import main
from ronnaplan.cli.prepare import made_scans
from ronnaplan.ct import CTVolume


def test_a_refused_template_leaves_a_report(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scan, sheet, template = tmp_path / "scan.nii", tmp_path / "sheet.png", tmp_path / "template.json"
    sitk.WriteImage(made_scans()[1].to_sitk(), scan)
    frame = {
        "format": "ronnaplan.template",
        "version": 1,
        "unit": "mm",
        "name": "other",
        "labels": ["a", "b", "c"],
    }
    template.write_text(json.dumps({**frame, "distances": [[0, 33, 47], [33, 0, 21], [47, 21, 0]]}))
    call = ["localize", str(scan), "--diameter", "11.5", "--template", str(template), "--report", str(sheet)]
    assert main([*call, "-o", str(tmp_path / "fiducials.json")]) == 3
    assert sheet.read_bytes().startswith(b"\x89PNG")
    assert not (tmp_path / "fiducials.json").exists()
    assert "other" in capsys.readouterr().err


@pytest.mark.parametrize(("balls", "said"), [(2, "no 3 balls of one size"), (0, "no sphere of")])
def test_a_scan_without_a_common_diameter_leaves_a_report(
    balls: int, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scan, sheet, out = tmp_path / "scan.nii", tmp_path / "sheet.png", tmp_path / "fiducials.json"
    sitk.WriteImage(scan_of(balls).to_sitk(), scan)
    assert main(["localize", str(scan), "--diameter", "auto", "--report", str(sheet), "-o", str(out)]) == 3
    assert said in capsys.readouterr().err
    assert not out.exists()
    with Image.open(sheet) as drawn:
        assert drawn.height > 171 * max(balls, 1)  # a row each, or one that says that there is none


def scan_of(balls: int) -> CTVolume:
    """Return air with a few solid balls of 8 mm."""
    voxels = np.full((48, 48, 48), -1000.0)
    z, y, x = np.indices(voxels.shape)
    for middle in (12, 34)[:balls]:
        away = np.sqrt((x - middle) ** 2 + (y - 24) ** 2 + (z - 24) ** 2)
        voxels += 2000.0 * np.clip(4.5 - away, 0.0, 1.0)
    return CTVolume.from_array(voxels.astype(np.int16), np.eye(4))
