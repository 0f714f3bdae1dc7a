"""What is slow at a first start is done beforehand, and what a verb does not need is not imported."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
import SimpleITK as sitk

from tests.cli.calls import run

ROOT = Path(__file__).resolve().parents[2]
COUNT = """
import json, sys
from ronnaplan.cli import main

def compiled():
    found = {}
    for name, module in sorted(sys.modules.items()):
        for one in vars(module).values() if name.startswith("ronnaplan") else ():
            if hasattr(one, "py_func"):
                found[one.py_func.__module__ + "." + one.py_func.__name__] = sorted(map(str, one.signatures))
    return found

told = []
for arguments in json.loads(sys.argv[1]):
    status = main(arguments)
    told.append([status, compiled(), sorted({name.split(".")[0] for name in sys.modules})])
print(json.dumps(told))
"""


def test_after_prepare_localize_and_register_compile_nothing_and_import_little(tmp_path: Path) -> None:
    """Of whatever size the markers are, in fractions of HU, too, and however alike the orders that they fit in."""
    found, fractions = str(tmp_path / "fiducials.json"), str(tmp_path / "fractions.nrrd")
    scan = sitk.ReadImage([str(path) for path in sorted((ROOT / "data/synthetic_ct").glob("*.dcm"))])
    sitk.WriteImage(sitk.Cast(scan, sitk.sitkFloat32)[:, :, 55:95] + 0.25, fractions)  # four of the markers
    commands = [
        ["prepare"],
        ["localize", "data/synthetic_ct", "--diameter", "auto", "-o", found],
        ["register", found, "data/synthetic_ct/readings.csv", "-o", str(tmp_path / "registration.json")],
        ["localize", fractions, "--diameter", "auto", "-o", str(tmp_path / "fractions.json")],
    ]
    done = subprocess.run(
        [sys.executable, "-c", COUNT + LAID_OUT, json.dumps(commands)],
        cwd=ROOT, capture_output=True, text=True, check=True,
    )  # fmt: skip
    (prepared, localized, registered, again), laid_out = map(json.loads, done.stdout.splitlines())
    assert [one[0] for one in (prepared, localized, registered, again)] == [0, 0, 0, 0]
    assert sum(map(len, prepared[1].values())) > 10
    for compiled in (localized[1], registered[1], again[1], laid_out):
        assert {name: kinds for name, kinds in compiled.items() if kinds != prepared[1].get(name, [])} == {}
    heavy = {"pydicom", "gdcm", "requests", "matplotlib", "SimpleITK", "skimage", "pandas", "pyvista", "trame"}
    assert not heavy & set(localized[2])


LAID_OUT = """
from ronnaplan.correspondence import describe_layout

assert describe_layout([[0, 0, 0], [50, 0, 0], [50, 51, 0], [0, 50, 0]]).refusal_probability() > 0.5
print(json.dumps(compiled()))
"""


def prepared_and_others(code: str) -> tuple[dict[str, list[str]], dict[str, list[str]]]:
    """What ``code`` tells as compiled before, by kernel, and what of it was compiled after, or for other values."""
    found = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    prepared, after = json.loads(found.stdout)
    return prepared, {name: kinds for name, kinds in after.items() if kinds != prepared.get(name, [])}


def test_after_prepare_any_number_of_markers_is_paired_without_compiling() -> None:
    """The first registration of more than 16 points compiled for 20 s."""
    prepared, others = prepared_and_others(PAIRED)
    assert others == {}
    assert prepared["ronnaplan.correspondence.seeds.poses_of_seeds"]


PAIRED = (
    COUNT.split("told = []")[0]
    + """
from ronnaplan.cli.prepare import pair_many
from ronnaplan.correspondence import match_points
from tests.correspondence.scenes import HEAD, bodies

match_points(HEAD[:5], HEAD[:5])
pair_many()
prepared = compiled()
for seed, (counts, outliers) in enumerate([((12,), 8), ((20, 20), 0), ((40,), 60)]):
    ct, ots, _ = bodies(seed, counts, [60.0, 40.0][: len(counts)], outliers, 90.0)
    for given in ({}, {"expected": counts[0]}, {"known_pairs": [(0, 0)]}):
        match_points(ct, ots * [1, 1, -1], **given)
        match_points(ct * [1, 0.02, 0.02], ots, **given)
        match_points(ct, ots, **given)
        match_points(ots, ct, sigma_ct_mm=0.3)
print(json.dumps([prepared, compiled()]))
"""
)


def test_after_prepare_a_place_for_the_robot_is_found_without_compiling() -> None:
    prepared, others = prepared_and_others(PLACED)
    assert others == {}
    assert any("judge_base" in name for name in prepared)


PLACED = (
    COUNT.split("told = []")[0]
    + """
from ronnaplan.cli.prepare import place_robot
from ronnaplan.robot.placement.placement import find_places
from ronnaplan.robot.placement.room import Floor
from tests.robot.placement.cases import job

place_robot()
prepared = compiled()
find_places(job(1, 2, 1, floor=Floor((-800.0, -650.0), (-600.0, -500.0), (850.0, 900.0))))
print(json.dumps([prepared, compiled()]))
"""
)


def test_after_prepare_a_sphere_before_cameras_is_found_without_compiling() -> None:
    prepared, others = prepared_and_others(SEEN)
    assert others == {}
    assert prepared["ronnaplan.robot.stereo.shading_compiled.equations"]


SEEN = (
    COUNT.split("told = []")[0]
    + """
import numpy as np
from phantoms.cameras import sphere_image
from ronnaplan.cli.prepare import see_sphere
from ronnaplan.robot.stereo.camera import Camera
from ronnaplan.robot.stereo.outline import find_outlines

see_sphere()
prepared = compiled()
matrix = np.array([[4200.0, 0, 650], [0, 4195, 500], [0, 0, 1]])
image = sphere_image([np.array([1.0, 2.0, 300.0])], 11.5, matrix, np.zeros(5), np.random.default_rng(0))
assert find_outlines(image, Camera(matrix, np.zeros(5), np.eye(4)))
print(json.dumps([prepared, compiled()]))
"""
)


def test_what_cannot_be_kept_is_not_prepared(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("kernelcache.homeless", ["a kernel"])
    status, _, told = run(["prepare"], capsys)
    assert (status, told.count("\n")) == (1, 1)
    assert "NUMBA_CACHE_DIR" in told
