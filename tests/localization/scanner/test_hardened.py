"""What a head does to the image of a ball beside it is made good, in scans by rays that share nothing with phantoms."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.ndimage import uniform_filter1d

from ronnaplan.ct import CTVolume, SliceGrid
from ronnaplan.geometry import FloatArray
from ronnaplan.localization.build import SOLID, Build
from ronnaplan.localization.examine import fit_place
from ronnaplan.localization.fit.ball_fit import BallFit
from ronnaplan.localization.fit.model import has_streaks
from ronnaplan.localization.fit.parameters import W
from ronnaplan.localization.scanner.beside import Beside, all_beside
from ronnaplan.localization.scanner.hardened import APERTURE_MM2, ROW_MM2, MadeGood, pictures_hu
from ronnaplan.localization.scanner.scan import Scan
from ronnaplan.localization.scanner.summed import WATER_PER_MM

CENTER_MM, RADIUS_MM = np.array([0.13, 66.21, 0.17]), 4.0
HEAD_MM, POST_MM = 45.0, 3.0
"""Radii of the head, a cylinder of water about the z-axis, and of the post from it to the ball, along y."""

WATER_PER_MM_AT, GLASS_PER_MM_AT = np.array([0.025, 0.017]), np.array([0.115, 0.052])
"""What water and glass take at two energies of equal strength, of a mm."""

WALL_MM = 1.0
"""How thick a hollow ball's wall is."""

CLIPPED_HU = np.int16(2600)
"""Where a scale ends, just below the ball of glass."""

ONE_ENERGY = np.array([0.02])

RAY_MM, COARSE_RAY_MM, VIEWS, BLUR_MM = 0.05, 0.1, 120, 0.45
PIXEL_MM, NEAR_MM, SEEN_MM = 0.4, 9.2, 80.0
HEIGHTS_MM = np.linspace(-5.6, 5.6, 15)


def in_disc(from_middle_mm: FloatArray, square_mm2: float) -> FloatArray:
    """Lengths of rays in a disc."""
    lengths_mm: FloatArray = 2.0 * np.sqrt(np.maximum(square_mm2 - from_middle_mm**2, 0.0))
    return lengths_mm


def in_post(angle: float, across_mm: FloatArray, half_mm: float) -> FloatArray:
    """Lengths of rays in a strip from the head to the ball."""
    last_y_mm = CENTER_MM[1] - RADIUS_MM
    first_mm, last_mm = np.full(len(across_mm), -1e6), np.full(len(across_mm), 1e6)
    for along, slope, middle_mm, half in (
        (across_mm * np.cos(angle), -np.sin(angle), CENTER_MM[0], half_mm),
        (across_mm * np.sin(angle), np.cos(angle), (HEAD_MM + last_y_mm) / 2, (last_y_mm - HEAD_MM) / 2),
    ):
        ends = (middle_mm + np.array([[-half], [half]]) - along) / slope
        first_mm, last_mm = np.maximum(first_mm, ends.min(axis=0)), np.minimum(last_mm, ends.max(axis=0))
    lengths_mm: FloatArray = np.maximum(last_mm - first_mm, 0.0)
    return lengths_mm


def scanned(
    ball: FloatArray,
    water: FloatArray,
    cell_mm: float,
    *,
    head_mm: float = HEAD_MM,
    post_mm: float = POST_MM,
    row_mm: float = 0.0,
    taper: float = 0.0,
    cavity_mm: float = 0.0,
    scatter: float = 0.0,
    ray_mm: float = RAY_MM,
    views: int = VIEWS,
    heights_mm: FloatArray = HEIGHTS_MM,
) -> CTVolume:
    """Scan a ball on its post beside a head by parallel rays in cells so wide; water is corrected for.

    ``ball`` (E,) and ``water`` (E,) say what they take of a mm at each energy, ``row_mm`` how high a row of cells is,
    ``taper`` by how much the head becomes narrower for each mm of height, ``cavity_mm`` the radius of what is hollow,
    ``scatter`` what cells receive beside primary rays, as a share of what arrives without a head.

    Only near the ball the image is reconstructed, elsewhere it is as it should be.
    """
    across_mm = np.arange(-SEEN_MM, SEEN_MM, ray_mm)
    angles = (np.arange(views) + 0.5) * np.pi / views
    depths_mm = np.linspace(0.0, 150.0, 600)
    of_water = -np.log(np.exp(-np.outer(depths_mm, water)).mean(axis=1))
    frequencies = np.fft.rfftfreq(2 * len(across_mm), ray_mm)
    passed = frequencies * np.exp(-0.5 * (2.0 * np.pi * frequencies * BLUR_MM) ** 2)
    places_mm = np.arange(-SEEN_MM, SEEN_MM, PIXEL_MM)
    x, y = np.meshgrid(places_mm, places_mm)
    is_near = np.hypot(x - CENTER_MM[0], y - CENTER_MM[1]) < NEAR_MM
    pictures_hu = []
    nodes, weights = np.polynomial.legendre.leggauss(4) if row_mm else (np.zeros(1), np.full(1, 2.0))
    for height_mm in heights_mm - CENTER_MM[2]:
        near_mm = np.zeros(np.count_nonzero(is_near))
        rows_mm = height_mm + row_mm / 2.0 * nodes
        by_head = [  # from all sides alike
            np.exp(-np.outer(in_disc(across_mm, (head_mm - taper * within_mm) ** 2), water))
            for within_mm in rows_mm
        ]
        for angle in angles:
            turned = np.array([np.cos(angle), np.sin(angle)])
            beside_mm = across_mm - CENTER_MM[:2] @ turned
            meets = slice(*np.searchsorted(beside_mm, [-RADIUS_MM, RADIUS_MM]))
            arrives = np.full(len(across_mm), scatter)
            for within_mm, weight, left in zip(rows_mm, weights / 2.0, by_head, strict=True):
                half_mm = np.sqrt(max(post_mm**2 - within_mm**2, 0.0))
                passes = left.copy()
                in_wall_mm = in_disc(beside_mm[meets], RADIUS_MM**2 - within_mm**2)
                in_wall_mm -= in_disc(beside_mm[meets], cavity_mm**2 - within_mm**2)
                passes[meets] *= np.exp(-np.outer(in_wall_mm, ball))
                if half_mm > 0.0:
                    passes *= np.exp(-np.outer(in_post(angle, across_mm, half_mm), water))
                arrives += weight * passes.mean(axis=1)
            arrives /= 1.0 + scatter  # air is air
            lost_mm = np.interp(
                -np.log(uniform_filter1d(arrives, 2 * int(cell_mm / ray_mm / 2.0) + 1)), of_water, depths_mm
            )
            filtered = np.fft.irfft(np.fft.rfft(lost_mm, 2 * len(lost_mm)) * passed)[: len(lost_mm)]
            near_mm += np.interp(x[is_near] * turned[0] + y[is_near] * turned[1], across_mm, filtered)
        picture_hu = np.where(np.hypot(x, y) < head_mm - taper * height_mm, 0.0, -1000.0)
        picture_hu[is_near] = 1000.0 * near_mm * np.pi / views - 1000.0
        pictures_hu.append(np.clip(picture_hu, -1024, 30000))
    origins_mm = np.array([[-SEEN_MM, -SEEN_MM, height] for height in heights_mm])
    spacing_mm = float(heights_mm[1] - heights_mm[0])
    grid = SliceGrid(origins_mm, np.array([0.0, PIXEL_MM, 0.0]), np.array([PIXEL_MM, 0.0, 0.0]), spacing_mm)
    return CTVolume(np.round(pictures_hu).astype(np.int16), grid)


@pytest.fixture(scope="module")
def by_two_energies() -> CTVolume:
    """A dense ball on its post, beside a head that hardens its rays."""
    return scanned(GLASS_PER_MM_AT, WATER_PER_MM_AT, 0.5, ray_mm=COARSE_RAY_MM)


@pytest.fixture(scope="module")
def by_one_energy() -> CTVolume:
    """No rays are hardened here, and there is no post, but cells add up what the localizer believes."""
    return scanned(3.0 * ONE_ENERGY, ONE_ENERGY, float(np.sqrt(12.0 * APERTURE_MM2)), post_mm=0.0)


def fitted(volume: CTVolume, made_good: MadeGood = MadeGood.ALL, build: Build = SOLID) -> BallFit:
    fit = fit_place(Scan(volume), CENTER_MM + np.array([0.1, -0.1, 0.05]), 2.0 * RADIUS_MM, build, made_good)
    assert fit.converged
    return fit


def untouched(volume: CTVolume) -> BallFit:
    """The fit without what is made good."""
    return fitted(volume, MadeGood.NOTHING)


def pulled_mm(fit: BallFit) -> float:
    """How far the center lies from where it should be, towards the head."""
    return float(CENTER_MM[1] - fit.center_mm[1])


def test_a_dense_ball_on_a_post_is_not_pulled_to_the_head_that_hardens_its_rays(by_two_energies: CTVolume) -> None:
    before, after = untouched(by_two_energies), fitted(by_two_energies)
    assert pulled_mm(before) > 0.008
    assert abs(pulled_mm(after)) < 0.35 * pulled_mm(before)
    assert after.misfit < before.misfit
    assert before.made_good_mm is None
    assert after.made_good_mm == pytest.approx(after.center_mm - before.center_mm, abs=1e-12)


def test_a_hollow_ball_is_seen_as_round_as_it_is_beside_a_head_that_hardens_its_rays() -> None:
    volume = scanned(
        GLASS_PER_MM_AT,
        WATER_PER_MM_AT,
        0.5,
        post_mm=0.0,
        cavity_mm=RADIUS_MM - WALL_MM,
        ray_mm=COARSE_RAY_MM,
        heights_mm=np.linspace(-5.6, 5.6, 9),
    )
    hollow = Build.parse(f"shell:{WALL_MM:g}")
    before, after = fitted(volume, MadeGood.NOTHING, hollow), fitted(volume, build=hollow)
    assert before.misfit > 0.008
    assert after.misfit < 0.25 * before.misfit
    assert abs(pulled_mm(after)) < 0.001


def test_a_ball_of_ceramic_that_the_scale_clips_is_not_pulled_either(by_two_energies: CTVolume) -> None:
    """It is looked for as if it were metal: how bright it is, is told by the fit alone."""
    clipped = replace(by_two_energies, voxels_hu=np.minimum(by_two_energies.voxels_hu, CLIPPED_HU))
    before, after = untouched(clipped), fitted(clipped)
    assert has_streaks(before.theta)
    assert before.is_clipped
    assert pulled_mm(before) > 0.005
    assert abs(pulled_mm(after)) < 0.6 * pulled_mm(before)


def test_what_rays_lose_is_told_whatever_scale_air_begins_at(by_one_energy: CTVolume) -> None:
    elsewhere = replace(by_one_energy, voxels_hu=by_one_energy.voxels_hu + np.int16(200))
    one, other = (all_beside(volume, fitted(volume)).losses for volume in (by_one_energy, elsewhere))
    assert other == pytest.approx(one, abs=0.15)


def test_what_cells_add_up_before_the_logarithm_is_made_good(by_one_energy: CTVolume) -> None:
    """Radon (1917): the mean slope of the head's shadow is that of 1 / distance, summed over the head."""
    x, y = np.meshgrid(np.arange(-45.0, 45.0, 0.25), np.arange(-45.0, 45.0, 0.25))
    head_mm = np.stack([x, y])[:, np.hypot(x, y) < HEAD_MM] - CENTER_MM[:2, np.newaxis]
    slope_per_mm = ONE_ENERGY[0] / np.pi * float(np.sum(-head_mm[1] / np.hypot(*head_mm) ** 3)) * 0.25**2
    pull_mm = 2.0 * APERTURE_MM2 * slope_per_mm
    assert pulled_mm(untouched(by_one_energy)) == pytest.approx(pull_mm, rel=0.2)
    assert pulled_mm(fitted(by_one_energy)) == pytest.approx(0.0, abs=0.3 * pull_mm)


def test_what_a_row_adds_up_before_the_logarithm_is_made_good_across_the_slices() -> None:
    """Of a head that becomes narrower upwards rays lose more in a row's lower half; its shadow's slope is Radon's."""
    row_mm, taper = float(np.sqrt(12.0 * ROW_MM2)), 0.8
    places = np.stack(np.meshgrid(np.arange(-55.0, 55.0, 0.25), np.arange(-55.0, 55.0, 0.25)))
    from_ball_mm = np.hypot(*(places - CENTER_MM[:2, np.newaxis, np.newaxis]))
    above, below = (
        float(np.sum((np.hypot(*places) < HEAD_MM - taper * height_mm) / from_ball_mm))
        for height_mm in (4.0, -4.0)
    )
    pull_mm = ROW_MM2 * ONE_ENERGY[0] / np.pi * (below - above) * 0.25**2 / 8.0
    heights_mm = []
    for way in (taper, -taper):  # what slices as thick as this do to any ball is the same for both
        volume = scanned(
            3.0 * ONE_ENERGY,
            ONE_ENERGY,
            0.0,
            post_mm=0.0,
            row_mm=row_mm,
            taper=way,
            ray_mm=COARSE_RAY_MM,
            views=180,
        )
        heights_mm.append([fit.center_mm[2] for fit in (untouched(volume), fitted(volume))])
    before_mm, after_mm = (np.array(heights_mm[1]) - heights_mm[0]) / 2.0
    assert before_mm == pytest.approx(pull_mm, rel=0.4)
    assert after_mm == pytest.approx(0.0, abs=0.25 * pull_mm)


def test_without_a_head_beside_it_a_ball_is_fitted_as_ever() -> None:
    volume = scanned(GLASS_PER_MM_AT, WATER_PER_MM_AT, 0.5, head_mm=0.0, ray_mm=COARSE_RAY_MM)
    assert (fitted(volume).theta == untouched(volume).theta).all()
    assert fitted(volume).made_good_mm is None


@cache
def without_a_head() -> CTVolume:
    """A ball of water beside nothing."""
    return scanned(ONE_ENERGY, ONE_ENERGY, 0.0, head_mm=0.0, ray_mm=COARSE_RAY_MM)


@pytest.mark.parametrize("padding_hu", [31744.0, 62512.0], ids=["-32768 unsigned", "-2000 unsigned"])
def test_padding_that_no_tag_tells_is_nothing_that_rays_meet(padding_hu: float) -> None:
    volume = without_a_head()
    shape = volume.voxels_hu.shape[1:]
    far = np.hypot(*(np.indices(shape) - (np.array(shape)[:, np.newaxis, np.newaxis] - 1) / 2)) > shape[0] / 2
    padded = replace(volume, voxels_hu=np.where(far, padding_hu, volume.voxels_hu).astype(np.float32))
    assert far.any()
    assert fitted(padded).center_mm == pytest.approx(fitted(volume).center_mm, abs=1e-4)


def test_what_rays_lose_beside_a_ball_is_what_they_pass_there(by_one_energy: CTVolume) -> None:
    beside = all_beside(by_one_energy, fitted(by_one_energy))
    angles = (np.arange(beside.losses.shape[1]) + 0.5) * np.pi / beside.losses.shape[1]
    middle_mm = np.stack([np.cos(angles), np.sin(angles)]).T @ CENTER_MM[:2]
    expected = in_disc(beside.places_mm + middle_mm[:, np.newaxis], HEAD_MM**2) * WATER_PER_MM
    assert beside.losses == pytest.approx(np.broadcast_to(expected, beside.losses.shape), abs=0.12)


def test_what_is_made_good_does_not_hang_on_the_last_digit_of_where_slices_lie(by_one_energy: CTVolume) -> None:
    fit = untouched(by_one_energy)
    beside = all_beside(by_one_energy, fit)
    heights_mm = np.unique(fit.neighbourhood.offsets_mm[:, W] - fit.theta[W])[::2]  # each other slice lies midway
    growing = np.linspace(1.0, 2.0, len(heights_mm))[:, np.newaxis, np.newaxis] * beside.losses[:1]
    low, high = (
        pictures_hu(Beside(heights_mm + aside_mm, beside.places_mm, growing), fit) for aside_mm in (-1e-9, 1e-9)
    )
    np.testing.assert_allclose(low, high, atol=1e-5)
