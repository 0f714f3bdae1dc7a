"""A report is drawn when the answer is refused, too: that is when people want to look."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import SimpleITK as sitk

from ronnaplan.cli import main
from ronnaplan.cli.prepare import made_scan


def test_a_refused_template_leaves_a_report(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scan, sheet, template = tmp_path / "scan.nii", tmp_path / "sheet.png", tmp_path / "template.json"
    sitk.WriteImage(made_scan().to_sitk(), scan)
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
