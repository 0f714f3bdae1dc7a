"""napari's reader, without napari: what it takes, and where the markers lie."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml

import ronnaplan
from ronnaplan import Plan, Trajectory
from ronnaplan.ct.volume import SeriesSource
from ronnaplan.documents.fiducials import fiducials_document
from ronnaplan.documents.plan import write_plan
from ronnaplan.documents.reading import to_json
from ronnaplan.napari import get_reader
from tests.test_display import POINTS, some_fiducials


def test_markers_and_trajectories_become_layers_in_napari_order(tmp_path: Path) -> None:
    markers, plan = tmp_path / "fiducials.json", tmp_path / "plan.json"
    markers.write_text(to_json(fiducials_document(some_fiducials())))
    write_plan(plan, Plan(SeriesSource()).add(Trajectory("left", POINTS[0], POINTS[1])))
    read = get_reader([str(markers), str(plan)])
    assert read is not None
    (places, told, kind), (lines, paths, shape) = read([str(markers), str(plan)])
    assert (kind, shape) == ("points", "shapes")
    np.testing.assert_allclose(places, POINTS[:, [2, 1, 0]])
    np.testing.assert_allclose(told["features"]["error_mm"], np.sqrt(1e-4 + 4e-4 + 9e-4))
    np.testing.assert_allclose(lines[0], POINTS[:2, [2, 1, 0]])
    assert paths["features"]["name"] == ["left"]


@pytest.mark.parametrize("content", ["{}", "no json", '{"format": "other"}', "[]"])
def test_a_file_of_another_program_is_left_to_other_readers(tmp_path: Path, content: str) -> None:
    path = tmp_path / "some.json"
    path.write_text(content)
    assert get_reader(str(path)) is None
    assert get_reader(str(tmp_path / "scan.nii")) is None


def test_the_manifest_names_the_reader() -> None:
    manifest = yaml.safe_load((Path(ronnaplan.__file__).parent / "napari.yaml").read_text())
    (command,) = manifest["contributions"]["commands"]
    assert command["python_name"] == f"{get_reader.__module__}:{get_reader.__name__}"
    assert manifest["contributions"]["readers"][0]["command"] == command["id"]
