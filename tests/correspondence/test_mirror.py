"""Left-handed coordinates, as a swapped axis or a lost sign makes them: told as what they are, never paired."""

from __future__ import annotations

import numpy as np
import pytest

from ronnaplan.correspondence import Pairing, match_points
from ronnaplan.geometry import FloatArray
from tests.correspondence.scenes import SIGMA_CT, SIGMA_OTS
from tests.long import few_and_others, few_or_all

FLIPPED = np.array([1.0, 1.0, -1.0])


def head(seed: int, markers: int, outliers: int, height_mm: float | None = None) -> tuple[FloatArray, FloatArray]:
    """Markers on a head of 90 mm, or within so much of a plane, and strays, as both devices read them."""
    rng = np.random.default_rng([seed, markers, outliers])
    way = rng.normal(size=(markers, 3))
    points = 90.0 * way / np.linalg.norm(way, axis=1, keepdims=True)
    points[:, 2] = np.abs(points[:, 2]) if height_mm is None else rng.normal(0.0, 1.0, markers) * height_mm
    read = [
        np.concatenate([points + rng.normal(0.0, sigma, points.shape), rng.uniform(-100, 100, (outliers, 3))])
        for sigma in (SIGMA_CT, SIGMA_OTS)
    ]
    return read[0], read[1]


@few_and_others("markers", [5, 8], [6, 10, 14])
@pytest.mark.parametrize("outliers", [0, 2])
@pytest.mark.parametrize("told", [True, False])
def test_left_handed_coordinates_are_told_as_such(markers: int, outliers: int, told: bool) -> None:
    """Most were refused for their probability, or for the number of markers."""
    for seed in range(8):
        ct, ots = head(seed, markers, outliers)
        pairing = match_points(ct, ots * FLIPPED, expected=markers if told else None)
        assert "left-handed" in pairing.reason, seed
        assert pairing.status == "unmatched"


def test_four_markers_are_not_paired_where_only_their_mirror_image_fits_within_the_errors() -> None:
    """Of 400 such heads 56 were paired, with residuals of up to 3.7 mm, as if errors were four times as large."""
    refused = 0
    for seed in range(100):
        ct, ots = head(seed, 4, 0)
        pairing = match_points(ct, ots * FLIPPED, expected=4)
        refused += "left-handed" in pairing.reason
        assert pairing.status == "unmatched" or len(match_points(ct, ots, expected=4)) == 4
    assert refused >= 90


@few_or_all("cases", 20, 60)
@pytest.mark.parametrize("height_mm", [0.0, 1.0])
@pytest.mark.parametrize("markers", [4, 6, 8])
def test_flat_markers_that_are_right_handed_are_not_doubted(markers: int, height_mm: float, cases: int) -> None:
    reasons = [match_points(*head(seed, markers, 0, height_mm), expected=markers).reason for seed in range(cases)]
    assert not any("left-handed" in reason for reason in reasons)


@few_or_all("cases", 8, 20)
@pytest.mark.parametrize("height_mm", [None, 0.5])
def test_errors_that_are_larger_in_one_direction_are_turned_over_with_the_points(
    height_mm: float | None, cases: int
) -> None:
    poor = 0.02 * np.eye(3)
    poor[0, 2] = poor[2, 0] = 0.15
    poor[0, 0] = poor[2, 2] = 0.2
    errors = np.tile(poor, (6, 1, 1)), np.tile(0.01 * np.eye(3), (6, 1, 1))

    def matched(ct: FloatArray, ots: FloatArray) -> Pairing:
        return match_points(ct, ots, 6, covariances_ct_mm2=errors[0], covariances_ots_mm2=errors[1])

    for seed in range(cases):
        rng = np.random.default_rng([9, seed])
        points, _ = head(seed, 6, 0, height_mm)
        ct = points + rng.multivariate_normal(np.zeros(3), poor, size=6)
        ots = points + rng.normal(0.0, 0.1, points.shape)
        assert matched(ct, ots).status == "unique"
        if height_mm is None:
            assert "left-handed" in matched(ct, ots * FLIPPED).reason


@pytest.mark.parametrize(("markers", "seed"), [(17, 67), (17, 87), (32, 0), (32, 45), (32, 82), (50, 15)])
def test_a_part_of_many_markers_that_fits_its_mirror_image_is_not_taken_for_them(markers: int, seed: int) -> None:
    """5 to 13 of them were paired, each with a probability of 0.99 and more."""
    ct, ots = head(seed, markers, 0)
    assert "left-handed" in match_points(ct, ots * FLIPPED).reason


@few_and_others(("markers", "outliers"), [(17, 0), (32, 0)], [(50, 0), (40, 60)])
@few_or_all("cases", 3, 6)
def test_many_left_handed_readings_are_told_as_such_too(markers: int, outliers: int, cases: int) -> None:
    """Most were refused as ambiguous: of so many markers some parts fit their mirror image."""
    for seed in range(cases):
        ct, ots = head(seed, markers, outliers)
        pairing = match_points(ct, ots * FLIPPED)
        assert pairing.status == "unmatched", seed
        assert "left-handed" in pairing.reason, seed


@few_and_others(("markers", "outliers"), [(24, 0), (40, 0)], [(40, 40)])
def test_many_left_handed_readings_of_a_plate_are_noticed_by_its_thickness(markers: int, outliers: int) -> None:
    """Two of five were paired, at 0.9999 and more: nearly as many markers fit their mirror image."""
    for seed in range(6):
        ct, ots = head(seed, markers, outliers, height_mm=1.5)
        assert "left-handed" in match_points(ct, ots * FLIPPED).reason, seed


def test_many_sound_markers_alike_on_the_left_and_right_are_not_called_left_handed() -> None:
    rng = np.random.default_rng(14)
    for _ in range(6):
        half = rng.uniform(-80.0, 80.0, (15, 3))
        points = np.concatenate([half, half * [-1.0, 1.0, 1.0]])
        ct, ots = (points + rng.normal(0.0, sigma, points.shape) for sigma in (SIGMA_CT, SIGMA_OTS))
        assert match_points(ct, ots).status == "unique"


@few_or_all("seeds", (0, 1), (0, 1, 2, 4, 5))
def test_points_on_a_sphere_that_have_nothing_in_common_are_not_called_left_handed(seeds: tuple[int, ...]) -> None:
    """Five of them were: poses that chance makes were lost where they were sought anew with larger errors."""
    for seed in seeds:
        ways = np.random.default_rng([90, seed]).normal(size=(2, 80, 3))
        ct, ots = 90.0 * ways / np.linalg.norm(ways, axis=2, keepdims=True)
        pairing = match_points(ct, ots)
        assert pairing.status != "unique"
        assert "left-handed" not in pairing.reason, seed
