from __future__ import annotations

import itertools

import numpy as np
import pytest

from phantoms.anatomy import scalp_foot
from phantoms.decoys import DECOYS, decoy
from phantoms.errors import PhantomError
from phantoms.library import READY, ready
from phantoms.markers import KINDS, marker, x_frame
from phantoms.patients import random_patient
from phantoms.stack import axial_stack
from tests.long import few_and_others


@pytest.mark.parametrize("name", READY)
def test_every_ready_scene_is_sound_and_shows_its_markers_whole(name: str) -> None:
    examination = ready(name)
    examination.scene.check()
    for one in examination.scene.markers:
        assert examination.stack.holds_whole(one.center_mm, one.diameter_mm)


def test_an_unknown_scene_is_refused_with_the_known_names() -> None:
    with pytest.raises(PhantomError, match="'patient-9'; expected one of demo-head, lab-phantom"):
        ready("patient-9")


@pytest.mark.parametrize("count", range(3, 9))
def test_the_patient_set_ups_have_no_two_alike_distances(count: int) -> None:
    centers = [one.center_mm for one in ready(f"patient-{count}").scene.markers]
    distances = sorted(float(np.linalg.norm(a - b)) for a, b in itertools.combinations(centers, 2))
    assert len(centers) == count
    assert np.diff(distances).min() > (4.0 if count <= 5 else 0.6)


def test_the_x_frame_has_unique_distances() -> None:
    centers = [one.center_mm for one in x_frame(scalp_foot((0.1, -0.4, 0.9))).markers]
    distances = sorted(float(np.linalg.norm(a - b)) for a, b in itertools.combinations(centers, 2))
    assert len(distances) == 6
    assert np.diff(distances).min() > 10.0


@pytest.mark.parametrize("kind", KINDS)
def test_a_marker_stands_off_its_foot_along_the_normal(kind: str) -> None:
    foot = scalp_foot((0.4, -0.5, 0.7))
    (one,) = marker("M1", foot, kind).markers
    height = float((np.asarray(one.center_mm) - foot.place_mm) @ foot.outward)
    assert np.linalg.norm(one.center_mm - foot.above(height)) == pytest.approx(0, abs=1e-9)
    post = KINDS[kind].post
    assert height - one.diameter_mm / 2 == pytest.approx(post.height_mm if post else 0.1)


@pytest.mark.parametrize("name", DECOYS)
def test_a_decoy_is_no_marker(name: str) -> None:
    scene = decoy(name, scalp_foot((0.4, -0.5, 0.7)))
    assert not scene.markers
    assert [one.kind for one in scene.decoys] == [name]


def test_a_random_patient_is_fixed_by_its_seed() -> None:
    one, again, other = (random_patient(seed) for seed in (5, 5, 6))
    assert all(
        (a.center_mm == b.center_mm).all() for a, b in zip(one.scene.markers, again.scene.markers, strict=True)
    )
    assert (one.scanner, one.stack.thickness_mm) == (again.scanner, again.stack.thickness_mm)
    assert not np.allclose(one.scene.markers[0].center_mm, other.scene.markers[0].center_mm)


@few_and_others("kind", [*KINDS][::4], [kind for n, kind in enumerate(KINDS) if n % 4])
def test_random_patients_are_sound(kind: str) -> None:
    for seed in range(4):
        examination = random_patient(seed, kind=kind, uneven=seed % 2 == 1, tilt_deg=5.0 * seed)
        examination.scene.check()
        assert 3 <= len(examination.scene.markers) <= 8
        assert 2 <= len(examination.scene.decoys) <= 5


def test_too_many_markers_are_refused() -> None:
    with pytest.raises(PhantomError, match="ask for fewer"):
        random_patient(1, count=60)


@pytest.mark.parametrize("spacing_mm", [1e-3, 1e-320])
def test_more_slices_than_any_scan_has_are_refused(spacing_mm: float) -> None:
    with pytest.raises(PhantomError, match="slices were asked for; expected at most 20000"):
        axial_stack(start_mm=0.0, stop_mm=100.0, spacing_mm=spacing_mm)


def test_a_slab_holds_only_the_slices_near_a_marker() -> None:
    examination = random_patient(3)
    center = examination.scene.markers[0].center_mm
    slab = examination.around(center, 12.0)
    assert 0 < len(slab.stack) < len(examination.stack)
    assert np.abs(slab.stack.positions_mm - center[2]).max() <= 12.0
    assert slab.stack.holds_whole(center, examination.scene.markers[0].diameter_mm)
