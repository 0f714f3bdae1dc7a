from __future__ import annotations

import numpy as np
import pytest

from phantoms.anatomy import head, scalp_foot
from phantoms.averages import average_hu
from phantoms.errors import PhantomError
from phantoms.lifelike import lifelike_head
from phantoms.markers import marker
from phantoms.materials import MATERIALS
from phantoms.patients import random_patient
from phantoms.scene import Part, Scene
from phantoms.solids import FloatArray, sphere
from phantoms.stack import axial_stack
from phantoms.surgery import bone_flap, burr_hole, shunt
from phantoms.worn import CAP_CLEARANCE_MM, braces, eeg_cap, hair, head_frame

TOP = scalp_foot((0.2, -0.3, 0.9))
BODY = lifelike_head(np.random.default_rng(1))


def material_at(scene: Scene, place_mm: FloatArray) -> str:
    """Return what the last part that holds a place is made of."""
    inside = [part.material for part in scene.parts if part.solid.contains(place_mm[np.newaxis])[0]]
    return inside[-1] if inside else "air"


def test_the_skull_has_two_dense_tables_with_diploe_between() -> None:
    depths = {-1: "air", 3: "skin", 6.8: "cortical bone", 9.5: "diploe", 12.2: "cortical bone", 20: "brain"}
    for direction in ((0.3, -0.2, 0.9), (-0.7, 0.2, 0.5), (0.1, 0.9, 0.6)):
        foot = scalp_foot(direction)
        assert [material_at(BODY, foot.above(-depth)) for depth in depths] == list(depths.values())


def test_markers_stand_on_the_same_scalp() -> None:
    for direction in np.random.default_rng(2).standard_normal((50, 3)):
        direction[2] = abs(direction[2]) + 0.4
        foot = scalp_foot(direction)
        for scene in (head(), BODY):
            assert (material_at(scene, foot.above(0.1)), material_at(scene, foot.above(-0.1))) == ("air", "skin")


def test_a_head_has_air_cells_canals_and_balls_that_are_no_markers() -> None:
    assert material_at(BODY, np.array([75.0, 12.8, -29])) == "air"
    assert material_at(BODY, np.array([8.0, -26, -42])) == "air"
    for one in BODY.decoys:
        expected = {"eye": "water", "calcification": "cortical bone"}[one.kind]
        assert material_at(BODY, one.center_mm) == expected
    other = lifelike_head(np.random.default_rng(2))
    assert [p.solid.radius_mm for p in other.parts] != [p.solid.radius_mm for p in BODY.parts]


def test_surgery_opens_and_closes_the_skull() -> None:
    hole = BODY + burr_hole(TOP)
    assert [material_at(hole, TOP.above(-d)) for d in (3, 5.7, 9)] == ["skin", "titanium", "cerebrospinal fluid"]
    flap = BODY + bone_flap(TOP)
    assert material_at(flap, TOP.above(-9.5)) == "diploe"
    cuts = [part.solid for part in flap.parts if part.name == "saw cut"]
    assert all(np.linalg.norm(cut.center_mm - TOP.above(-10.5)) == pytest.approx(25) for cut in cuts)
    tube = BODY + shunt(TOP)
    (valve,) = (one for one in tube.decoys if one.kind == "shunt valve")
    assert material_at(tube, valve.center_mm) == "steel"
    assert material_at(tube, np.array([6.0, 0, 10]) * 0.8 + TOP.place_mm * 0.2) == "water"


def test_hair_gives_way_to_markers() -> None:
    generator = np.random.default_rng(3)
    markers = [marker(f"M{n}", scalp_foot(at)) for n, at in enumerate(((0, -0.5, 0.8), (0.5, 0.5, 0.7)))]
    scene = (hair(generator) + head() + markers[0] + markers[1]).check()
    foot = scalp_foot((-0.5, 0.2, 0.8))
    assert material_at(scene, foot.above(5)) in {"loose hair", "hair", "steel"}
    for one in scene.markers:
        for offset in np.eye(3) * 5.5:
            assert material_at(scene, one.center_mm + offset) == "acrylic"
    assert not any(part.yields for part in (head() + markers[0]).parts)


def test_a_part_that_does_not_yield_is_not_overlapped() -> None:
    ball = Part(sphere((0, 0, 0), 10), "acrylic")
    Scene((Part(sphere((6, 0, 0), 8), "hair", yields=True), ball)).check()
    with pytest.raises(PhantomError, match="overlaps"):
        Scene((Part(sphere((6, 0, 0), 8), "hair"), ball)).check()


def test_a_cap_keeps_clear_of_markers() -> None:
    everywhere = eeg_cap([])
    assert sum(part.name == "electrode" for part in everywhere.parts) == 19
    foot = scalp_foot((0.05, -0.6, 0.8))
    clear = eeg_cap([foot])
    electrodes = [part.solid.center_mm for part in clear.parts if part.name == "electrode"]
    assert 16 <= len(electrodes) < 19
    assert min(np.linalg.norm(foot.above(3) - place) for place in electrodes) > CAP_CLEARANCE_MM - 2


def test_a_frame_stands_on_its_pins_and_braces_on_teeth() -> None:
    scene = head() + head_frame()
    tips = [part.solid for part in scene.parts if part.name == "pin tip"]
    assert len(tips) == 4
    for tip in tips:
        end = tip.center_mm + tip.half_axes_mm[:, 2]
        assert material_at(head(), end) == "skull"
    plain = [part for part in scene.parts if part.name in {"N plate", "N rod", "frame ring"}]
    assert all(material_at(head(), part.solid.center_mm) == "air" for part in plain)
    stack = axial_stack(start_mm=-87, stop_mm=-87, matrix=64, field_of_view_mm=80, center_mm=(0, -60, 0))
    assert average_hu(head() + braces(), stack).max() > 0.3 * MATERIALS["steel"].nominal_hu


def test_lifelike_patients_are_sound_and_have_their_markers_where_plain_ones_have_them() -> None:
    names = set()
    for seed in (1, 2, 4, 5, 8, 21):
        patient = random_patient(seed, lifelike=True, covering="any", touching=seed % 2)
        names |= {part.name for part in patient.scene.check().parts}
        plain = random_patient(seed, touching=seed % 2).scene
        for one, other in zip(patient.scene.markers, plain.markers, strict=True):
            assert np.linalg.norm(one.center_mm - other.center_mm) < 0.01 or one.covering
        assert len(patient.scene.decoys) > len(plain.decoys)
    assert names >= {"hair", "cap", "bracket", "frame ring", "burr hole", "saw cut", "valve"}
