from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pydicom
import pytest
from numpy.typing import NDArray
from scipy.spatial import KDTree

from benchmarks import phantom_measures
from phantoms.errors import PhantomError
from phantoms.examination import Examination
from phantoms.finish import (
    Finish,
    Interpolated,
    NonLocalMeans,
    PenalizedLeastSquares,
    Reformatted,
    Step,
    TotalVariation,
)
from phantoms.patients import random_patient
from phantoms.protocols import PROTOCOLS, draw
from phantoms.scanner import Scanner
from phantoms.scene import Part, Scene
from phantoms.series import Tag
from phantoms.solids import FloatArray, cylinder, sphere
from phantoms.stack import SliceStack, axial_stack
from tests.long import few_and_others, few_or_all

CENTER = np.array([5.21, -3.87, 2.13])
BALL = Scene((Part(sphere(CENTER, 11.5), "acrylic"),))
TURN = np.array([[0.96, 0.0, 0.28], [0.0, 1.0, 0.0], [-0.28, 0.0, 0.96]])
QUIET = Scanner(dose=0.0, views=180)


def centroid(examination: Examination) -> FloatArray:
    return phantom_measures.centroid(examination.images() + 1000.0, examination.stack, CENTER, 11)


@pytest.mark.parametrize("name", PROTOCOLS)
@few_or_all("cases", 5, 12)
def test_a_protocol_is_drawn_again_by_its_seed_and_varies_with_it(name: str, cases: int) -> None:
    def settings(seed: int) -> str:
        return repr(draw(name, seed))

    assert settings(3) == settings(3)
    assert len({settings(seed) for seed in range(cases)}) > 2
    patient = random_patient(4, protocol=name)
    assert patient.protocol == name
    assert patient.profile_fwhm_mm > 0
    assert all(patient.stack.holds_whole(one.center_mm, one.diameter_mm) for one in patient.scene.markers)


def test_an_unknown_protocol_and_a_contradiction_are_refused() -> None:
    with pytest.raises(PhantomError, match=r"no protocol is called 'x-ray'; expected one of axial; .*180LI; "):
        draw("x-ray", 0)
    with pytest.raises(PhantomError, match="give a protocol or these"):
        random_patient(0, protocol="3 mm", thickness_mm=1.0)


@few_and_others(
    ("step", "orientation"),
    [(Reformatted(0.75, 0.75), TURN)],
    [(Interpolated(1.5), np.eye(3))],
    ids=["oblique", "interpolated"],
)
def test_a_ball_keeps_its_place_in_slices_drawn_between_others(step: Step, orientation: FloatArray) -> None:
    stack = axial_stack(
        start_mm=-14,
        stop_mm=18,
        spacing_mm=0.5,
        thickness_mm=1.5,
        matrix=72,
        field_of_view_mm=45,
        orientation=orientation,
    )
    found = centroid(Examination(BALL, stack, QUIET, finish=Finish((step,))))
    assert found == pytest.approx(CENTER, abs=0.004)


@few_and_others(
    "step",
    [TotalVariation(20.0)],
    [NonLocalMeans(10.0), PenalizedLeastSquares(0.3, 40.0)],
    ids=["variation", "means", "penalized"],
)
def test_denoising_leaves_less_noise_and_the_ball_in_its_place(step: Step) -> None:
    water = Scene((Part(cylinder((0, 0, -50), (0, 0, 1), 100, 120), "water"),))
    stack = axial_stack(start_mm=0, stop_mm=1, matrix=64, field_of_view_mm=32)
    noisy = Examination(water, stack, Scanner(views=180))
    assert replace(noisy, finish=Finish((step,))).images().std() < 0.7 * noisy.images().std()
    stack = axial_stack(start_mm=-8, stop_mm=12, matrix=72, field_of_view_mm=45)
    assert centroid(Examination(BALL, stack, QUIET, finish=Finish((step,)))) == pytest.approx(CENTER, abs=0.004)


def test_penalized_least_squares_without_edges_is_a_filter_in_closed_form() -> None:
    stack = axial_stack(start_mm=0, stop_mm=0, matrix=64, field_of_view_mm=32)
    row = np.mgrid[:84, :84][0] * stack.pixel_mm
    for cycles in (4, 8, 16):
        per_mm = cycles / 32
        waves = 5 * np.cos(2 * np.pi * per_mm * row)[np.newaxis]
        kept = PenalizedLeastSquares(0.3, 1e9).apply(waves, stack.wider(10), stack)
        rough = (2 * np.sin(np.pi * per_mm * stack.pixel_mm) / stack.pixel_mm) ** 2
        expected = 1 / (1 + per_mm * rough / 0.3 / (2 * np.pi * 0.3) ** 2)
        assert np.abs(kept - expected * waves[:, 10:-10, 10:-10]).max() < 0.05


def test_penalized_least_squares_keeps_edges() -> None:
    stack = axial_stack(start_mm=0, stop_mm=0, matrix=64, field_of_view_mm=32)
    image = np.where(np.mgrid[:84, :84][0] < 42, 0.0, 1000.0)[np.newaxis]
    soft, sharp = (
        PenalizedLeastSquares(0.2, edge).apply(image, stack.wider(10), stack)[0] for edge in (1e9, 20.0)
    )
    assert np.diff(sharp[:, 32]).max() > 1.5 * np.diff(soft[:, 32]).max()


def values_at(points_mm: FloatArray, stack: SliceStack, voxels: NDArray[np.int16]) -> NDArray[np.int16]:
    distance, nearest = KDTree(phantom_measures.places(stack).reshape(-1, 3)).query(points_mm)
    assert np.max(distance) < 1e-6
    found: NDArray[np.int16] = voxels.ravel()[nearest]
    return found


@pytest.mark.parametrize(
    "step", [(), (Interpolated(1.5),), (Reformatted(1.0, 1.0),)], ids=["", "lines", "oblique"]
)
def test_crops_of_one_scan_equal_the_whole(step: tuple[Step, ...]) -> None:
    stack = axial_stack(start_mm=-10, stop_mm=14, spacing_mm=2.0, matrix=40, field_of_view_mm=28)
    examination = Examination(BALL, stack, Scanner(dose=0.0, views=60), finish=Finish(step))
    whole = examination.images()
    for near, voxels in examination.crops([CENTER, CENTER + 4], 5.0):
        expected = values_at(phantom_measures.places(near.stack).reshape(-1, 3), stack, whole)
        assert voxels.ravel() == pytest.approx(expected, abs=1)


def test_crops_of_one_scan_share_its_noise() -> None:
    stack = axial_stack(start_mm=0, stop_mm=4, spacing_mm=2.0, matrix=40, field_of_view_mm=28)
    (one, first), (other, second) = Examination(BALL, stack, Scanner(views=60)).crops([CENTER, CENTER + 2], 4.0)
    points = phantom_measures.places(one.stack).reshape(-1, 3)
    shared = points[np.abs(points - (CENTER + 2)).max(axis=1) < 4]
    assert len(shared) > 50
    assert (values_at(shared, one.stack, first) == values_at(shared, other.stack, second)).all()


@pytest.mark.parametrize(
    ("tag", "text"), [("nominal", "3"), ("spacing", "1.5"), ("pixel", "0.5"), ("doubled", "6"), ("absent", "")]
)
def test_the_header_says_of_the_thickness_what_the_protocol_wants(tmp_path: Path, tag: Tag, text: str) -> None:
    stack = axial_stack(start_mm=0, stop_mm=3, spacing_mm=1.5, thickness_mm=3.0, matrix=32, field_of_view_mm=16)
    examination = Examination(BALL, stack, finish=Finish(slope=2.0, tag=tag))
    examination.write(tmp_path / "ct", fast=True)
    dataset = pydicom.dcmread(tmp_path / "ct" / "CT0001.dcm")
    assert str(dataset["SliceThickness"].value or "") == text
    assert float(dataset.RescaleSlope) == 2.0
    tagged = examination.tagged_thickness_mm
    assert ("" if tagged is None else f"{tagged:g}") == text


def test_slope_two_keeps_even_values_and_a_longer_scale() -> None:
    scene = Scene((Part(sphere(CENTER, 8), "titanium"),))
    stack = axial_stack(start_mm=0, stop_mm=2, matrix=64, field_of_view_mm=32)
    stored = Examination(scene, stack, QUIET, finish=Finish(slope=2.0)).images()
    assert (stored % 2 == 0).all()
    assert stored.max() == -1024 + 2 * 4095
