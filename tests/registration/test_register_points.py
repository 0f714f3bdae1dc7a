"""Registration: the transform found, and what it says of its own error."""

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from ronnaplan.ct import CTVolume
from ronnaplan.errors import FrameMismatchError, InputError, UsageError
from ronnaplan.geometry import Frame
from ronnaplan.registration import RegistrationFlag, register_batch, register_points
from ronnaplan.rigid import fit_closed_form
from ronnaplan.transforms import point_jacobian
from tests.long import few_or_all

HEAD = np.array([[-60.0, 20, 40], [55, 30, 50], [5, -85, 60], [-20, 60, 75], [30, -10, 95], [-70, -30, 10]])


def pose(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.random(rng=rng).as_matrix()
    matrix[:3, 3] = rng.uniform(-1, 1, 3) * 1000 - (0, 0, 2000)
    return matrix


def mapped(matrix: np.ndarray, points: np.ndarray) -> np.ndarray:
    found: np.ndarray = points @ matrix[:3, :3].T + matrix[:3, 3]
    return found


def covariances(rng: np.random.Generator, count: int, sd_mm: float) -> np.ndarray:
    factor = rng.normal(size=(count, 3, 3))
    full = factor @ factor.transpose(0, 2, 1) + 0.01 * np.eye(3)
    found: np.ndarray = full * (3 * sd_mm**2 / np.trace(full, axis1=1, axis2=2))[:, None, None]
    return found


def noise(rng: np.random.Generator, covs: np.ndarray, repeats: int) -> np.ndarray:
    found: np.ndarray = np.einsum(
        "nij,bnj->bni", np.linalg.cholesky(covs), rng.normal(size=(repeats, *covs.shape[:2]))
    )
    return found


@settings(max_examples=60)
@given(seed=st.integers(0, 2**32 - 1), count=st.integers(3, 12), stated=st.booleans())
def test_exact_pairs_give_back_the_transform(seed: int, count: int, stated: bool) -> None:
    rng = np.random.default_rng(seed)
    points = rng.uniform(-80, 80, (count, 3)) + np.eye(count, 3) * 60
    truth = pose(seed)
    errors = (covariances(rng, count, 0.5), covariances(rng, count, 0.2)) if stated else None
    found = register_points(points, mapped(truth, points), errors)
    np.testing.assert_allclose(found.transform, truth, atol=1e-7)
    assert found.fre_rms_mm < 1e-9


@settings(max_examples=30)
@given(seed=st.integers(0, 2**32 - 1), stated=st.booleans())
def test_moving_the_tracker_moves_the_answer_and_nothing_else(seed: int, stated: bool) -> None:
    rng = np.random.default_rng(seed)
    fixed = HEAD + rng.normal(size=HEAD.shape) * 0.3
    moving_mm2, fixed_mm2 = covariances(rng, len(HEAD), 0.4), covariances(rng, len(HEAD), 0.2)
    turn = pose(seed)
    turned_mm2 = turn[:3, :3] @ fixed_mm2 @ turn[:3, :3].T
    order = rng.permutation(len(HEAD))
    before = register_points(HEAD, fixed, (moving_mm2, fixed_mm2) if stated else None)
    after = register_points(
        HEAD[order], mapped(turn, fixed)[order], (moving_mm2[order], turned_mm2[order]) if stated else None
    )
    np.testing.assert_allclose(after.transform, turn @ before.transform, atol=1e-6)
    np.testing.assert_allclose(after.residuals_mm, before.residuals_mm[order], atol=1e-6)
    target = np.array([[10.0, -5, -40]])
    np.testing.assert_allclose(after.tre_rms_mm(target), before.tre_rms_mm(target), rtol=1e-6)


def test_a_mirrored_set_is_fitted_by_a_rotation_and_flagged() -> None:
    mirrored = HEAD * (-1, 1, 1)
    found = register_points(HEAD, mirrored)
    assert np.linalg.det(found.transform[:3, :3]) == pytest.approx(1.0)
    assert RegistrationFlag.MIRRORED in found.flags
    assert RegistrationFlag.MIRRORED not in register_points(HEAD, mapped(pose(1), HEAD)).flags


def test_the_likelihood_fit_is_the_minimum_over_poses_and_true_points() -> None:
    """Against a general optimizer over the six pose parameters and the eighteen unknown true coordinates."""
    rng = np.random.default_rng(5)
    moving_mm2, fixed_mm2 = covariances(rng, 6, 3.0), covariances(rng, 6, 2.0)  # large: the bend of SE(3) shows
    truth = pose(5)
    moving = HEAD + noise(rng, moving_mm2, 1)[0]
    fixed = mapped(truth, HEAD) + noise(rng, fixed_mm2, 1)[0]
    whiten = [np.linalg.cholesky(np.linalg.inv(c)).transpose(0, 2, 1) for c in (moving_mm2, fixed_mm2)]

    def misfit(x: np.ndarray) -> np.ndarray:
        latent = x[6:].reshape(-1, 3)
        image = latent @ (Rotation.from_rotvec(x[:3]).as_matrix() @ truth[:3, :3]).T + x[3:6]
        both = [(whiten[0] @ (moving - latent)[..., None]), (whiten[1] @ (fixed - image)[..., None])]
        return np.concatenate(both).ravel()

    start = np.concatenate([np.zeros(3), truth[:3, 3], moving.ravel()])
    peer = least_squares(misfit, start, xtol=1e-15, ftol=1e-15, gtol=1e-15)
    found = register_points(moving, fixed, (moving_mm2, fixed_mm2))
    np.testing.assert_allclose(
        found.transform[:3, :3], Rotation.from_rotvec(peer.x[:3]).as_matrix() @ truth[:3, :3], atol=1e-7
    )
    assert found.chi_square == pytest.approx(2 * peer.cost, rel=1e-9)


@few_or_all("counts", (3, 6), range(3, 13))
@pytest.mark.parametrize(("isotropic", "tolerance"), [(True, 0.03), (False, 0.05)])
def test_predicted_tre_agrees_with_monte_carlo(isotropic: bool, tolerance: float, counts: Sequence[int]) -> None:
    """Of so many trials an RMS error is known to a third of its tolerance or better: one standard deviation."""
    rng, trials = np.random.default_rng(11), 6000 if isotropic else 3000
    for count in counts:
        points = np.vstack([HEAD[:3], rng.uniform(-90, 90, (count - 3, 3))])
        targets = rng.uniform(-70, 70, (4, 3))
        truth = pose(count)
        if isotropic:
            moving_mm2, fixed_mm2 = np.tile(0.4**2 * np.eye(3), (2, count, 1, 1))
            fixed_mm2 = fixed_mm2 / 4
        else:
            moving_mm2, fixed_mm2 = covariances(rng, count, 0.4), covariances(rng, count, 0.2)
        moving = points + noise(rng, moving_mm2, trials)
        fixed = mapped(truth, points) + noise(rng, fixed_mm2, trials)
        found = register_batch(moving, fixed, None if isotropic else (moving_mm2, fixed_mm2)).transforms
        error = targets @ found[:, :3, :3].swapaxes(1, 2) + found[:, None, :3, 3] - mapped(truth, targets)
        one = register_points(points, mapped(truth, points), (moving_mm2, fixed_mm2))
        observed = np.sqrt((error**2).sum(-1).mean(0))
        np.testing.assert_allclose(one.tre_rms_mm(targets), observed, rtol=tolerance)
        for k in range(len(targets)):
            scatter = np.cov(error[:, k].T)
            assert np.abs(one.tre(targets)[k] - scatter).max() < 0.08 * np.trace(scatter)


@pytest.mark.parametrize("count", [6, 12])
def test_markers_near_a_line_do_not_look_wider_by_their_own_noise(count: int) -> None:
    """The rotation about the line is known to 5 degrees: noise of 1 to 2 mm stands beside an offset of 6 mm."""
    rng = np.random.default_rng(count)
    points = np.column_stack([np.linspace(-70, 70, count), 6 * rng.normal(size=(count, 2))])
    sigma = 5 / register_points(points, points, np.eye(3)).rotation_sd_deg
    targets = np.array([[0.0, 40, 20], [30, -50, 10]])
    moving_mm2, fixed_mm2 = 0.8 * sigma**2 * np.eye(3), 0.2 * sigma**2 * np.eye(3)
    moving, fixed = (
        points + np.sqrt(c[0, 0]) * rng.normal(size=(3000, count, 3)) for c in (moving_mm2, fixed_mm2)
    )
    found = register_batch(moving, fixed, (moving_mm2, fixed_mm2))
    error = targets @ found.transforms[:, :3, :3].swapaxes(1, 2) + found.transforms[:, None, :3, 3] - targets
    arms = point_jacobian(targets + error)
    assert found.covariances is not None
    stated = np.einsum("btij,bjk,btik->bt", arms, found.covariances, arms)
    np.testing.assert_allclose(np.sqrt(stated.mean(axis=0)), np.sqrt((error**2).sum(-1).mean(0)), rtol=0.05)


def test_isotropic_tre_is_the_formula_of_fitzpatrick_1998() -> None:
    sd = 0.3
    target = np.array([40.0, -20, -60])
    centered = HEAD - HEAD.mean(axis=0)
    axes = np.linalg.svd(centered)[2]
    ratio = 0.0
    for k in range(3):  # Eq. 46: squared distance of target and of markers from each principal axis
        others = [i for i in range(3) if i != k]
        from_axis = np.sum((axes[others] @ (target - HEAD.mean(axis=0))) ** 2)
        ratio += from_axis / np.mean(np.sum((centered @ axes[others].T) ** 2, axis=1))
    expected = 3 * sd**2 / 6 * (1 + ratio / 3)
    found = register_points(HEAD, HEAD, sd**2 * np.eye(3)).tre_rms_mm([target])[0]
    assert found**2 == pytest.approx(expected, rel=1e-9)


def test_the_fit_probability_is_uniform_when_the_stated_errors_are_true() -> None:
    rng = np.random.default_rng(8)
    errors = covariances(rng, 6, 0.4)
    fixed = mapped(pose(8), HEAD) + noise(rng, errors, 400)
    chance = np.array([register_points(HEAD, one, errors).fit_probability for one in fixed])
    assert 0.05 < np.mean(chance < 0.1) < 0.15
    assert 0.45 < np.mean(chance < 0.5) < 0.55


def test_unstated_errors_are_estimated_from_the_residuals() -> None:
    rng = np.random.default_rng(4)
    estimates = [
        register_points(HEAD, HEAD + rng.normal(size=HEAD.shape) * 0.5).covariances_mm2[0, 0, 0]
        for _ in range(400)
    ]
    assert np.mean(estimates) == pytest.approx(0.25, rel=0.05)
    found = register_points(HEAD, HEAD + 0.1 * rng.normal(size=HEAD.shape))
    assert found.fit_probability is None
    assert RegistrationFlag.ERRORS_FROM_RESIDUALS in found.flags


def test_misfit_and_too_small_residuals_are_flagged() -> None:
    rng = np.random.default_rng(6)
    fixed = HEAD + rng.normal(size=HEAD.shape) * 0.5
    assert RegistrationFlag.MISFIT in register_points(HEAD, fixed, 0.05**2 * np.eye(3)).flags
    assert RegistrationFlag.TOO_GOOD in register_points(HEAD, fixed, 5.0**2 * np.eye(3)).flags
    assert register_points(HEAD, fixed, 0.5**2 * np.eye(3)).flags == ()
    assert RegistrationFlag.THREE_MARKERS in register_points(HEAD[:3], fixed[:3], 0.25 * np.eye(3)).flags


def test_a_nearly_straight_row_of_markers_is_flagged_loose() -> None:
    row = np.array([[0.0, 0, 0], [50, 2, 0], [100, 0, 1], [150, 1, 2]])
    assert RegistrationFlag.LOOSE_ROTATION in register_points(row, row, 0.3**2 * np.eye(3)).flags


def chi_square(matrix: np.ndarray, moving: np.ndarray, fixed: np.ndarray, errors: np.ndarray) -> float:
    off = fixed - mapped(matrix, moving)
    turned = matrix[:3, :3] @ errors @ matrix[:3, :3].T
    return float(np.einsum("ni,nij,nj", off, np.linalg.inv(turned + errors), off))


def test_contradictory_pairs_settle_or_are_flagged() -> None:
    """Wrong pairs with long thin errors: the misfit must not rise from the start, and no fit passes for sound."""
    rng = np.random.default_rng(12)
    moving = rng.uniform(-80, 80, (300, 6, 3))
    fixed = rng.uniform(-80, 80, (300, 6, 3))
    thin = Rotation.random(6, rng=rng).as_matrix()
    errors = thin @ np.diag([0.01, 0.01, 9.0]) @ thin.transpose(0, 2, 1)
    batch = register_batch(moving, fixed, (errors, errors))
    size = np.trace(errors, axis1=1, axis2=2)
    for k in range(0, 300, 30):
        one = register_points(moving[k], fixed[k], (errors, errors))
        assert one.settled == batch.settled[k]
        start = fit_closed_form(moving[k], fixed[k], weights=1 / size)
        assert one.chi_square <= chi_square(start, moving[k], fixed[k], errors)
        assert RegistrationFlag.MISFIT in one.flags
        assert (RegistrationFlag.UNSETTLED in one.flags) == (not one.settled)


def test_batch_and_single_agree() -> None:
    rng = np.random.default_rng(9)
    errors = (covariances(rng, 6, 0.4), covariances(rng, 6, 0.2))
    moving = HEAD + noise(rng, errors[0], 5)
    fixed = mapped(pose(9), HEAD) + noise(rng, errors[1], 5)
    for stated in (None, errors):
        batch = register_batch(moving, fixed, stated)
        for k in range(5):
            single = register_points(moving[k], fixed[k], stated)
            np.testing.assert_allclose(batch.transforms[k], single.transform, atol=1e-8)
            assert batch.fre_rms_mm[k] == pytest.approx(single.fre_rms_mm)
            if batch.covariances is not None:
                np.testing.assert_allclose(batch.covariances[k], single.pose.covariance, rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize(
    ("moving", "fixed", "errors", "says"),
    [
        (HEAD[:2], HEAD[:2], None, "at least three"),
        (HEAD, HEAD[:5], None, "expected pairs"),
        (np.outer(range(5), [1.0, 2, 3]), HEAD[:5], None, "one line"),
        (np.zeros((4, 3)), HEAD[:4], None, "one line"),
        (HEAD, np.where(HEAD == 95, np.nan, HEAD), None, "finite"),
        (HEAD, HEAD, np.diag([1.0, 1.0, 0.0]), "positive definite"),
        (HEAD, HEAD, -np.eye(3), "not symmetric and positive"),
        (HEAD, HEAD, np.triu(np.ones((3, 3))) + np.eye(3), "not symmetric"),
        (HEAD, HEAD, np.full((3, 3), np.nan), "finite"),
        (HEAD, HEAD, np.eye(2), "shape"),
        (HEAD, HEAD, (np.eye(3), np.eye(3), np.eye(3)), "tuple of 3"),
        (HEAD, HEAD, "large", "not numbers"),
        (HEAD / 1000, HEAD / 1000, None, r"the moving points spread over 0\.\d+, expected 1 to 20000 mm"),
        (HEAD, HEAD / 1000, np.eye(3), r"the fixed points spread over 0\.\d+, expected 1 to 20000 mm"),
        (HEAD, HEAD / 1000, None, r"convert .* to millimetres, or, if they are in mm, read points at different"),
        (HEAD, HEAD * 1000, None, r"convert the coordinates to millimetres$"),
        (np.vstack([HEAD, HEAD[:1]]), np.vstack([HEAD, HEAD[:1]]), None, "pair 6 is given twice"),
    ],
)
def test_unusable_input_is_named(moving: np.ndarray, fixed: np.ndarray, errors: object, says: str) -> None:
    with pytest.raises(InputError, match=says):
        register_points(moving, fixed, errors)  # type: ignore[arg-type]


def test_unusable_batches_are_named() -> None:
    stack = np.stack([HEAD, HEAD])
    with pytest.raises(InputError, match="shapes"):
        register_batch(HEAD, HEAD)
    with pytest.raises(InputError, match="not finite"):
        register_batch(stack, np.where(stack == 95, np.inf, stack))
    with pytest.raises(InputError, match="positive definite"):
        register_batch(stack, stack, (np.zeros((3, 3)), np.zeros((3, 3))))
    with pytest.raises(
        InputError, match=r"have shape \(4, 4\); expected \(3, 3\) or \(6, 3, 3\) or \(2, 6, 3, 3\)"
    ):
        register_batch(stack, stack, (np.eye(4), np.eye(3)))
    with pytest.raises(UsageError, match=r"no tuple of two; expected \(moving, fixed\)"):
        register_batch(stack, stack, np.tile(np.eye(3), (len(HEAD), 1, 1)))  # type: ignore[arg-type]


@pytest.mark.parametrize("wrong", ["negative", "skew", "nan", "infinite", "complex", "masked"])
@pytest.mark.parametrize("side", [0, 1])
def test_a_batch_refuses_the_covariances_that_a_registration_refuses(wrong: str, side: int) -> None:
    """One side was taken with negative variances, as long as the other made up for them."""
    errors: np.ndarray = {
        "negative": -0.1 * np.eye(3),
        "skew": np.eye(3) + np.triu(np.ones((3, 3)), 1),
        "nan": np.full((3, 3), np.nan),
        "infinite": np.inf * np.ones((3, 3)),
        "complex": np.eye(3) + 0j,
        "masked": np.ma.masked_less(np.eye(3), 0.5),
    }[wrong]
    sides = (errors, np.eye(3)) if side == 0 else (np.eye(3), errors)
    told = []
    for register in (
        lambda: register_points(HEAD, HEAD, sides),
        lambda: register_batch(HEAD[None], HEAD[None], sides),
    ):
        with pytest.raises(InputError) as refused:
            register()
        told.append(str(refused.value).partition(";")[0])
    assert told[0] == told[1]


def test_a_batch_refuses_coordinates_that_a_registration_refuses() -> None:
    for moving in (1e6 + HEAD, HEAD + 1j, np.ma.masked_greater(HEAD, 90)):
        with pytest.raises(InputError):
            register_batch(moving[None], HEAD[None])


def test_targets_of_another_scan_are_refused() -> None:
    ct, ots = Frame("CT", "1.2.3"), Frame("OTS")
    found = register_points(HEAD, HEAD, moving_frame=ct, fixed_frame=ots)
    assert found.tre([[0, 0, 0]], ct).shape == (1, 3, 3)
    with pytest.raises(FrameMismatchError, match=r"1\.2\.4"):
        found.tre([[0, 0, 0]], Frame("CT", "1.2.4"))


def test_a_registration_keeps_what_it_was_given() -> None:
    """Residuals are computed when they are asked for: a buffer that was filled again gave those of other points."""
    moving, fixed, errors = HEAD.copy(), mapped(pose(4), HEAD) + 0.1, np.eye(3)
    found = register_points(moving, fixed, (errors, errors))
    fre_mm = register_points(HEAD, fixed.copy(), (np.eye(3), np.eye(3))).fre_rms_mm
    moving += 5.0
    fixed *= 2.0
    errors *= 9.0
    assert found.fre_rms_mm == fre_mm
    assert found.stated_mm2 is not None
    np.testing.assert_array_equal(found.stated_mm2[0][0], np.eye(3))


def test_labels_must_match_the_pairs() -> None:
    with pytest.raises(InputError, match="2 labels"):
        register_points(HEAD, HEAD, labels=["a", "b"])


def test_a_map_of_the_expected_error_agrees_with_the_error_place_by_place() -> None:
    rng = np.random.default_rng(3)
    moving = rng.uniform(-60, 60, (5, 3))
    noise = rng.normal(0, 0.3, (5, 3))
    registration = register_points(moving, mapped(pose(3), moving) + noise)
    affine = np.array([[0, 0, 9.0, -50], [0, 8.0, 0, -40], [12.0, 0, 0, -60], [0, 0, 0, 1.0]])
    volume = CTVolume.from_array(np.zeros((3, 4, 5)), affine)
    tre = registration.tre_map(volume)
    kji = np.moveaxis(np.indices(tre.values.shape), 0, -1).reshape(-1, 3).astype(float)
    expected = registration.tre_rms_mm(volume.grid.positions_mm(kji))
    np.testing.assert_allclose(tre.values.ravel(), expected, rtol=1e-5)
    assert tre.to_sitk()[4, 3, 2] == tre.values[2, 3, 4]
    with pytest.raises(UsageError, match=r"ndarray is given for .*, expected CTVolume or ScalarMap; .*from_array"):
        registration.tre_map(tre.values)  # type: ignore[arg-type]
