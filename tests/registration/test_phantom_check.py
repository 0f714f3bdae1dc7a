"""A known phantom tells a scanner's error, whether the stated covariances hold, and what stretches the scan."""

from __future__ import annotations

import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ronnaplan.errors import InputError, RefusedError
from ronnaplan.geometry import FloatArray, Points
from ronnaplan.registration.phantom_check import KnownPhantom, PhantomCheck, check_phantom
from ronnaplan.registration.phantom_verdict import normalized_error, reasons_against, share_within

PLACES = np.random.default_rng(5).uniform(-80, 80, (8, 3))
LABELS = tuple("ABCDEFGH")
PHANTOM = KnownPhantom.of("board", LABELS, PLACES)
AXES = Rotation.from_rotvec([0.1, -0.2, 0.3]).as_matrix()
"""Slice axes that are not the patient's."""
SIGMA_MM = np.array([0.003, 0.004, 0.008])


def scanned(
    seed: int = 0, true_sigma: float = 1.0, stretch: FloatArray | None = None, places: FloatArray = PLACES
) -> Points:
    """The phantom, turned and moved, seen with errors of ``true_sigma`` times the stated ones; ``stretch`` (3, 3)."""
    generator = np.random.default_rng(seed)
    turn = Rotation.random(random_state=seed).as_matrix()
    seen = places @ turn.T
    seen = seen + (seen @ AXES.T @ (np.zeros((3, 3)) if stretch is None else stretch).T) @ AXES
    errors = generator.standard_normal(places.shape) * SIGMA_MM * true_sigma
    covariance = AXES.T @ np.diag(SIGMA_MM**2) @ AXES
    order = generator.permutation(len(places))
    centers = (seen + errors @ AXES + [10.0, 20, 300])[order]
    labels = tuple(f"F{n}" for n in range(1, len(places) + 1))
    return Points(centers, np.tile(covariance, (len(places), 1, 1)), labels)


def check(seed: int = 0, true_sigma: float = 1.0, stretch: FloatArray | None = None) -> PhantomCheck:
    return check_phantom(PHANTOM, scanned(seed, true_sigma, stretch), AXES)


def test_errors_as_stated_have_a_normalized_error_of_one_and_those_larger_are_told() -> None:
    honest = [check(seed) for seed in range(60)]
    error = normalized_error([one.judged for one in honest])
    within = share_within([one.within for one in honest])
    assert error.low < 1.0 < error.high
    assert error.value == pytest.approx(1.0, abs=0.15)
    assert within.low < 0.95 < within.high
    assert np.mean([one.in_slices_rms_mm**2 for one in honest]) == pytest.approx(
        np.mean(SIGMA_MM[:2] ** 2), rel=0.15
    )
    assert np.mean([one.across_rms_mm**2 for one in honest]) == pytest.approx(SIGMA_MM[2] ** 2, rel=0.25)
    assert sum(bool(reasons_against(one)) for one in honest) <= 6

    (reason,) = reasons_against(check(3, true_sigma=3.0))
    assert "times as large as stated" in reason


def test_the_interval_of_the_normalized_error_covers_the_truth_as_often_as_it_says() -> None:
    estimates = [normalized_error([check(seed, true_sigma=2.0).judged]) for seed in range(100)]
    covered = np.mean([one.low < 4.0 < one.high for one in estimates])
    assert 0.89 <= covered <= 0.99


def test_a_stretched_scan_is_told_from_one_that_is_only_noisy() -> None:
    stretch = np.diag([0.001, 0.001, -0.002])
    stretch[1, 2] = 0.003
    one = check(7, stretch=stretch)
    told = {each.name: each for each in one.stretches}
    for name, share in {"in_plane": 0.001, "along": -0.002, "shear_u": 0.0, "shear_v": 0.003}.items():
        assert abs(told[name].share - share) < 4 * told[name].standard_error + 1e-5
    assert {each.name for each in one.worst_stretches} == {"in_plane", "along", "shear_v"}
    assert not any("as large as stated" in reason for reason in reasons_against(one))
    said = "; ".join(reasons_against(one))
    assert re.search(r"0\.\d+ % too large within the slices", said)
    assert re.search(r"0\.\d+ % too short along the table", said)
    assert "-" not in said
    assert [each.is_sure for each in check(7).stretches] == [False] * 4


def test_a_flat_phantom_tells_no_stretch_across_itself() -> None:
    places = PLACES * [1, 1, 0]
    flat = KnownPhantom.of("plate", LABELS, places)
    errors = np.random.default_rng(1).standard_normal(places.shape) * SIGMA_MM
    found = Points(places + errors, np.tile(np.diag(SIGMA_MM**2), (8, 1, 1)), LABELS)
    assert [each.name for each in check_phantom(flat, found, np.eye(3)).stretches] == ["in_plane"]


def test_missing_and_strange_markers_are_named() -> None:
    seen = scanned()
    lost = int(np.argmin(np.linalg.norm(seen.positions_mm - seen.positions_mm.mean(axis=0), axis=1)))
    centers = seen.positions_mm.copy()
    centers[lost] += [90.0, 40, -70]
    one = check_phantom(PHANTOM, Points(centers, seen.covariances_mm2, seen.labels), AXES)
    assert len(one.missing) == 1
    assert one.strange == (seen.labels[lost],)
    assert len(one.registration) == 7
    assert "not found" in reasons_against(one)[0]
    assert "phantom does not have" in reasons_against(one)[1]


def test_distances_pair_with_either_hand_and_coordinates_with_their_own() -> None:
    mirrored = scanned(places=PLACES * [1, 1, -1])
    with pytest.raises(RefusedError, match="does not pair"):
        check_phantom(PHANTOM, mirrored, AXES)
    loose = KnownPhantom.of("board", LABELS, PLACES, has_hand=False)
    assert not reasons_against(check_phantom(loose, mirrored, AXES))
    assert not reasons_against(check_phantom(loose, scanned(), AXES))


def test_what_cannot_be_judged_is_refused() -> None:
    seen = scanned()
    few = Points(seen.positions_mm[:3], seen.covariances_mm2[:3], seen.labels[:3])
    with pytest.raises(RefusedError, match="the scan shows 3 markers; a check needs 4"):
        check_phantom(PHANTOM, few, AXES)
    with pytest.raises(InputError, match="phantom 'three' has 3 markers; a check needs 4"):
        check_phantom(KnownPhantom.of("three", LABELS[:3], PLACES[:3]), seen, AXES)
    square = np.array([[0.0, 0, 0], [50, 0, 0], [50, 50, 0], [0, 50, 0]])
    regular = KnownPhantom.of("square", LABELS[:4], square)
    found = Points(square, np.tile(np.eye(3) * 1e-4, (4, 1, 1)), LABELS[:4])
    with pytest.raises(RefusedError, match="'square' does not pair"):
        check_phantom(regular, found, np.eye(3))


def test_the_error_of_the_phantom_itself_counts() -> None:
    rough = KnownPhantom.of("rough", LABELS, PLACES, 0.05)
    moved = KnownPhantom.of("moved", LABELS, PLACES + np.random.default_rng(2).normal(0, 0.05, PLACES.shape))
    exact = check_phantom(moved, scanned(), AXES)
    assert normalized_error([exact.judged]).value > 20
    known = check_phantom(KnownPhantom("moved", LABELS, moved.centers_mm, rough.covariances_mm2), scanned(), AXES)
    error = normalized_error([known.judged])
    assert error.low < 1.0 < error.high
