"""Every marker is found where it is, nothing else is, and the stated error is the real one."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.special import chdtri

from phantoms.anatomy import scalp_foot
from phantoms.decoys import DECOYS, decoy
from phantoms.fast import render_hu
from phantoms.markers import marker
from phantoms.scene import Part, Scene
from phantoms.solids import cylinder, ellipsoid, sphere
from ronnaplan.errors import InputError, RefusedError, UsageError
from ronnaplan.localization import FiducialFlag, localize
from tests.long import few_and_others, few_or_all
from tests.scans import balls, on_grid, scan, small_stack

PLACES = [(-14.3, -12.2, -3.1), (13.6, 11.7, 2.4), (15.1, -13.8, 5.3)]


@few_and_others(
    ("geometry", "tolerance_mm"),
    [
        ({"tilt_deg": 20.0}, 0.015),
        ({"orientation": Rotation.from_euler("xyz", [20, -30, 50], degrees=True).as_matrix()}, 0.015),
        ({"positions_mm": tuple(np.cumsum([-20, *[1.0] * 12, *[2.5] * 6, *[1.2] * 10]))}, 0.02),
    ],
    [
        ({}, 0.015),
        ({"spacing_mm": 2.5, "thickness_mm": 2.5}, 0.03),
        ({"spacing_mm": 0.6, "thickness_mm": 1.2}, 0.015),
    ],
    ids=["tilted", "oblique", "uneven", "plain", "thick", "overlapping"],
)
def test_balls_are_found_where_they_are(geometry: dict[str, object], tolerance_mm: float) -> None:
    found = localize(scan(balls(PLACES), small_stack(**geometry)), diameter_mm=11.5, expected=3)
    distances = np.linalg.norm(found.centers[:, np.newaxis] - np.array(PLACES), axis=2)
    assert distances.min(axis=1).max() < tolerance_mm
    assert sorted(distances.argmin(axis=1)) == [0, 1, 2]
    assert [one.diameter_mm for one in found.fiducials] == pytest.approx([11.5] * 3, abs=0.03)


def test_moving_the_frame_moves_the_centers_and_their_covariances() -> None:
    volume = scan(balls(PLACES[:1]), small_stack(), seed=4)
    turn = Rotation.from_euler("zxy", [70, 10, -40], degrees=True).as_matrix()
    shift = np.array([120.0, -40.0, 900.0])
    grid = volume.grid
    moved_grid = dataclasses.replace(
        grid,
        origins_mm=grid.origins_mm @ turn.T + shift,
        row_step_mm=turn @ grid.row_step_mm,
        column_step_mm=turn @ grid.column_step_mm,
    )
    still = localize(volume, diameter_mm=11.5)
    moved = localize(dataclasses.replace(volume, grid=moved_grid), diameter_mm=11.5)
    assert moved.centers == pytest.approx(still.centers @ turn.T + shift, abs=1e-4)
    assert moved.covariances[0] == pytest.approx(turn @ still.covariances[0] @ turn.T, rel=0.02, abs=1e-8)


@few_or_all("cases", 5, 12)
def test_the_stated_error_is_the_real_one(cases: int) -> None:
    squared = []
    for seed in range(cases):
        found = localize(
            scan(balls(PLACES), small_stack(), noise_hu=40.0, seed=seed), diameter_mm=11.5, expected=3
        )
        for center, covariance in zip(found.centers, found.covariances, strict=True):
            error = center - min(PLACES, key=lambda place: float(np.linalg.norm(center - place)))
            squared.append(error @ np.linalg.solve(covariance, error))
    degrees = 3 * len(squared)
    least, most = (chdtri(degrees, beyond) for beyond in (0.9995, 0.0005))  # 0.61 to 1.51 of what is stated
    assert least < np.sum(squared) < most


def test_no_fit_is_better_than_its_bound_and_noise_moves_both() -> None:
    quiet, loud = (
        localize(scan(balls(PLACES[:1]), small_stack(), noise_hu=noise, seed=3), diameter_mm=11.5).fiducials[0]
        for noise in (10.0, 40.0)
    )
    assert 0 < quiet.efficiency < 1
    assert 0 < loud.efficiency < 1
    ratio = np.sqrt(np.trace(loud.bound_mm2) / np.trace(quiet.bound_mm2))
    assert ratio == pytest.approx(4.0, rel=0.25)  # the bound follows the noise


@few_and_others(("odd", "others", "number"), [(0.05, 0.04, 4), (0.05, 0.01, 3)], [(0.08, 0.04, 3)])
def test_what_spoils_every_marker_of_a_scan_speaks_against_none(odd: float, others: float, number: int) -> None:
    shapes = zip([*PLACES, (-13.0, 12.0, 4.0)], [others, others, others, odd], strict=True)
    eggs = [Part(ellipsoid(place, (5.75 * (1 + e), 5.75 * (1 - e), 5.75)), "acrylic") for place, e in shapes]
    assert len(localize(scan(Scene(tuple(eggs)), small_stack()), diameter_mm=11.5)) == number


def test_two_kinds_of_markers_are_found_together() -> None:
    scene = balls(PLACES[:2]) + balls([PLACES[2]], 5.0)
    found = localize(
        scan(scene, small_stack(spacing_mm=0.6, thickness_mm=0.6)), diameter_mm=(11.5, 5.0), expected=3
    )
    sizes = sorted(round(one.diameter_mm, 1) for one in found.fiducials)
    assert sizes == [5.0, 11.5, 11.5]


def test_each_marker_is_one_of_the_size_that_is_nearest_where_two_that_are_stated_may_be_its() -> None:
    """Which of them fitted better was chance: a ball of 6.3 mm was one of 6 mm in a covering, 0.15 mm uncertain."""
    scene = balls([(-18, -9, 0), (16, 10, 4), (0, 14, -8)], 6.0) + balls([(18, -9, 0), (-16, 10, 4)], 6.3)
    found = localize(scan(scene, small_stack()), diameter_mm=(6.0, 6.3), expected=5)
    assert [one.flags for one in found] == [()] * 5
    assert max(one.error_rms_mm for one in found) < 0.02


def test_two_markers_a_millimetre_apart_do_not_pull_at_each_other() -> None:
    places = [(-6.25, 1.0, 0.5), (6.25, 1.0, 0.5)]
    found = localize(scan(balls(places), small_stack()), diameter_mm=11.5, expected=2)
    errors = np.linalg.norm(found.centers[:, np.newaxis] - np.array(places), axis=-1).min(axis=1)
    assert errors.max() < 0.015


def test_a_marker_on_its_post_is_found_and_decoys_are_not() -> None:
    foot = scalp_foot((0.2, 0.1, 1.0), 0.3)
    kinds = [kind for kind in DECOYS if kind != "gas bubble"]
    scene = marker("M1", foot, "post")
    center = scene.markers[0].center_mm
    stack = small_stack(center_mm=tuple(center))
    found = localize(scan(scene, stack), diameter_mm=11.5)
    assert found.centers == pytest.approx(center[np.newaxis], abs=0.015)
    assert found.fiducials[0].coverage < 0.95
    for kind in kinds:
        other = decoy(kind, foot)
        at = tuple(other.decoys[0].center_mm)
        assert len(localize(scan(other, small_stack(center_mm=at)), diameter_mm=11.5)) == 0, kind


def test_a_rejected_candidate_keeps_its_reason() -> None:
    egg = Scene((Part(ellipsoid((0, 0, 0), (5.75, 5.75, 7.5)), "acrylic"),))
    found = localize(scan(egg, small_stack()), diameter_mm=11.5)
    assert len(found) == 0
    assert found.rejected
    assert found.rejected[0].test in {"coverage", "roundness", "diameter", "blur", "thickness"}
    assert "expected" in found.rejected[0].reason or "allowed" in found.rejected[0].reason


def test_a_marker_cut_by_the_scans_edge_is_flagged_or_rejected() -> None:
    center = (0.0, 0.0, 18.5)
    stack = small_stack(stop_mm=20.0)
    found = localize(scan(balls([center]), stack), diameter_mm=11.5)
    for one in found.fiducials:
        error = one.center_mm - center
        assert FiducialFlag.CUT in one.flags
        assert error @ np.linalg.solve(one.covariance_mm2, error) < 16.3  # 99.9 % of chi-square, 3 degrees
    assert found.fiducials or any("outside the scan" in one.reason for one in found.rejected)


def test_clipped_metal_is_found_and_flagged() -> None:
    volume = scan(balls([(1.3, 0.4, -0.7)], 5.0, "titanium"), small_stack(spacing_mm=0.6, thickness_mm=0.6))
    clipped = dataclasses.replace(volume, voxels_hu=np.minimum(volume.voxels_hu, np.int16(3071)))
    found = localize(clipped, diameter_mm=5.0, expected=1)
    assert found.centers[0] == pytest.approx([1.3, 0.4, -0.7], abs=0.02)
    assert FiducialFlag.CLIPPED in found.fiducials[0].flags


@few_and_others(("diameter_mm", "material"), [(3.0, "titanium")], [(4.0, "titanium"), (5.0, "steel")])
def test_clipped_metal_under_a_sharp_kernel_keeps_its_size(diameter_mm: float, material: str) -> None:
    places = [(0.1, 0.2, 0.3), (9.3, -8.2, 7.4), (-8.6, 7.1, -6.2)]
    stack = small_stack(spacing_mm=0.6)
    found = localize(
        scan(balls(places, diameter_mm, material), stack, blur_mm=0.3, noise_hu=25.0), diameter_mm=diameter_mm
    )
    assert len(found) == 3
    distances = np.linalg.norm(found.centers[:, np.newaxis] - np.array(places), axis=-1).min(axis=1)
    assert distances.max() < 0.03
    for one in found.fiducials:
        assert one.diameter_mm == pytest.approx(diameter_mm, abs=0.1)
        assert FiducialFlag.CLIPPED in one.flags


@pytest.mark.parametrize("diameter_mm", [3.0, 5.0])
def test_clipped_zirconia_is_found_though_it_absorbs_twice_as_much_as_steel(diameter_mm: float) -> None:
    places = [(0.1, 0.2, 0.3), (9.3, -8.2, 7.4), (-8.6, 7.1, -6.2)]
    stack = small_stack(spacing_mm=0.8)
    steel_hu = render_hu(balls(places, diameter_mm, "steel"), stack, blur_mm=0.5, noise_hu=10.0)
    zirconia_hu = np.clip(2.1 * (steel_hu + 1000.0) - 1000.0, -1024.0, 3071.0).astype(np.int16)
    found = localize(on_grid(zirconia_hu, stack), diameter_mm=diameter_mm, expected=3)
    distances = np.linalg.norm(found.centers[:, np.newaxis] - np.array(places), axis=-1).min(axis=1)
    assert distances.max() < 0.02
    assert all(one.flags == (FiducialFlag.CLIPPED,) for one in found)


@few_and_others("with_balls", [True], [False])
def test_no_cut_of_a_rod_that_thick_slices_show_is_a_ball(with_balls: bool) -> None:
    """Each of 2 mm looked like a ball of 3 mm in slices of 0.02 to 0.8 mm: eight and more, 1 to 20 mm from any."""
    tops = np.array([(-15.0, -12.0, 3.1), (14.0, -10.0, -2.4), (1.0, 15.0, 0.3)])
    rods = [cylinder((x, y, -21.9), (0, 0, 1), 21.9 + z, 1.8) for x, y, z in tops]
    solids = [*rods, *(sphere(top, 3.0) for top in tops if with_balls)]
    scene = Scene(tuple(Part(solid, "titanium") for solid in solids))
    found = localize(scan(scene, small_stack(spacing_mm=2.0), blur_mm=0.45), diameter_mm=3.0)
    assert "hidden" in {one.test for one in found.rejected}
    for one in found:
        assert with_balls
        assert np.linalg.norm(tops - one.center_mm, axis=1).min() < 0.2


def test_bare_balls_in_slices_two_thirds_as_thick_as_they_are_stay_found() -> None:
    places = [(-15.0, -12.0, 3.1), (14.0, -10.0, -2.4), (1.0, 15.0, 0.3)]
    for material in ("acrylic", "titanium"):
        volume = scan(balls(places, 3.0, material), small_stack(spacing_mm=2.0), blur_mm=0.45)
        assert len(localize(volume, diameter_mm=3.0, expected=3)) == 3


def test_a_screws_head_is_no_ball() -> None:
    head = Scene((Part(cylinder((0.0, 0.0, 0.0), (-0.7, -0.25, 0.65), 3.0, 5.0), "titanium"),))
    for spacing_mm in (0.5, 0.6, 1.0):
        assert len(localize(scan(head, small_stack(spacing_mm=spacing_mm)), diameter_mm=5.0)) == 0


def test_a_metal_egg_is_not_taken_for_a_ball_under_thick_slices() -> None:
    """It is longer by a third along the slices' normal, as a wider slice profile would make a ball."""
    egg = Scene((Part(ellipsoid((0.1, 0.4, -0.3), (1.2, 1.5, 2.025)), "titanium"),))
    found = localize(scan(egg, small_stack(spacing_mm=1.25), blur_mm=0.5), diameter_mm=3.0)
    assert len(found) == 0
    assert "its ends are blurred over" in found.rejected[0].reason


@few_and_others("seed", [0], [5, 8])
def test_a_void_does_not_make_a_ball_larger(seed: int) -> None:
    """As moulding leaves one off the center: with its directions the fit takes the ball for fainter."""
    generator = np.random.default_rng(seed)
    center, aside = generator.uniform(-0.5, 0.5, 3), generator.normal(size=3)
    aside *= 1.36 / np.linalg.norm(aside)
    void = Part(sphere(tuple(center + aside), 2.9), "air", "void", embedded=True)
    volume = scan(balls([tuple(center)], 8.0) + Scene((void,)), small_stack(spacing_mm=0.8), seed=seed)
    found = localize(volume, diameter_mm=8.0, expected=1)[0]
    assert np.linalg.norm(found.center_mm - center) < 0.005  # 0.006 to 0.01 with them
    assert found.diameter_mm == pytest.approx(8.0, abs=0.03)  # 8.08 to 8.1 with them
    assert not found.flags


def test_a_metal_insert_does_not_pull_at_the_center() -> None:
    scene = marker("M1", scalp_foot((0.2, 0.1, 1.0), 0.3), "post with insert")
    center = scene.markers[0].center_mm
    stack = small_stack(center_mm=tuple(center), spacing_mm=1.25, thickness_mm=1.25)
    found = localize(scan(scene, stack, blur_mm=0.66), diameter_mm=11.5, expected=1)
    assert np.linalg.norm(found.centers[0] - center) < 0.015  # 0.031 if the insert's blur is taken for the ball's


def test_results_do_not_depend_on_the_number_of_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    volume = scan(balls(PLACES), small_stack())
    monkeypatch.setenv("OMP_NUM_THREADS", "3")
    several = localize(volume, diameter_mm=11.5)
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    one = localize(volume, diameter_mm=11.5)
    assert (several.centers == one.centers).all()
    assert (several.covariances == one.covariances).all()


def test_an_unexpected_number_is_refused_with_what_was_nearest() -> None:
    egg = Scene((Part(ellipsoid((0, 0, 0), (5.75, 5.75, 7.5)), "acrylic"),))
    with pytest.raises(
        RefusedError,
        match=r"0 markers of 11.5 mm were found, 1 expected; nearest .* were \(.*: .*; (seen|no sphere)",
    ):
        localize(scan(egg, small_stack()), diameter_mm=11.5, expected=1)
    with pytest.raises(RefusedError, match=r"1 marker of 11.5 mm was found, 0 expected"):
        localize(scan(balls(PLACES[:1]), small_stack()), diameter_mm=11.5, expected=0)


@pytest.mark.parametrize("diameter", [0.0, -3.0, float("nan"), float("inf")])
def test_a_diameter_that_is_no_positive_number_is_wrong_usage(diameter: float) -> None:
    with pytest.raises(UsageError, match="positive number of mm"):
        localize(scan(balls([]) + balls([(0, 0, 0)]), small_stack()), diameter_mm=diameter)


def test_a_diameter_below_two_pixels_is_refused() -> None:
    with pytest.raises(InputError, match="smaller than 2 pixels"):
        localize(scan(balls([(0, 0, 0)]), small_stack()), diameter_mm=0.9)
