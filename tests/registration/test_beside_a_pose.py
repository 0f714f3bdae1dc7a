"""What is fitted beside a pose is found as sure as it is said, and held where the points do not tell it."""

import numpy as np

from ronnaplan.registration import register_points
from ronnaplan.registration.beside_a_pose import POSE, fitted_beside, moved_together
from tests.correspondence.scenes import HEAD
from tests.registration.scene import SHIFT, TURN

SD_MM = 0.2
WIDE = 10.0


def test_an_unknown_that_shifts_some_points_is_found_with_its_error() -> None:
    rng = np.random.default_rng(3)
    some = np.where(np.arange(len(HEAD)) < 3, 1.0, 0.0)[:, None, None] * np.eye(3)
    shift, off, chances = np.array([0.5, -0.8, 0.3]), [], []
    for _ in range(200):
        seen = HEAD @ TURN.T + SHIFT + SD_MM * rng.normal(size=HEAD.shape) + some @ shift
        fit = register_points(HEAD, seen, SD_MM**2 * np.eye(3))
        motion = moved_together(fit.transform, HEAD)
        found = fitted_beside(fit.residual_vectors_mm, fit.covariances_mm2, motion, some, WIDE)
        off.append((found.unknowns - shift) / np.sqrt(found.variances))
        chances.append(found.probability)
        assert found.freedom == HEAD.size - POSE - 3
        assert found.chi_square < found.rigid_chi_square
    assert 0.9 < np.mean(np.square(off)) < 1.1
    assert abs(np.mean(chances) - 0.5) < 0.05


def test_what_no_point_tells_is_held_and_as_open_as_before() -> None:
    fit = register_points(HEAD, HEAD @ TURN.T + SHIFT, SD_MM**2 * np.eye(3))
    motion = moved_together(fit.transform, HEAD)
    found = fitted_beside(fit.residual_vectors_mm, fit.covariances_mm2, motion, motion[..., 3:], WIDE)
    np.testing.assert_allclose(found.unknowns, 0.0, atol=1e-9)
    np.testing.assert_allclose(np.sqrt(found.variances), WIDE)
