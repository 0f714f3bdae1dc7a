"""The expected error along a path is what registrations of simulated readings show."""

from __future__ import annotations

import numpy as np
import pytest

from ronnaplan.errors import InputError
from ronnaplan.geometry import FloatArray, Points
from ronnaplan.planning import Trajectory
from ronnaplan.planning.uncertainty import ExpectedPose, path_error
from ronnaplan.registration import predict_tre, register_batch, register_points
from ronnaplan.transforms import transform_points

MARKERS = np.array([[-50.0, -60, 60], [60, -40, 55], [70, 30, 50], [-65, 40, 45], [5, 70, 70]])
SIGMA_MM = 0.6
PATH = Trajectory("A", np.array([30.0, -20, 85]), np.array([5.0, 10, 15]))
TOLERANCE_MM = 0.9
EXPECTED = ExpectedPose.planned(
    Points(MARKERS, np.zeros((5, 3, 3)), tuple("ABCDE")), 0.8 * SIGMA_MM, 0.6 * SIGMA_MM
)


@pytest.fixture(scope="module")
def errors() -> tuple[FloatArray, FloatArray]:
    """Errors (B, 2, 3) of entry and target over 20,000 simulated registrations."""
    generator = np.random.default_rng(77)
    fixed = MARKERS + SIGMA_MM * generator.standard_normal((20_000, *MARKERS.shape))
    found = register_batch(np.broadcast_to(MARKERS, fixed.shape), fixed).transforms
    ends = np.stack([PATH.entry_mm, PATH.target_mm])
    errors = transform_points(found, np.broadcast_to(ends, (len(fixed), 2, 3))) - ends
    return errors[:, 0], errors[:, 1]


def test_the_error_at_both_ends(errors: tuple[FloatArray, FloatArray]) -> None:
    expected = path_error(PATH, EXPECTED, TOLERANCE_MM)
    for error, rms in zip(errors, (expected.entry_rms_mm, expected.target_rms_mm), strict=True):
        assert rms == pytest.approx(np.sqrt((error**2).sum(axis=1).mean()), rel=0.02)
    same = predict_tre(MARKERS, SIGMA_MM**2 * np.eye(3), PATH.at_depth(expected.depths_mm))
    np.testing.assert_allclose(expected.covariances_mm2, same, atol=1e-3 * np.trace(same[0]))


def test_markers_near_a_line_do_not_look_wider_by_their_own_noise_in_the_scan() -> None:
    """The places are readings: of 8 markers whose rotation is known to 6 degrees the error would be 5 % too small."""
    rng = np.random.default_rng(5)
    row = np.column_stack([np.linspace(-70, 70, 8), 6 * rng.normal(size=(8, 2))])
    sigma = 6 / register_points(row, row, np.eye(3)).rotation_sd_deg
    in_ct, tracked = (row + s * sigma * rng.normal(size=(4000, *row.shape)) for s in (0.95, np.sqrt(1 - 0.95**2)))
    places = np.array([[0.0, 40, 20], [30, -50, 10]])
    back = register_batch(tracked, in_ct).transforms
    error = transform_points(back, np.broadcast_to(places, (len(back), 2, 3))) - places
    stated = [
        ExpectedPose.planned(
            Points(one, np.zeros((8, 3, 3)), tuple("ABCDEFGH")), 0.95 * sigma, np.sqrt(1 - 0.95**2) * sigma
        ).tre_rms_mm(places)
        for one in in_ct[:500]
    ]
    np.testing.assert_allclose(
        np.sqrt(np.mean(np.square(stated), axis=0)), np.sqrt((error**2).sum(-1).mean(0)), rtol=0.03
    )


def test_angle_tube_and_chance(errors: tuple[FloatArray, FloatArray]) -> None:
    expected = path_error(PATH, EXPECTED, TOLERANCE_MM)
    at_entry, at_target = errors
    turned = PATH.target_mm + at_target - PATH.entry_mm - at_entry
    cosines = turned @ PATH.inward / np.linalg.norm(turned, axis=1)
    angles = np.degrees(np.arccos(np.clip(cosines, -1, 1)))
    assert expected.angular_rms_deg == pytest.approx(np.sqrt((angles**2).mean()), rel=0.02)
    sideways = at_entry - (at_entry @ PATH.inward)[:, None] * PATH.inward
    away = np.linalg.norm(sideways, axis=1)
    assert (away <= expected.tube_mm[0]).mean() == pytest.approx(0.96, abs=0.015)
    within = (away <= TOLERANCE_MM) & (np.linalg.norm(at_target, axis=1) <= TOLERANCE_MM)
    assert expected.probability == pytest.approx(within.mean(), abs=0.015)


def test_a_tolerance_that_is_no_length_is_refused() -> None:
    with pytest.raises(InputError, match="tolerance"):
        path_error(PATH, EXPECTED, 0.0)
