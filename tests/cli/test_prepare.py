"""What is slow at a first start is done beforehand, and what a verb does not need is not imported."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import pytest
import SimpleITK as sitk

from tests.cli.calls import run

ROOT = Path(__file__).resolve().parents[2]
STEPS = """
import json, sys
from ronnaplan.cli import main

def compiled():
    found = {}
    for name, module in sorted(sys.modules.items()):
        for one in vars(module).values() if name.startswith("ronnaplan") else ():
            if hasattr(one, "py_func"):
                found[one.py_func.__module__ + "." + one.py_func.__name__] = sorted(map(str, one.signatures))
    return found

for name, step in json.loads(sys.argv[1]).items():
    status = main(step) if isinstance(step, list) else exec(step)
    loaded = sorted({one.split(".")[0] for one in sys.modules})
    print(json.dumps([name, status, compiled(), loaded]))
"""
LAID_OUT = """
from ronnaplan.correspondence import describe_layout
assert describe_layout([[0, 0, 0], [50, 0, 0], [50, 51, 0], [0, 50, 0]]).refusal_probability() > 0.5
"""
PAIRED = """
from ronnaplan.correspondence import match_points
from tests.correspondence.scenes import HEAD, bodies
match_points(HEAD[:5], HEAD[:5])
for seed, (counts, outliers) in enumerate([((12,), 8), ((20, 20), 0), ((40,), 60)]):
    ct, ots, _ = bodies(seed, counts, [60.0, 40.0][: len(counts)], outliers, 90.0)
    for given in ({}, {"expected": counts[0]}, {"known_pairs": [(0, 0)]}):
        match_points(ct, ots, **given)
    match_points(ct, ots * [1, 1, -1])
    match_points(ct * [1, 0.02, 0.02], ots)
    match_points(ots, ct, sigma_ct_mm=0.3)
"""
PLACED = """
from ronnaplan.robot.placement.blocking import at_reference
from ronnaplan.robot.placement.placement import COARSE, find_places
from ronnaplan.robot.placement.room import Floor
from ronnaplan.robot.placement.serving import served_by_each
from tests.robot.placement.cases import job
given = job(1, 2, 1, floor=Floor((-800.0, -650.0), (-600.0, -500.0), (850.0, 900.0)))
place = find_places(given).places[0]
problem = given.problem(COARSE)
assert next(served_by_each(problem, given.tasks[0], 0, place.room_from_r))
assert at_reference(given, problem, place.room_from_r, place.route.reference_deg) is None
"""
SEEN = """
import numpy as np
from phantoms.cameras import sphere_image
from ronnaplan.robot.stereo.camera import Camera
from ronnaplan.robot.stereo.outline import find_outlines
from ronnaplan.robot.stereo.response import noise_beside
matrix = np.array([[4200.0, 0, 650], [0, 4195, 500], [0, 0, 1]])
image = sphere_image([np.array([1.0, 2.0, 300.0])], 11.5, matrix, np.zeros(5), np.random.default_rng(0))
camera = Camera(matrix, np.zeros(5), np.eye(4))
(outline,) = find_outlines(image, camera)
assert noise_beside(image, *outline.in_image(camera)) > 0.0
"""


class Step(NamedTuple):
    """Its exit status, if it was a command, and what is compiled and imported at its end."""

    status: int | None
    compiled: dict[str, list[str]]
    """Kernel -> types of its arguments."""
    imported: list[str]


@pytest.fixture(scope="module")
def steps(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Step]:
    """The parts of `ronnaplan prepare`, and what follows in the same process."""
    folder = tmp_path_factory.mktemp("prepared")
    found, fractions = str(folder / "fiducials.json"), str(folder / "fractions.nrrd")
    scan = sitk.ReadImage([str(path) for path in sorted((ROOT / "data/synthetic_ct").glob("*.dcm"))])
    sitk.WriteImage(sitk.Cast(scan, sitk.sitkFloat32)[:, :, 55:95] + 0.25, fractions)  # four of the markers
    asked = {
        "prepare": "from ronnaplan.cli.prepare import PARTS\nfor part in PARTS: part()",
        "localize": ["localize", "data/synthetic_ct", "--diameter", "auto", "-o", found],
        "register": ["register", found, "data/synthetic_ct/readings.csv", "-o", str(folder / "registration.json")],
        "fractions": ["localize", fractions, "--diameter", "auto", "-o", str(folder / "fractions.json")],
        **{"layout": LAID_OUT, "pair many": PAIRED, "place": PLACED, "see": SEEN},
    }
    done = subprocess.run(
        [sys.executable, "-c", STEPS, json.dumps(asked)], cwd=ROOT, capture_output=True, text=True, check=True
    )
    return {name: Step(*told) for name, *told in map(json.loads, done.stdout.splitlines())}


def compiled_by(steps: dict[str, Step], name: str) -> dict[str, list[str]]:
    """What is compiled at the end of a step that was not prepared, or for other values."""
    prepared = steps["prepare"].compiled
    return {kernel: kinds for kernel, kinds in steps[name].compiled.items() if kinds != prepared.get(kernel, [])}


def test_after_prepare_localize_and_register_compile_nothing_and_import_little(steps: dict[str, Step]) -> None:
    """Of whatever size the markers are, in fractions of HU, too, and however alike the orders that they fit in."""
    assert [steps[name].status for name in ("localize", "register", "fractions")] == [0, 0, 0]
    assert sum(map(len, steps["prepare"].compiled.values())) > 10
    for name in ("localize", "register", "fractions", "layout"):
        assert compiled_by(steps, name) == {}
    heavy = {"pydicom", "gdcm", "requests", "matplotlib", "SimpleITK", "skimage", "pandas", "pyvista", "trame"}
    assert not heavy & set(steps["localize"].imported)


@pytest.mark.parametrize(
    ("name", "kernel"),
    [
        ("pair many", "correspondence.seeds.poses_of_seeds"),  # the first of more than 16 points compiled for 20 s
        ("place", "judge_base"),
        ("see", "robot.stereo.shading_compiled.equations"),
    ],
)
def test_after_prepare_many_markers_a_place_and_a_sphere_are_found_without_compiling(
    steps: dict[str, Step], name: str, kernel: str
) -> None:
    assert compiled_by(steps, name) == {}
    assert any(kernel in one and kinds for one, kinds in steps["prepare"].compiled.items())


def mark_as_done() -> None:
    Path("done").touch()


def be_killed() -> None:
    os._exit(9)


def test_every_part_is_done_and_one_that_is_killed_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("ronnaplan.cli.prepare.PARTS", (mark_as_done,))
    status, _, told = run(["prepare"], capsys)
    assert (status, Path("done").exists()) == (0, True)
    assert "done" in told
    Path("done").unlink()
    monkeypatch.setattr("ronnaplan.cli.prepare.PARTS", (be_killed, mark_as_done))
    status, _, told = run(["prepare"], capsys)
    assert (status, Path("done").exists()) == (1, True)
    assert "(be_killed)" in told


def test_what_cannot_be_kept_is_not_prepared(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("kernelcache.homeless", ["a kernel"])
    status, _, told = run(["prepare"], capsys)
    assert (status, told.count("\n")) == (1, 1)
    assert "NUMBA_CACHE_DIR" in told
