"""Stereo re-localization under real light: limbs as dark as the ground, lamps aside, parts of the outline hidden."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from phantoms.stereo_kinds import SCENES
from phantoms.stereo_scenes import random_rig, render
from ronnaplan.errors import InputError, RefusedError
from ronnaplan.geometry import rms_mm
from ronnaplan.robot.stereo.sphere import locate_sphere
from tests.long import few_and_others, few_or_all
from tests.robot.stereo.stereo_views import DIAMETER, calibrated, normalized_error, rendered


def test_a_limb_as_dark_as_the_ground_is_measured_where_the_lamps_are_at_the_lenses() -> None:
    """Fitted edge by edge, the first is 0.055 mm off; the second is refused where no ball is held to be even."""
    for seed in (17, 2019):
        view, rig = rendered("limb darkens as the cosine", seed)
        found = locate_sphere(view.left, view.right, rig, diameter_mm=DIAMETER, largest_mm=0.0125)
        assert np.linalg.norm(found.position_mm - view.center_mm) < 0.01


@few_and_others("seed", [2], [1])
def test_a_ball_lit_from_aside_is_measured_as_one_in_its_own_shadow(seed: int) -> None:
    """Without it in the model, what is found is 0.02 and 0.065 mm off, and refused."""
    view, rig = rendered("lit from aside", seed)
    found = locate_sphere(view.left, view.right, rig, diameter_mm=DIAMETER, largest_mm=0.014)
    assert np.linalg.norm(found.position_mm - view.center_mm) < 0.01
    assert normalized_error(found, view.center_mm) < 4


@few_and_others("power", [0.2], [0.4])
def test_a_ball_that_hardly_darkens_to_its_limb_needs_no_light_told_well(power: float) -> None:
    """Where light from aside was taken for as much as its noise, what its shadow may do was stated as 0.021 mm."""
    even = replace(SCENES[0], shading="lamp", beside=(0.0, 0.0), power=power)
    rng = np.random.default_rng(97004)
    drawn = random_rig(rng)
    view = render(even, drawn, rng)
    found = locate_sphere(view.left, view.right, calibrated(drawn), diameter_mm=DIAMETER)
    assert np.linalg.norm(found.position_mm - view.center_mm) < 0.006


@few_and_others("seed", [2], [1, 3])
def test_what_leaves_more_than_the_noise_of_pixels_counts_as_more(seed: int) -> None:
    """Compression makes that smoother, so that pixels tell less than as many of other noise would."""
    view, rig = rendered("evenly bright", seed)
    plain = view.left.astype(np.uint8), view.right.astype(np.uint8)
    stated_mm = [
        float(rms_mm(locate_sphere(left, right, rig, diameter_mm=DIAMETER).covariance_mm2))
        for left, right in (plain, (compressed(plain[0]), compressed(plain[1])))
    ]
    assert stated_mm[1] > 1.4 * stated_mm[0]


def compressed(grey: np.ndarray) -> np.ndarray:
    """Return an image (rows, columns; uint8) as JPEG of quality 75 keeps it."""
    kept = cv2.imencode(".jpg", grey, [cv2.IMWRITE_JPEG_QUALITY, 75])[1]
    return np.asarray(cv2.imdecode(kept, cv2.IMREAD_GRAYSCALE))


@few_and_others(
    ("name", "seed"),
    [("cable across", 2), ("highlight in the middle", 2)],
    [("cable across", 1), ("cable across", 4), ("highlight in the middle", 3)],
)
def test_what_spoils_the_middle_of_a_ball_does_not_keep_its_rim_from_being_measured(name: str, seed: int) -> None:
    """By the whole of it no outline is found in one image at least."""
    view, rig = rendered(name, seed)
    found = locate_sphere(view.left, view.right, rig, diameter_mm=DIAMETER)
    assert np.linalg.norm(found.position_mm - view.center_mm) < 0.01
    assert normalized_error(found, view.center_mm) < 4


@few_and_others("seed", [4], [8, 13])
def test_a_highlight_that_a_ball_takes_for_its_noise_does_not_keep_its_rim_from_being_measured(seed: int) -> None:
    """By the whole of it the limb is dark in one image, and the center stated as 0.1 to 0.2 mm off."""
    view, rig = rendered("highlight in the middle", seed)
    found = locate_sphere(view.left, view.right, rig, diameter_mm=DIAMETER)
    assert np.linalg.norm(found.position_mm - view.center_mm) < 0.01
    assert normalized_error(found, view.center_mm) < 4


def test_a_highlight_does_not_make_an_uneven_ball_with_a_dark_limb_one_that_is_told_by_its_rim() -> None:
    """By its rim, as that of an even ball elsewhere, it was accepted 0.02 mm off, 0.01 stated."""
    glossy = next(one for one in SCENES if one.name == "highlight in the middle")
    uneven = replace(glossy, shading="lamp", beside=(0.0, 1.0), fall=(0.0, 0.1), gloss=(0.2, 0.6))
    rng = np.random.default_rng([3, 77])
    drawn = random_rig(rng)
    view = render(uneven, drawn, rng)
    with pytest.raises(InputError, match="no sphere"):
        locate_sphere(view.left, view.right, calibrated(drawn), diameter_mm=DIAMETER)


@few_and_others("name", ["flat disc, cable across"], ["half hidden, highlight"])
def test_a_clean_part_of_a_rim_makes_no_ball_of_what_is_none(name: str) -> None:
    for seed in (1, 2):
        view, rig = rendered(name, seed)
        with pytest.raises(InputError, match="no sphere"):
            locate_sphere(view.left, view.right, rig, diameter_mm=DIAMETER)


def dusty(grey: np.ndarray, rng: np.random.Generator, specks: int = 8) -> np.ndarray:
    """Return an image with blurred specks of 3 to 8 pixels all over the ball, the brightest thing in it."""
    ball = np.argwhere(gaussian_filter(grey.astype(float), 2.0) > grey.max() / 2)
    middle, radius = ball.mean(axis=0), np.sqrt(len(ball) / np.pi)
    rows, columns = np.indices(grey.shape)
    dust = np.zeros(grey.shape)
    for turn, away in zip(rng.uniform(0, 2 * np.pi, specks), np.sqrt(rng.uniform(0.1, 0.7, specks)), strict=True):
        row, column = middle + away * radius * np.array([np.sin(turn), np.cos(turn)])
        dust[np.hypot(rows - row, columns - column) < rng.uniform(1.5, 4.0)] = rng.uniform(0.2, 0.7)
    return np.rint(grey * (1 - gaussian_filter(dust, 1.0))).astype(grey.dtype)


@few_and_others("seed", [2], [3, 4])
def test_dust_all_over_a_ball_does_not_keep_it_from_being_measured(seed: int) -> None:
    """No sector is without a speck; by the whole of it and by its rim no outline is found."""
    view, rig = rendered("gradient 20 %", seed)
    rng = np.random.default_rng(seed)
    found = locate_sphere(dusty(view.left, rng), dusty(view.right, rng), rig, diameter_mm=DIAMETER)
    assert np.linalg.norm(found.position_mm - view.center_mm) < 0.01
    assert normalized_error(found, view.center_mm) < 4


@few_or_all("seeds", (1,), (1, 2))
@few_and_others("name", ["flat disc"], ["half hidden", "20 % smaller"])
def test_dust_makes_no_ball_of_what_is_none(name: str, seeds: tuple[int, ...]) -> None:
    for seed in seeds:
        view, rig = rendered(name, seed)
        rng = np.random.default_rng(seed)
        with pytest.raises(InputError, match="no sphere"):
            locate_sphere(dusty(view.left, rng), dusty(view.right, rng), rig, diameter_mm=DIAMETER)


def test_an_outline_that_turns_out_to_be_well_beside_its_edges_is_looked_for_there() -> None:
    """The limb is dark and a fifth of it hidden: edges agree on a circle that is 10 pixels too small and 8 aside."""
    view, rig = rendered("cosine, uneven and hidden", 4)
    found = locate_sphere(view.left, view.right, rig, diameter_mm=DIAMETER, largest_mm=0.05)
    assert np.linalg.norm(found.position_mm - view.center_mm) < 0.02


def test_a_part_of_the_outline_that_fits_now_and_then_does_not_keep_the_sphere_from_being_found() -> None:
    view, rig = rendered("cosine, uneven and hidden", 8)
    found = locate_sphere(view.left, view.right, rig, diameter_mm=DIAMETER)
    assert np.linalg.norm(found.position_mm - view.center_mm) < 0.02


@few_and_others(
    ("name", "seed", "before_mm"),
    [
        ("dim beside reflections", 132, 0.017),  # pixels of the ground, which its own level is told by, 6 px wide
        ("cosine, slightly uneven", 35, 0.0146),  # each image's unevenness by itself
    ],
    [
        ("25-33 % hidden", 83, 0.027),  # waves on a part of the outline as if they were told apart
    ],
)
def test_what_the_images_tell_is_used(name: str, seed: int, before_mm: float) -> None:
    """Each was stated to err by ``before_mm`` where that was not."""
    view, rig = rendered(name, seed)
    found = locate_sphere(view.left, view.right, rig, diameter_mm=DIAMETER, largest_mm=before_mm)
    assert np.sqrt(np.trace(found.covariance_mm2)) < 0.8 * before_mm
    assert np.linalg.norm(found.position_mm - view.center_mm) < 0.02
    assert normalized_error(found, view.center_mm) < 3


def test_a_limb_as_dark_as_the_ground_is_refused_where_the_lamps_may_be_anywhere() -> None:
    view, rig = rendered("limb darkens as the cosine", 4018)
    with pytest.raises(RefusedError, match=r"mm only; expected 0\.012 mm or less"):
        locate_sphere(view.left, view.right, rig, diameter_mm=DIAMETER, lamp_sd_deg=0.5)
    known = locate_sphere(view.left, view.right, rig, diameter_mm=DIAMETER, lamp_sd_deg=0.5, largest_mm=0.5)
    stated_mm = np.sqrt(np.trace(known.covariance_mm2))
    assert 0.012 < stated_mm < 0.5
    assert np.linalg.norm(known.position_mm - view.center_mm) < 4 * stated_mm


def test_a_lamp_well_beside_the_lens_is_noticed() -> None:
    """As if it were at the lens, the center would be 0.1 mm off, and said to be known well."""
    view, rig = rendered("lamp 2 to 10 degrees beside", 0)
    with pytest.raises(RefusedError, match=r"mm only; expected 0\.012 mm or less"):
        locate_sphere(view.left, view.right, rig, diameter_mm=DIAMETER)


@few_and_others("seed", [3], [4000])
def test_a_lamp_a_degree_beside_the_lens_is_stated_in_the_error(seed: int) -> None:
    """Taken to be at the lens, the normalized error of the first is 21.

    That of the second is 13 where each image is judged by itself and all unevenness is as likely, 3.5 where balls are
    not held to be even, and 2.2 where the lines of sight need not meet.
    """
    view, rig = rendered("lamp 1 degree beside the lens", seed)
    found = locate_sphere(view.left, view.right, rig, diameter_mm=DIAMETER, largest_mm=0.5)
    assert normalized_error(found, view.center_mm) < 2


@few_and_others("seed", [9], [23, 25])
def test_light_from_aside_falls_off_to_the_limb_as_the_sphere_darkens(seed: int) -> None:
    """Held to be even, it was 0.093, 0.023 and 0.039 mm off, stated as 0.009 at most, and accepted."""
    view, rig = rendered("cosine to 2, lamp beside", seed)
    found = locate_sphere(view.left, view.right, rig, diameter_mm=DIAMETER, largest_mm=0.5)
    assert normalized_error(found, view.center_mm) < 3
