from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree
from skimage.transform import iradon

from benchmarks.phantom_measures import moments, places
from phantoms.errors import PhantomError
from phantoms.examination import Examination
from phantoms.kernels import KERNELS
from phantoms.scanner import Scanner, rows_per_slice
from phantoms.scene import Part, Scene
from phantoms.solids import FloatArray, box, cylinder, half_space, sphere
from phantoms.stack import SliceStack, axial_stack
from tests.long import few_and_others, few_or_all

QUIET = Scanner(dose=0.0)
FEW_VIEWS = Scanner(dose=0.0, views=60)
WATER_DISC = Scene((Part(cylinder((0, 0, -50), (0, 0, 1), 100, 200), "water"),))
TURN = np.linalg.qr(np.array([[0.3, -0.5, 0.8], [0.9, 0.2, -0.4], [0.1, 0.7, 0.6]]))[0]
TURN *= np.sign(np.linalg.det(TURN))


def images(scene: Scene, stack: SliceStack, scanner: Scanner = QUIET, seed: int = 0) -> FloatArray:
    return scanner.reconstruct(scene, [stack], seed=seed)[0].astype(np.float64)


def ball_mass(center: FloatArray, stack: SliceStack, scanner: Scanner) -> tuple[FloatArray, float]:
    """Return centroid (mm) and mass (HU x mm3) of an 11.5 mm plastic ball in air."""
    excess = images(Scene((Part(sphere(center, 11.5), "acrylic"),)), stack, scanner) + 1000
    return moments(excess, stack, center, 13)


def ball_stack(**options: object) -> SliceStack:
    return axial_stack(start_mm=-10, stop_mm=10, matrix=96, field_of_view_mm=40, **options)  # type: ignore[arg-type]


def test_water_is_zero_and_flat() -> None:
    stack = axial_stack(start_mm=0, stop_mm=0, matrix=128, field_of_view_mm=250)
    image = images(WATER_DISC, stack)[0]
    radius = np.linalg.norm(places(stack)[0, ..., :2], axis=-1)
    assert np.abs(image[radius < 95]).max() < 1.0
    assert image[(radius > 106) & (radius < 124)].mean() == pytest.approx(-1000, abs=1)


def test_noise_follows_dose_and_the_seed_repeats_it() -> None:
    stack = axial_stack(start_mm=0, stop_mm=0, matrix=128, field_of_view_mm=60)
    levels = [images(WATER_DISC, stack, Scanner(dose=dose), seed=2).std() for dose in (1.0, 0.25)]
    assert levels[1] / levels[0] == pytest.approx(2.0, rel=0.05)
    again = images(WATER_DISC, stack, Scanner(), seed=2)
    assert (again == images(WATER_DISC, stack, Scanner(), seed=2)).all()
    assert (again != images(WATER_DISC, stack, Scanner(), seed=3)).any()


@few_and_others("tilt_deg", [-15.0], [0.0])
@few_and_others("orientation", [TURN], [np.eye(3)], ids=["oblique", "axial"])
def test_a_ball_is_where_it_should_be(tilt_deg: float, orientation: FloatArray) -> None:
    center = orientation @ [30.31, -20.17, 0.43]
    stack = ball_stack(tilt_deg=tilt_deg, orientation=orientation, center_mm=(30, -20, 0))
    centroid, _ = ball_mass(center, stack, QUIET)
    assert centroid == pytest.approx(center, abs=0.002)


@few_or_all("kernels", [*KERNELS][::3], [*KERNELS])
def test_mass_is_kept_across_kernels_and_slice_thickness(kernels: list[str]) -> None:
    center = np.array([0.3, 0.2, 0.1])
    masses = [ball_mass(center, ball_stack(), Scanner(dose=0, views=120, kernel=name))[1] for name in kernels]
    masses += [
        ball_mass(center, ball_stack(spacing_mm=s, thickness_mm=t), Scanner(dose=0, views=120))[1]
        for s, t in ((2, 3), (0.5, 1))
    ]
    assert max(masses) / min(masses) < 1.01


def test_a_slab_of_a_scan_equals_that_part_of_the_whole() -> None:
    whole = axial_stack(start_mm=-4, stop_mm=4, spacing_mm=1, thickness_mm=2, matrix=48, field_of_view_mm=60)
    slab = axial_stack(start_mm=1, stop_mm=3, spacing_mm=1, thickness_mm=2, matrix=48, field_of_view_mm=60)
    scanner = Scanner(dose=0.5, views=90)
    assert images(WATER_DISC, slab, scanner, 7) == pytest.approx(
        images(WATER_DISC, whole, scanner, 7)[5:8], abs=0.01
    )


@few_and_others("tilt_deg", [12.0], [0.0])
def test_a_cropped_scan_shows_the_same_voxels(tilt_deg: float) -> None:
    scene = Scene((*WATER_DISC.parts, Part(sphere((30, -20, 3), 11.5), "acrylic")))
    whole = axial_stack(start_mm=-6, stop_mm=12, spacing_mm=3, matrix=100, field_of_view_mm=150, tilt_deg=tilt_deg)
    crop = whole.around((30, -20, 3), 9.5, crop=True)
    assert max(crop.rows, crop.columns) <= 15
    assert crop.holds_whole(np.array([30.0, -20, 3]), 11.5)
    everywhere, wanted = places(whole).reshape(-1, 3), places(crop).reshape(-1, 3)
    nearest = cKDTree(everywhere).query(wanted)[1]
    assert everywhere[nearest] == pytest.approx(wanted, abs=1e-9)
    assert images(scene, crop, FEW_VIEWS).ravel() == pytest.approx(
        images(scene, whole, FEW_VIEWS).ravel()[nearest], abs=0.5
    )


def test_overlapping_slices_share_detector_rows() -> None:
    stack = axial_stack(start_mm=0, stop_mm=9, spacing_mm=1.0, thickness_mm=2.0)
    assert rows_per_slice(stack) == 4
    assert rows_per_slice(axial_stack(start_mm=0, stop_mm=9, spacing_mm=0.6)) == 1


def test_a_scanner_of_one_row_sums_before_the_logarithm() -> None:
    """Water to the middle of a slice: half of it if the rows' logarithms are summed, less if what they receive is."""
    scene = Scene((Part(cylinder((0, 0, 0), (0, 0, 1), 60, 40), "water"),))
    stack = axial_stack(start_mm=0, stop_mm=0, spacing_mm=3, matrix=100, field_of_view_mm=150)
    several, one = (images(scene, stack, Scanner(dose=0.0, one_row=is_one))[0] for is_one in (False, True))
    assert several[50, 45:55].mean() == pytest.approx(-500, abs=2)
    chords_mm = 2 * np.sqrt(np.maximum(20.0**2 - np.arange(-40.0, 41.0) ** 2, 0))
    told_mm = -np.log((1 + np.exp(-0.0195 * chords_mm)) / 2) / 0.0195
    expected = iradon(np.repeat(told_mm[:, np.newaxis], 180, axis=1), np.arange(180.0), circle=False)
    middle = len(expected) // 2
    assert one[50, 45:55].mean() == pytest.approx(
        1000 * (expected[middle, middle - 3 : middle + 4].mean() - 1), abs=25
    )


def test_a_half_space_fills_the_bore_up_to_its_face() -> None:
    scene = Scene((Part(half_space((0, 20, 0), (0, -1, 0)), "water"),))
    stack = axial_stack(start_mm=0, stop_mm=0, matrix=100, field_of_view_mm=100)
    image = images(scene, stack)[0]
    assert image[:60, 30:70].mean() == pytest.approx(-1000, abs=12)
    assert image[80:, 30:70].mean() == pytest.approx(0, abs=12)


def test_metal_is_clipped_unless_the_scale_is_extended() -> None:
    scene = Scene((Part(sphere((0, 0, 0), 6), "titanium"),))
    stack = axial_stack(start_mm=0, stop_mm=0, matrix=64, field_of_view_mm=30)
    assert Examination(scene, stack, QUIET).images().max() == 3071
    assert Examination(scene, stack, Scanner(dose=0, extended_scale=True)).images().max() > 8000


def test_metal_gives_streaks_and_scatter_gives_cupping() -> None:
    rods = [Part(cylinder((x, 0, -20), (0, 0, 1), 40, 8), "steel") for x in (-30, 30)]
    disc = Scene((*WATER_DISC.parts, *rods))
    stack = axial_stack(start_mm=0, stop_mm=0, matrix=128, field_of_view_mm=210)
    with_metal = images(disc, stack)[0]
    assert with_metal[62:66, 56:72].mean() < -100  # the dark band between two metals
    scattered = images(WATER_DISC, stack, Scanner(dose=0, scatter=0.03))[0]
    assert scattered[60:68, 60:68].mean() < scattered[60:68, 8:12].mean() - 5


def test_a_box_and_a_disc_attenuate_as_long_as_they_are() -> None:
    slab = Scene((Part(box((0, 0, 0), (60, 60, 60)), "water"),))
    stack = axial_stack(start_mm=0, stop_mm=0, matrix=64, field_of_view_mm=100)
    image = images(slab, stack)[0] + 1000
    assert image.sum() * stack.pixel_mm**2 == pytest.approx(1000 * 60 * 60, rel=0.01)


@pytest.mark.parametrize(
    "wrong", [{"kernel": "sharp"}, {"dose": -1.0}, {"views": 2}, {"bin_mm": 0.0}, {"scatter": 2.0}]
)
def test_an_impossible_scanner_is_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(PhantomError, match="expected"):
        Scanner(**wrong)  # type: ignore[arg-type]
