from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from phantoms.anatomy import Foot
from phantoms.averages import average_hu
from phantoms.coverings import COVERINGS, FILM_MM
from phantoms.errors import PhantomError
from phantoms.markers import KINDS, Condition, MarkerKind, made, marker, touching_pair
from phantoms.materials import MATERIALS
from phantoms.output import write_phantom
from phantoms.patients import random_patient
from phantoms.scene import Part, Scene
from phantoms.solids import FloatArray, sphere
from phantoms.stack import axial_stack
from tests.long import few_and_others

FOOT = Foot(np.zeros(3), np.array([0.0, 0.6, 0.8]))
BALL = MarkerKind(11.5, "acrylic")
CONTRAST = {name: one.nominal_hu + 1000 for name, one in MATERIALS.items()}


def mass(scene: Scene) -> tuple[FloatArray, float]:
    """Return centroid (mm) and mass (HU x mm3) of a scene about its first marker, in air."""
    center = scene.markers[0].center_mm
    stack = axial_stack(start_mm=-12, stop_mm=12, spacing_mm=0.8, matrix=80, field_of_view_mm=26, center_mm=center)
    weights = average_hu(scene, stack) + 1000
    k, v, u = np.indices(weights.shape)
    places = stack.origins_mm[k] + stack.pixel_mm * np.stack([u, v, 0 * u], axis=-1)
    return np.average(
        places.reshape(-1, 3), axis=0, weights=weights.ravel()
    ), weights.sum() * stack.pixel_mm**2 * 0.8


def volume(diameter_mm: float) -> float:
    return np.pi / 6 * diameter_mm**3


def test_a_marker_as_made_keeps_its_center_and_says_its_true_diameter() -> None:
    scene = marker("M1", FOOT, BALL, Condition(oversize_mm=0.2, out_of_round=0.02, seed=5))
    (truth,) = scene.markers
    assert (truth.diameter_mm, truth.stated_diameter_mm, truth.out_of_round) == (11.7, 11.5, 0.02)
    centroid, found = mass(scene)
    assert centroid == pytest.approx(truth.center_mm, abs=0.002)
    assert found == pytest.approx(CONTRAST["acrylic"] * volume(11.7), rel=2e-3)
    lengths = np.linalg.norm(scene.parts[-1].solid.half_axes_mm, axis=0)
    assert lengths.max() / lengths.min() - 1 == pytest.approx(0.02, abs=3e-4)


def test_a_film_on_one_side_shifts_the_mass_and_not_the_truth() -> None:
    scene = marker("M1", FOOT, BALL, Condition(covering="film", seed=2))
    bare, film = CONTRAST["acrylic"], CONTRAST["polyester"]
    around = film * volume(11.5 + FILM_MM)
    total = around + (bare - film) * volume(11.5)
    centroid, found = mass(scene)
    assert found == pytest.approx(total, rel=2e-3)
    shift = np.linalg.norm(centroid - scene.markers[0].center_mm)
    assert shift == pytest.approx(FILM_MM / 2 * around / total, abs=0.003)
    assert scene.markers[0].covering == "film"


@pytest.mark.parametrize("kind", [name for name, one in KINDS.items() if one.wall_mm and not one.post])
def test_a_hollow_marker_is_a_shell(kind: str) -> None:
    scene = marker("M1", FOOT, kind)
    known = KINDS[kind]
    shell = volume(known.diameter_mm) - volume(known.diameter_mm - 2 * known.wall_mm)
    assert mass(scene)[1] == pytest.approx(CONTRAST[known.material] * shell, rel=2e-3)
    assert scene.markers[0].wall_mm == known.wall_mm


@pytest.mark.parametrize("name", COVERINGS)
def test_a_covering_lies_outside_the_ball_and_off_the_skin(name: str) -> None:
    skin = Scene((Part(sphere((0, -60, -80), 200), "skin", "skin", embedded=True),))
    scene = (skin + marker("M1", FOOT, "ceramic", Condition(covering=name, seed=1))).check()
    *covers, ball = scene.parts[1:]
    assert covers
    assert ball.solid.center_mm == pytest.approx(scene.markers[0].center_mm)
    for part in covers:
        if part.material not in {"polyethylene", "polyester", "hair"} or name == "film":
            assert (part.solid.center_mm @ FOOT.outward) >= part.solid.radius_mm


def test_a_bubble_lies_in_the_ball() -> None:
    for seed in range(20):
        scene = marker("M1", FOOT, BALL, Condition(bubble=True, seed=seed))
        ball, hole = scene.parts[-2].solid, scene.parts[-1].solid
        assert np.linalg.norm(ball.center_mm - hole.center_mm) + hole.radius_mm < ball.radius_mm
        assert scene.markers[0].covering == "bubble"


def test_two_touching_markers_are_two() -> None:
    one, other = touching_pair(("M1", "M2"), FOOT, turn_deg=30).check().markers
    assert np.linalg.norm(one.center_mm - other.center_mm) == pytest.approx(11.5, abs=1e-5)


def test_what_is_drawn_stays_within_what_makers_promise() -> None:
    generator = np.random.default_rng(3)
    drawn = [made(generator) for _ in range(200)]
    assert max(abs(one.oversize_mm) for one in drawn) <= 0.2
    assert max(one.out_of_round for one in drawn) <= 0.02
    assert len({one.seed for one in drawn}) == 200


@few_and_others("covering", ["any"], ["gauze"])
def test_patients_with_markers_as_they_are_are_sound(covering: str) -> None:
    for seed in range(6):
        scene = random_patient(seed, kind="any", as_made=True, covering=covering, touching=seed % 2).scene.check()
        bare = random_patient(seed, kind="post").scene
        assert len(scene.markers) == len(bare.markers) + seed % 2
        if covering == "gauze":
            assert {one.covering for one in scene.markers} <= {"gauze", ""}


def test_the_truth_on_disk_says_what_is_true(tmp_path: Path) -> None:
    scene = marker("M1", FOOT, "hollow plastic post", Condition(-0.125, 0.01, "hair", bubble=True, seed=4))
    stack = axial_stack(start_mm=0, stop_mm=2, matrix=16, field_of_view_mm=20)
    write_phantom(tmp_path / "ct", scene, stack, np.zeros((3, 16, 16), np.int16))
    (truth,) = json.loads((tmp_path / "ct" / "truth.json").read_text())["markers"]
    assert (truth["diameter_mm"], truth["stated_diameter_mm"]) == (11.375, 11.5)
    assert (truth["wall_mm"], truth["out_of_round"], truth["covering"]) == (1.0, 0.01, "hair, bubble")


def test_an_unknown_covering_is_refused() -> None:
    with pytest.raises(PhantomError, match="unknown covering 'mud'; expected one of film"):
        marker("M1", FOOT, BALL, Condition(covering="mud"))
