"""Noise is measured as it is in the image, and moves the center as stated."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import convolve1d, gaussian_filter

from phantoms.scene import Part, Scene
from phantoms.solids import box, cylinder, sphere
from ronnaplan.ct import CTVolume
from ronnaplan.geometry import FloatArray
from ronnaplan.localization import localize
from ronnaplan.localization.build import Build
from ronnaplan.localization.examine import fit_place
from ronnaplan.localization.fit.ball_fit import BallFit
from ronnaplan.localization.fit.parameters import BLUR, RADIUS, SHAPE, WIDTH, profile_half_mm
from ronnaplan.localization.judge import uncertainty
from ronnaplan.localization.judge.edge import Edge
from ronnaplan.localization.judge.held import held_by, metal_beyond
from ronnaplan.localization.judge.motion import movement
from ronnaplan.localization.judge.noise import noise_level
from ronnaplan.localization.judge.uncertainty import (
    HIDDEN_SHADING,
    LAG_MM,
    POST_PULL_MM,
    ROWS_MM,
    SCREW_PULL_MM,
    by_panel,
    center_covariance,
    cramer_rao_bound,
    lag_mm,
    lagging_mm2,
    larger,
    pulled_mm2,
    shared_noise,
)
from ronnaplan.localization.scanner.scan import Scan
from ronnaplan.localization.scanwide.together import MEDIAN_SHARE, usual_odd_mm2, with_usual
from tests.long import few_and_others, few_or_all
from tests.scans import balls, bent, scan, small_stack

CHI2_95 = 7.81
"""What the square of an error, in its own covariance, stays below in 95 % of cases, in three dimensions."""

POST = Scene((Part(cylinder((1.0, 2.0, 3.0), (0.0, 0.0, -1.0), 14.0, 6.0), "acrylic"),))
SHORT_POST = Scene((Part(cylinder((1.0, 2.0, -2.8), (0.0, 0.0, -1.0), 8.0, 6.0), "acrylic"),))
SCREW = Scene((Part(cylinder((1.0, 2.0, -11.0), (0.0, 0.0, -1.0), 10.0, 3.0), "titanium"),))


def fit_of(volume: CTVolume) -> BallFit:
    return fit_place(Scan(volume), np.array([1.2, 1.9, 2.8]), 11.5)


def with_white_noise(volume: CTVolume, noise_hu: float, seed: int) -> CTVolume:
    noise = np.random.default_rng(seed).normal(0, noise_hu, volume.voxels_hu.shape)
    return replace(volume, voxels_hu=(volume.voxels_hu + noise).astype(np.float32))


def with_grain(volume: CTVolume, noise_hu: float, pixels: int, generator: np.random.Generator) -> CTVolume:
    """Return a scan with noise that is smoothed over so many pixels across each slice."""
    grain = gaussian_filter(generator.normal(0, 1, volume.voxels_hu.shape), (0, pixels, pixels))
    return replace(volume, voxels_hu=(volume.voxels_hu + noise_hu * grain / grain.std()).astype(np.float32))


def small_ball_errors(still: CTVolume, noisy: Iterable[CTVolume]) -> FloatArray:
    """Return the squares of a 5 mm ball's errors by noise, each in its own covariance."""
    place_mm, diameter_mm, squares = np.array([1.0, 2.0, 3.0]), 5.0, []
    still_mm = fit_place(Scan(still), place_mm, diameter_mm).center_mm
    for volume in noisy:
        fit = fit_place(Scan(volume), place_mm, diameter_mm)
        error_mm = fit.center_mm - still_mm
        squares.append(error_mm @ np.linalg.solve(center_covariance(fit, movement(Edge(fit))), error_mm))
    return np.array(squares)


@pytest.fixture(scope="module")
def quiet() -> CTVolume:
    return scan(balls([(1.0, 2.0, 3.0)]), small_stack(), noise_hu=0.0)


def test_what_lies_unevenly_around_a_ball_moves_its_center_as_far_as_is_stated() -> None:
    center, aside, thickness_mm = np.array([1.0, 2.0, 3.0]), np.array([0.2, -0.1, 0.0]), 1.5
    parts = [
        Part(sphere(center + aside, 11.5 + 2 * thickness_mm), "cloth", embedded=True),
        Part(sphere(center, 11.5), "acrylic"),
    ]
    volume = Scan(scan(Scene(tuple(parts)), small_stack(), noise_hu=0.0))
    fit = fit_place(volume, center + 0.2, 11.5, Build(thickness_mm))
    axes = fit.neighbourhood.axes
    stated = axes.T @ fit.center_by_layer @ axes @ (aside / thickness_mm)
    assert np.linalg.norm(stated) > 0.01
    np.testing.assert_allclose(fit.center_mm - center, stated, atol=0.3 * float(np.linalg.norm(stated)))
    error = fit.center_mm - center
    assert error @ np.linalg.solve(center_covariance(fit, movement(Edge(fit))), error) < CHI2_95
    unaware = replace(fit, prior=replace(fit.prior, layer_mm=0.0))
    assert error @ np.linalg.solve(center_covariance(unaware, movement(Edge(fit))), error) > CHI2_95


@pytest.mark.parametrize("denser", [1.0, 5.0], ids=["whole", "clipped"])
@few_and_others("aside", [(0.12, -0.06, 0.0), (0.0, 0.0, 0.0)], [(0.02, 0.03, -0.13)])
def test_a_cavity_that_lies_aside_is_told_or_stated(aside: tuple[float, float, float], denser: float) -> None:
    center = np.array([1.0, 2.0, 3.0])
    parts = [Part(sphere(center, 11.5), "acrylic"), Part(sphere(center + aside, 9.5), "air", embedded=True)]
    seen = scan(Scene(tuple(parts)), small_stack(), noise_hu=0.0)
    noisy = with_white_noise(replace(seen, voxels_hu=(denser * (seen.voxels_hu + 1000.0) - 1000.0)), 5.0, 1)
    volume = replace(noisy, voxels_hu=np.minimum(noisy.voxels_hu, np.float32(3071.0)))
    fit = fit_place(Scan(volume), center + 0.1, 11.5, Build.parse("shell:1"))
    assert fit.converged
    assert fit.is_shaded == (denser == 1.0)
    error = fit.center_mm - center
    assert error @ np.linalg.solve(center_covariance(fit, movement(Edge(fit))), error) < CHI2_95
    if fit.is_shaded:  # one center for both surfaces would lie between theirs
        assert float(np.linalg.norm(error)) < 0.005


@few_or_all("cases", 6, 12)
def test_the_scatter_over_noise_is_at_the_bound_and_within_the_stated_error(quiet: CTVolume, cases: int) -> None:
    fits = [fit_of(with_white_noise(quiet, 80.0, seed)) for seed in range(cases)]
    scatter = np.std([fit.center_mm for fit in fits], axis=0, ddof=1)
    bound = np.sqrt(np.diag(np.mean([cramer_rao_bound(fit, noise_level(fit)) for fit in fits], axis=0)))
    stated = np.sqrt(np.diag(np.mean([center_covariance(fit, movement(Edge(fit))) for fit in fits], axis=0)))
    # Twelve draws know a standard deviation to a fifth; three axes are judged together.
    assert np.sqrt(np.mean((scatter / bound) ** 2)) == pytest.approx(1.0, abs=0.45)
    assert np.sqrt(np.mean((scatter / stated) ** 2)) < 1.2


@few_or_all("cases", 6, 12)
def test_noise_that_is_correlated_within_the_slice_counts_for_what_it_is(quiet: CTVolume, cases: int) -> None:
    generator = np.random.default_rng(3)
    fits = [fit_of(with_grain(quiet, 20.0, 2, generator)) for _ in range(cases)]
    scatter = np.std([fit.center_mm for fit in fits], axis=0, ddof=1)
    stated = np.sqrt(np.diag(np.mean([center_covariance(fit, movement(Edge(fit))) for fit in fits], axis=0)))
    # Counted as if it were white, it would be stated too small by a factor of two to six.
    assert 0.6 < np.sqrt(np.mean((scatter / stated) ** 2)) < 1.4


@few_or_all("cases", 12, 24)
def test_two_or_three_slices_of_a_small_ball_state_its_noise_as_many_would(cases: int) -> None:
    ball = scan(balls([(1.0, 2.0, 3.0)], 5.0), small_stack(thickness_mm=2.5, spacing_mm=2.5), noise_hu=0.0)
    squares = small_ball_errors(ball, (with_white_noise(ball, 25.0, seed) for seed in range(cases)))
    assert np.mean(squares > CHI2_95) < 0.2  # 0.46 while each slice was summed as a whole


@few_or_all("cases", 12, 24)
def test_noise_that_neighbouring_octants_of_a_slice_share_is_stated(cases: int) -> None:
    around = small_stack(
        thickness_mm=0.5, spacing_mm=0.5, start_mm=-5.0, stop_mm=11.0, matrix=64, field_of_view_mm=32.0
    )
    ball = scan(balls([(1.0, 2.0, 3.0)], 5.0), around, noise_hu=0.0)
    noisy = (with_grain(ball, 15.0, 3, np.random.default_rng(seed)) for seed in range(cases))
    assert np.mean(small_ball_errors(ball, noisy)) / 3.0 < 1.9  # 2.35 by octants alone


def test_the_larger_of_two_covariances_is_no_smaller_than_either_in_any_direction() -> None:
    draws = np.random.default_rng(4)
    one, other = (rows.T @ rows for rows in draws.normal(size=(2, 4, 3)))
    both = larger(one, other)
    assert np.linalg.eigvalsh(both - one).min() > -1e-12
    assert np.linalg.eigvalsh(both - other).min() > -1e-12
    np.testing.assert_allclose(larger(one, 4.0 * one), 4.0 * one)
    np.testing.assert_allclose(larger(other, one), both)


@few_or_all("cases", 6, 12)
@pytest.mark.parametrize("across_slices", [(1, 1, 1), (1, -2, 1)], ids=["shared", "alternating"])
def test_noise_of_overlapping_slices_counts_for_what_it_is(across_slices: tuple[int, ...], cases: int) -> None:
    ball = scan(balls([(1.0, 2.0, 3.0)]), small_stack(thickness_mm=1.5, spacing_mm=0.5), noise_hu=0.0)
    generator = np.random.default_rng(3)
    fits = []
    for _ in range(cases):
        noise = convolve1d(generator.normal(0, 1, ball.voxels_hu.shape), across_slices, axis=0)
        noisy = ball.voxels_hu + 80.0 * noise / noise.std()
        fits.append(fit_of(replace(ball, voxels_hu=noisy.astype(np.float32))))
    scatter = np.std([fit.center_mm for fit in fits], axis=0, ddof=1)
    stated = np.sqrt(np.diag(np.mean([center_covariance(fit, movement(Edge(fit))) for fit in fits], axis=0)))
    # Taken as shared, what alternates would be stated too large by a factor of six.
    assert 0.25 < np.sqrt(np.mean((scatter / stated) ** 2)) < 1.4


def on_a_post(toward: tuple[float, float, float]) -> CTVolume:
    post = Scene((Part(cylinder((1.0, 2.0, 3.0), toward, 14.0, 6.0), "acrylic"),))
    return scan(post + balls([(1.0, 2.0, 3.0)]), small_stack(), seed=2)


def test_an_outline_that_is_bent_oddly_adds_error_within_the_slices(quiet: CTVolume) -> None:
    noisy = with_white_noise(quiet, 10.0, 1)
    fits = [fit_of(volume) for volume in (noisy, bent(noisy, "third cos", 0.02))]
    straight, curved = (np.sqrt(np.diag(center_covariance(fit, movement(Edge(fit))))) for fit in fits)
    # The mean square of four harmonics, one of which is 20 um.
    assert np.allclose(curved[:2], 0.02 / 2 * np.sqrt(uncertainty.WEIGHTS["odd"]), rtol=0.35)
    assert curved[2] < 1.5 * straight[2]


def test_what_bends_the_other_markers_of_a_scan_counts_in_each_of_them(quiet: CTVolume) -> None:
    noisy = with_white_noise(quiet, 10.0, 1)
    straight, curved = (movement(Edge(fit_of(volume))) for volume in (noisy, bent(noisy, "third cos", 0.02)))
    usual_mm2 = usual_odd_mm2([straight, curved, curved])
    assert usual_mm2 is not None
    assert usual_odd_mm2([straight, curved]) is None
    own = center_covariance(fit_of(noisy), straight)
    turned = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])  # u, v, w along y, z, x
    added = with_usual(own, straight, usual_mm2[0], turned) - own
    expected = uncertainty.WEIGHTS["odd"] * (curved.odd_mm2 / MEDIAN_SHARE - straight.odd_mm2) / 2
    assert np.allclose(added, turned.T @ np.diag(expected) @ turned)


def test_what_bends_the_markers_of_a_cone_beam_counts_at_their_height(quiet: CTVolume) -> None:
    noisy = with_white_noise(quiet, 10.0, 1)
    straight, curved = (movement(Edge(fit_of(volume))) for volume in (noisy, bent(noisy, "third cos", 0.02)))
    heights_mm = np.array([0.0, 100.0, 10.0, 110.0, 20.0, 120.0, 30.0, 130.0, 40.0, 140.0, 45.0, 50.0])
    movements = [*[straight, curved] * 5, straight, straight]
    usual_mm2 = usual_odd_mm2(movements, heights_mm)
    everywhere_mm2 = usual_odd_mm2(movements)
    assert usual_mm2 is not None
    assert everywhere_mm2 is not None
    assert np.allclose(usual_mm2[1::2][:5, :2], curved.odd_mm2[:2])
    assert np.allclose(usual_mm2[::2], everywhere_mm2[::2])  # no less than in the whole scan
    assert np.all(everywhere_mm2[:, :2] < curved.odd_mm2[:2] / 2)


def test_a_ball_whose_shading_is_hidden_is_less_certain(quiet: CTVolume) -> None:
    fit = fit_of(with_white_noise(quiet, 10.0, 1))
    hidden = replace(fit, is_shaded=False)
    stated, more = (center_covariance(one, movement(Edge(one))) for one in (fit, hidden))
    assert np.allclose(more - stated, (HIDDEN_SHADING * fit.theta[RADIUS]) ** 2 * np.eye(3))


def test_what_touches_the_ball_makes_it_less_certain() -> None:
    free, held = (
        fit_of(scan(scene, small_stack(), seed=2)) for scene in (balls([(1, 2, 3)]), POST + balls([(1, 2, 3)]))
    )
    assert held.coverage < free.coverage
    assert np.trace(center_covariance(held, movement(Edge(held)))) > np.trace(
        center_covariance(free, movement(Edge(free)))
    )


def test_a_diameter_that_is_hardly_off_is_stated_where_one_side_of_a_ball_is_hidden(quiet: CTVolume) -> None:
    """A center that only the far side tells moves with the radius: 0.04 mm wider, it lies 0.02 to 0.03 aside."""
    face = Scene((Part(box((1.0, 2.0, -7.0), (30.0, 30.0, 8.0)), "aluminium"),))  # 0.25 mm beneath the ball
    on_it = scan(face + balls([(1, 2, 3)]), small_stack(), seed=2)
    for volume, at_least_mm, at_most_mm in ((quiet, 0.0, 0.003), (on_it, 0.015, 0.03)):
        fit = fit_of(volume)
        as_stated, off = (center_covariance(fit, movement(Edge(fit)), excess_mm=by_mm) for by_mm in (0.0, 0.04))
        assert at_least_mm <= math.sqrt(off[2, 2] - as_stated[2, 2]) < at_most_mm
        assert math.sqrt(off[0, 0] - as_stated[0, 0]) < 0.003


def test_a_bell_no_wider_than_the_blur_within_slices_adds_what_a_lagging_panel_may_displace(
    quiet: CTVolume,
) -> None:
    fit = fit_of(with_white_noise(quiet, 10.0, 1))

    def stated(shape: float, blur_mm: float) -> FloatArray:
        theta = fit.theta.copy()
        theta[[SHAPE, WIDTH, BLUR]] = shape, 2.0, blur_mm  # 0.58 mm across
        return lagging_mm2(by_panel(theta), LAG_MM, np.eye(3))

    assert np.allclose(stated(5.0, 0.7), LAG_MM**2 * np.diag([1.0, 1.0, 0.0]))
    assert np.allclose(stated(5.0, 0.3), 0.0, atol=0.1 * LAG_MM**2)
    assert np.allclose(stated(0.0, 0.7), 0.0)


@pytest.mark.parametrize(
    ("pixel_mm", "gap_mm", "expected_mm"),
    [(0.3, 0.3, LAG_MM), (0.415, 0.833, LAG_MM), (0.25, 0.2, ROWS_MM), (0.53, 0.7, ROWS_MM), (0.5, 1.5, ROWS_MM)],
)
def test_only_voxels_that_are_cubes_or_pairs_of_them_are_taken_for_a_lagging_panels(
    pixel_mm: float, gap_mm: float, expected_mm: float
) -> None:
    """Helices, wide cones and photon counting blur alike in all directions, too, but do not lag."""
    voxels = CTVolume.from_array(np.zeros((4, 5, 6), np.int16), np.diag([gap_mm, pixel_mm, pixel_mm, 1.0]))
    assert lag_mm(voxels.grid) == expected_mm


@pytest.mark.parametrize("shape", [0.0, 1.0, 4.0])
def test_slices_share_noise_as_filtered_noise_does(shape: float) -> None:
    width_mm, step_mm = 2.4, 0.05
    half_mm = profile_half_mm(width_mm, shape)
    along_mm = np.arange(-half_mm, half_mm + step_mm / 2, step_mm)
    profile = np.maximum(1.0 - (along_mm / half_mm) ** 2, 0.0) ** shape
    seen = np.convolve(np.random.default_rng(5).normal(0, 1, 400_000), profile, "valid")
    distances_mm = np.array([0.0, 0.5, 1.0, 1.5, 2.5, 4.5])
    measured = [np.corrcoef(seen, np.roll(seen, round(one / step_mm)))[0, 1] for one in distances_mm]
    assert shared_noise(distances_mm, width_mm, shape) == pytest.approx(measured, abs=0.04)


def test_what_holds_a_ball_adds_error_along_it_and_a_screw_adds_more() -> None:
    plastic = on_a_post((0.0, 0.0, -1.0))
    screwed = scan(SCREW + POST + balls([(1.0, 2.0, 3.0)]), small_stack(), seed=2)
    bare = scan(balls([(1.0, 2.0, 3.0)]), small_stack(), seed=2)

    held_mm, screwed_mm, bare_mm = map(stated_mm, (plastic, screwed, bare))
    assert POST_PULL_MM < held_mm[2] < SCREW_PULL_MM < screwed_mm[2]
    assert max(held_mm[:2].max(), screwed_mm[:2].max(), bare_mm.max()) < POST_PULL_MM


def test_a_screw_is_known_where_the_scale_ends_below_metal() -> None:
    whole = scan(SCREW + POST + balls([(1.0, 2.0, 3.0)]), small_stack(), seed=2)
    for top_hu in (3071, 1500, 800):
        cut = replace(whole, voxels_hu=np.minimum(whole.voxels_hu, np.int16(top_hu)))
        assert stated_mm(cut)[2] > SCREW_PULL_MM


def test_what_holds_a_ball_is_sought_where_something_touches_it() -> None:
    place_mm, up = (1.0, 2.0, 3.0), np.array([[0.0, 0.0, 1.0]])
    screwed = scan(SCREW + balls([place_mm]), small_stack(), seed=2)
    fit = fit_of(screwed)

    def held(touching: FloatArray) -> tuple[list[float], bool]:
        axis, is_metal = held_by(metal_beyond(screwed, fit, touching))
        return axis.tolist(), is_metal

    many_up = np.repeat(up, 6, axis=0)
    assert held(many_up) == ([0, 0, 1], False)
    assert held(np.vstack([many_up, -up])) == ([0, 0, -1], True)
    assert held(up) == ([0, 0, 0], False)  # noise
    assert held(np.empty((0, 3))) == ([0, 0, 0], False)


def test_a_bright_ball_is_not_held_by_itself() -> None:
    """Ceramic is as bright as screws are."""
    held_mm = stated_mm(scan(SHORT_POST + balls([(1.0, 2.0, 3.0)], material="ceramic"), small_stack(), seed=2))
    assert POST_PULL_MM < held_mm[2] < SCREW_PULL_MM


@pytest.mark.parametrize(("material", "may_be"), [("acrylic", False), ("ceramic", False), ("titanium", True)])
def test_only_the_brightest_balls_may_be_metal(material: str, may_be: bool) -> None:
    assert fit_of(scan(balls([(1.0, 2.0, 3.0)], material=material), small_stack())).may_be_metal == may_be


def test_of_a_pull_that_is_made_good_a_part_is_stated_but_all_of_a_hollow_balls() -> None:
    fit, up = fit_of(scan(balls([(1.0, 2.0, 3.0)]), small_stack())), np.array([0.0, 0.0, 1.0])
    moved_mm = np.array([0.003, 0.0, -0.010])
    for is_metal in (False, True):
        as_it_was = pulled_mm2(fit, up, is_metal=is_metal)
        left = pulled_mm2(replace(fit, made_good_mm=moved_mm), up, is_metal=is_metal)
        assert left == pytest.approx(0.25 * as_it_was + 0.16 * np.outer(moved_mm, moved_mm))
        hollow = replace(fit, made_good_mm=moved_mm, prior=replace(fit.prior, layer_mm=-1.0))
        left = pulled_mm2(hollow, up, is_metal=is_metal)
        assert left == pytest.approx(as_it_was + 0.16 * np.outer(moved_mm, moved_mm))


def stated_mm(volume: CTVolume) -> FloatArray:
    """Return the standard errors (3,) along x, y and z that are stated for the volume's only ball."""
    (ball,) = localize(volume, diameter_mm=11.5)
    errors_mm: FloatArray = np.sqrt(np.diag(ball.covariance_mm2))
    return errors_mm
