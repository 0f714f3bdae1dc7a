from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks import phantom_measures
from phantoms.cone_beam import ConeBeam
from phantoms.errors import PhantomError
from phantoms.examination import Examination
from phantoms.helix import Helix
from phantoms.machine import Machine
from phantoms.motion import FORMS, Motion, random_motion
from phantoms.patients import random_patient
from phantoms.scanner import Scanner
from phantoms.scene import Decoy, Marker, Part, Scene
from phantoms.solids import FloatArray, sphere
from phantoms.stack import SliceStack, axial_stack
from tests.long import few_and_others

CENTER = np.array([21.3, -9.7, 4.2])
BALL = Scene(
    (Part(sphere(CENTER, 11.5), "acrylic"),),
    (Marker("M1", CENTER, 11.5, "acrylic"),),
    (Decoy("larger sphere", np.array([0.0, 0.0, 4.0])),),
)
STACK = axial_stack(start_mm=-6, stop_mm=14.5, spacing_mm=0.5, matrix=200, field_of_view_mm=100)
AXIAL = Scanner(dose=0.0, views=180).aimed(STACK)
CONE = ConeBeam(dose=0.0, views=120, bin_mm=0.5, width_mm=110.0).aimed(STACK)
HELIX = Helix(dose=0.0, views=240, rows=16, row_mm=0.75).aimed(STACK)
MOVED = Motion("jump", (0.4, -0.3, 0.5), (0.5, 0.2, -0.8), when=0.0)


def centroid(machine: Machine, scene: Scene = BALL, stack: SliceStack = STACK) -> FloatArray:
    """Return the centroid (mm) of what rises above air near `CENTER`."""
    part = stack.around(CENTER, 10, crop=True)
    (images,) = machine.reconstruct(scene, [part])
    return phantom_measures.centroid(images + 1000.0, part, CENTER, 9)


@few_and_others("machine", [CONE], [AXIAL, HELIX], ids=["cone beam", "axial", "helix"])
def test_who_has_moved_before_the_scan_is_scanned_where_he_is(machine: Machine) -> None:
    (place,) = MOVED.path(CENTER, np.array([0.5]))
    assert np.linalg.norm(place - CENTER) > 0.5
    assert centroid(replace(machine, motion=MOVED)) == pytest.approx(place, abs=0.006)


def test_a_drift_during_a_full_turn_shows_the_mean_place() -> None:
    shift = (0.0, 0.0, 0.4)
    found = centroid(replace(CONE, motion=Motion("drift", shift)))
    assert found - CENTER == pytest.approx([0, 0, 0.2], abs=0.01)


def test_an_axial_scan_shows_a_jump_only_in_what_comes_later() -> None:
    stack = axial_stack(start_mm=-60, stop_mm=40, spacing_mm=0.5, matrix=200, field_of_view_mm=100)
    scanner = AXIAL.aimed(stack)
    shift = (0.3, 0.2, 0.0)
    late, early = (centroid(replace(scanner, motion=Motion("jump", shift, when=w))) for w in (0.9, 0.3))
    assert late == pytest.approx(CENTER, abs=0.006)
    assert early - CENTER == pytest.approx(shift, abs=0.006)


def test_a_turn_keeps_its_pivot_and_comes_back_with_each_breath() -> None:
    pivot = np.array([3.0, 4.0, 5.0])
    motion = Motion("breathing", turn_deg=(0, 0, 2.0), cycles=3, pivot_mm=(3, 4, 5))
    times = np.array([0, 1 / 6, 1 / 3, 0.5])
    assert motion.path(pivot, times) == pytest.approx(np.tile(pivot, (4, 1)))
    away = motion.path(pivot + np.array([10, 0, 0]), times) - pivot
    angles = np.degrees(np.arctan2(away[:, 1], away[:, 0]))
    assert angles == pytest.approx([0, 2, 0, 2], abs=1e-9)


def test_the_truth_of_what_moved_is_a_path_and_its_mean(tmp_path: Path) -> None:
    motion = Motion("drift", (0.6, 0.0, 0.0))
    stack = replace(STACK, centers_mm=STACK.centers_mm[:3], rows=16, columns=16)
    machine = replace(CONE, views=16, motion=motion).aimed(stack)
    examination = Examination(BALL, stack, machine)
    examination.write(tmp_path / "ct")
    (truth,) = json.loads((tmp_path / "ct" / "truth.json").read_text())["markers"]
    middle, end = (CENTER + np.array([x, 0, 0]) for x in (0.3, 0.6))
    assert truth["center"] == pytest.approx(middle, abs=1e-6)
    assert truth["center_at_mid_scan"] == pytest.approx(middle, abs=1e-6)
    path = np.array(truth["path"])
    assert path[[0, -1]] == pytest.approx(np.array([[0, *CENTER], [1, *end]]), abs=1e-6)
    assert examination.shown.decoys[0].center_mm == pytest.approx([0.3, 0, 4.0])
    assert examination.scene.markers[0].center_mm is CENTER


def test_an_axial_marker_moved_only_while_it_was_in_the_beam() -> None:
    patient = random_patient(2, protocol="axial motion")
    motion = Motion("drift", (0.0, 1.0, 0.0))
    patient = replace(patient, scanner=replace(patient.scanner, motion=motion))
    for before, after in zip(patient.scene.markers, patient.shown.markers, strict=True):
        low, high = patient.stack.positions_mm.min(), patient.stack.positions_mm.max()
        when = (before.center_mm[2] - low) / (high - low)
        assert (after.center_mm - before.center_mm)[1] == pytest.approx(when, abs=0.2)
        assert after.path is not None
        assert 0 <= after.path[0, 0] < when < after.path[-1, 0] <= 1


def test_a_helix_shows_a_jump_only_in_what_comes_later() -> None:
    stack = axial_stack(start_mm=-60, stop_mm=60, spacing_mm=0.5, matrix=200, field_of_view_mm=100)
    scanner, shift = HELIX.aimed(stack), (0.3, 0.2, 0.0)
    late, early = (centroid(replace(scanner, motion=Motion("jump", shift, when=w))) for w in (0.9, 0.1))
    assert late == pytest.approx(CENTER, abs=0.01)
    assert early - late == pytest.approx(shift, abs=0.006)
    assert scanner.seen_during(CENTER, 5.75, stack) == pytest.approx((0.437, 0.633), abs=0.02)


def test_motions_are_drawn_in_every_form() -> None:
    drawn = [random_motion(np.random.default_rng(seed)) for seed in range(30)]
    assert {one.form for one in drawn} == set(FORMS)
    assert all(0.2 <= np.linalg.norm(one.shift_mm) <= 1.0 for one in drawn)


def test_what_knows_no_time_refuses_to_move() -> None:
    with pytest.raises(PhantomError, match="the fast renderer knows no time"):
        Examination(BALL, STACK, replace(CONE, motion=MOVED)).images(fast=True)
    with pytest.raises(PhantomError, match="unknown form of motion 'sway'; expected one of jump"):
        Motion("sway")  # type: ignore[arg-type]
