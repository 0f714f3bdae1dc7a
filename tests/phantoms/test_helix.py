from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.phantom_measures import centroid, places
from phantoms.errors import PhantomError
from phantoms.helix import Helix
from phantoms.scene import Part, Scene
from phantoms.solids import cylinder, sphere
from phantoms.stack import SliceStack, axial_stack
from tests.long import few_and_others

CENTER = np.array([35.21, -24.13, 3.37])
FEW_ROWS = Helix(dose=0.0, views=240, rows=4, row_mm=1.25, pitch=0.75, method="180LI")
MANY_ROWS = Helix(dose=0.0, views=240, rows=16, row_mm=0.6, pitch=0.65)


def ball_stack(spacing_mm: float) -> SliceStack:
    stack = axial_stack(start_mm=-7, stop_mm=14, spacing_mm=spacing_mm, matrix=40, field_of_view_mm=24)
    return replace(stack, aside_mm=(35.0, -24.0))


@few_and_others(
    "scanner",
    [MANY_ROWS],
    [FEW_ROWS, replace(FEW_ROWS, method="360LI"), replace(MANY_ROWS, views=480, flying_spot=True, kernel="bone")],
    ids=["WFBP", "180LI", "360LI", "flying spot"],
)
def test_a_ball_keeps_its_place_and_its_attenuation(scanner: Helix) -> None:
    stack = ball_stack(scanner.row_mm)
    (images,) = scanner.reconstruct(Scene((Part(sphere(CENTER, 11.5), "acrylic"),)), [stack])
    assert centroid(images + 1000.0, stack, CENTER, 9) == pytest.approx(CENTER, abs=0.004)
    distance = np.linalg.norm(places(stack) - CENTER, axis=-1)
    assert images[distance < 3].mean() == pytest.approx(104, abs=3)


@few_and_others(
    ("scanner", "thickness_mm"),
    [(replace(FEW_ROWS, method="360LI"), 1.25), (MANY_ROWS, 1.2)],
    [(FEW_ROWS, 1.25), (MANY_ROWS, 0.6)],
    ids=["360LI", "WFBP of two rows", "180LI", "WFBP"],
)
def test_a_thin_disc_shows_a_profile_as_wide_as_stated(scanner: Helix, thickness_mm: float) -> None:
    disc = Scene((Part(cylinder((0, 0, 0.25), (0, 0, 1), 0.1, 16), "acrylic"),))
    stack = axial_stack(
        start_mm=-2.7, stop_mm=3.3, spacing_mm=0.1, thickness_mm=thickness_mm, matrix=16, field_of_view_mm=6
    )
    (images,) = scanner.reconstruct(disc, [stack])
    seen = images[:, 4:12, 4:12].mean(axis=(1, 2)) + 1000
    fine = np.linspace(-2.7, 3.3, 6001)
    curve = np.interp(fine, stack.positions_mm, seen)
    width = np.ptp(fine[curve >= curve.max() / 2])
    assert width == pytest.approx(scanner.profile(stack).fwhm_mm, rel=0.05)


def test_crops_come_from_one_scan_with_the_noise_of_the_whole() -> None:
    scene = Scene((Part(cylinder((0, 0, -40), (0, 0, 1), 80, 60), "water"),))
    stack = axial_stack(start_mm=0, stop_mm=6, spacing_mm=1.5, matrix=24, field_of_view_mm=24)
    scanner = replace(FEW_ROWS, dose=1.0, views=120)
    near = stack.around((3, 2, 3), 3.0, crop=True)
    whole, crop = scanner.reconstruct(scene, [stack, near], seed=4)
    first = np.argmin(np.linalg.norm(places(stack) - near.origins_mm[0], axis=-1).ravel())
    k, v, u = np.unravel_index(first, whole.shape)
    same = whole[k : k + len(near), v : v + near.rows, u : u + near.columns]
    assert crop == pytest.approx(same, abs=0.05)
    assert same.std() > 1
    assert abs(whole.mean()) < 3


@pytest.mark.parametrize("wrong", [{"pitch": 3.0}, {"rows": 1}, {"views": 30}, {"row_mm": 0.0}])
def test_an_impossible_helix_is_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(PhantomError, match="expected"):
        Helix(**wrong)  # type: ignore[arg-type]


def test_a_tilted_gantry_is_refused() -> None:
    stack = axial_stack(start_mm=0, stop_mm=6, tilt_deg=10, matrix=24, field_of_view_mm=24)
    with pytest.raises(PhantomError, match="one axis, square to all slices"):
        MANY_ROWS.reconstruct(Scene((Part(sphere((0, 0, 3), 10), "water"),)), [stack])
