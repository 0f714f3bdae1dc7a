"""Least-squares rigid fits of paired points: closed form, and maximum likelihood for stated covariances.

All functions work on stacks: leading axes ``...`` are independent registrations, fitted together.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ronnaplan.bounds import LARGEST_SPREAD_MM, SMALLEST_SPREAD_MM
from ronnaplan.errors import InputError
from ronnaplan.geometry import FloatArray
from ronnaplan.minimize import minimize
from ronnaplan.transforms import about, exponential, nearest_rotations, point_jacobian, rigid, transform_points

COLLINEARITY_TOLERANCE = 1e-3
"""Second singular value of the centered points over the first below which they count as one line (0.1 mm in 10
cm)."""
CONVERGED_STEP = 1e-10
"""A fit has settled when no update (rad about the centroid; mm) is larger; far below any marker's error."""
MAXIMUM_ITERATIONS = 100
"""A fit that takes more updates has not settled: its pairs contradict each other."""
LARGEST_SPURIOUS_SHARE = 0.9
"""At most so much of the information about a rotation is taken for the points' own noise; second order ends there."""


def require_spread(points_mm: FloatArray, name: str) -> None:
    """Raise `InputError` unless ``points_mm`` (..., N, 3) are three or more points off one line, and in mm."""
    count = points_mm.shape[-2]
    if count < 3:
        raise InputError(
            f"{count} paired {name} were given; a rigid registration needs at least three off one line"
        )
    if not spans_a_plane(points_mm):
        raise InputError(
            f"the {name} lie on one line (or coincide), so the rotation about it is undetermined; "
            "use at least three markers that form a triangle"
        )
    require_millimetres(points_mm, f"the {name}")


def require_millimetres(points_mm: FloatArray, name: str) -> None:
    """Raise `InputError` where a set of ``points_mm`` (..., N, 3) spreads over less or more than can be in mm."""
    extents = np.linalg.norm(np.ptp(points_mm, axis=-2), axis=-1).ravel()
    beyond = extents[~((extents >= SMALLEST_SPREAD_MM) & (extents <= LARGEST_SPREAD_MM))]
    if beyond.size:
        raise InputError(
            f"{name} spread over {beyond[0]:.6g}, expected {SMALLEST_SPREAD_MM:g} to {LARGEST_SPREAD_MM:g} mm; "
            "convert the coordinates to millimetres"
            + (
                ", or, if they are in mm, read points at different places"
                if beyond[0] < SMALLEST_SPREAD_MM
                else ""
            )
        )


def spans_a_plane(points_mm: FloatArray) -> bool:
    """Tell whether every set of ``points_mm`` (..., N, 3) has points off one line."""
    spread = np.linalg.svd(points_mm - points_mm.mean(axis=-2, keepdims=True), compute_uv=False)
    return not bool((spread[..., 1] <= COLLINEARITY_TOLERANCE * spread[..., 0]).any())


def freedom(pairs: int) -> int:
    """Return how many components of the residuals of so many pairs a fit leaves free: 3 N - 6."""
    return 3 * pairs - 6


def fit_probability(chi_square: float, pairs: int) -> float:
    """Return the chance that errors as stated leave so many pairs a ``chi_square`` as large, or larger."""
    from scipy.special import gammaincc

    return float(gammaincc(freedom(pairs) / 2, chi_square / 2))


def fre_rms_mm(matrix: FloatArray, moving_mm: FloatArray, fixed_mm: FloatArray) -> FloatArray:
    """Return the fiducial registration error (...) of ``matrix`` (..., 4, 4): root of Eq. 1's mean squared residual."""
    residual = fixed_mm - transform_points(matrix, moving_mm)
    return np.asarray(np.sqrt((residual**2).sum(axis=-1).mean(axis=-1)))


def fit_closed_form(
    moving_mm: FloatArray, fixed_mm: FloatArray, *, weights: FloatArray | None = None
) -> FloatArray:
    """Return the rotation and translation (..., 4, 4) that minimize Eq. 1, never a reflection.

    ``moving_mm``, ``fixed_mm``: (..., N, 3), paired row by row; ``weights``: (..., N), equal when left out.
    The rotation is the one nearest to the cross-covariance (Kabsch 1978, Umeyama 1991), without scale.
    """
    share = np.ones(moving_mm.shape[:-1]) if weights is None else np.asarray(weights)
    share = (share / share.sum(axis=-1, keepdims=True))[..., None]
    from_center = (share * moving_mm).sum(axis=-2, keepdims=True)
    to_center = (share * fixed_mm).sum(axis=-2, keepdims=True)
    cross = (share * (fixed_mm - to_center)).swapaxes(-1, -2) @ (moving_mm - from_center)
    rotation = nearest_rotations(cross)
    return rigid(rotation, to_center[..., 0, :] - (rotation @ from_center[..., 0, :, None])[..., 0])


def fit_likelihood(
    moving_mm: FloatArray, fixed_mm: FloatArray, moving_mm2: FloatArray, fixed_mm2: FloatArray
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return the maximum-likelihood (..., 4, 4) for points of both sides with covariances (..., N, 3, 3).

    Minimizes ``sum r' (R Cm R' + Cf)^-1 r`` over rotations and translations from the closed form, by damped
    Gauss-Newton steps on SE(3). The Jacobian is taken at the moving points corrected by their share of the
    residual, which makes the gradient that of the full errors-in-variables likelihood (Balachandran &
    Fitzpatrick 2009, Proc. SPIE 7261:726103, and Danilchenko & Fitzpatrick 2011, IEEE TMI 30:679, iterate
    with the weights alone). Also returns which fits (...) settled; pairs that contradict each other far
    beyond their errors may not.
    """
    points = (moving_mm, fixed_mm, moving_mm2, fixed_mm2)
    size = np.trace(moving_mm2, axis1=-2, axis2=-1) + np.trace(fixed_mm2, axis1=-2, axis2=-1)
    matrix = fit_closed_form(moving_mm, fixed_mm, weights=1.0 / size)
    center = fixed_mm.mean(axis=-2)

    def moved(place: FloatArray, step: FloatArray) -> FloatArray:
        turn = exponential(step[..., :3])
        return rigid(turn, center + step[..., 3:] - (turn @ center[..., None])[..., 0]) @ place

    found = minimize(
        lambda place: _linearize(place, center, *points),
        matrix,
        lambda step, _promise, _cost: np.abs(step).max(axis=-1) < CONVERGED_STEP,
        most_steps=MAXIMUM_ITERATIONS,
        moved=moved,
    )
    return found.place, found.settled


def _linearize(
    matrix: FloatArray,
    center: FloatArray,
    moving_mm: FloatArray,
    fixed_mm: FloatArray,
    moving_mm2: FloatArray,
    fixed_mm2: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return misfit (...), descent direction (..., 6) and information (..., 6, 6) about ``center`` (..., 3)."""
    rotation = matrix[..., None, :3, :3]
    carried = rotation @ moving_mm2 @ rotation.swapaxes(-1, -2)
    residual = fixed_mm - transform_points(matrix, moving_mm)
    weight = np.linalg.inv(carried + fixed_mm2)
    pull = (weight @ residual[..., None])[..., 0]
    corrected = fixed_mm - residual + (carried @ pull[..., None])[..., 0]
    jacobian = point_jacobian(corrected - center[..., None, :])
    transposed = jacobian.swapaxes(-1, -2)
    information = (transposed @ weight @ jacobian).sum(axis=-3)
    gradient = (transposed @ pull[..., None]).sum(axis=-3)[..., 0]
    return np.asarray((residual * pull).sum(axis=(-2, -1))), gradient, information


def pose_covariance(
    mapped_mm: FloatArray,
    combined_mm2: FloatArray,
    remaining_mm2: FloatArray | None = None,
    own_mm2: FloatArray | None = None,
) -> FloatArray:
    """Return the covariance (..., 6, 6) of a fitted pose, in the convention of `ronnaplan.pose`.

    ``mapped_mm`` (..., N, 3) are the moving points in the fixed frame and ``combined_mm2`` (..., N, 3, 3) the
    covariance of their residuals. This is the Cramer-Rao bound of the likelihood, so it holds for anisotropic and
    unequal errors; for equal isotropic ones it is Eq. 46 of Fitzpatrick, West & Maurer (1998, IEEE TMI 17:694).

    That is first order in the errors. With ``remaining_mm2`` (..., N, 3, 3), the error that points keep when both sides
    are read (`remaining_error`), it is second order (cf. Fuller 1987, Measurement Error Models): the errors of the two
    sides turn against each other as well, by as much as ``remaining_mm2`` seems to tell of the rotation. And
    ``own_mm2``, the error that ``mapped_mm`` themselves have (none where left out, as of planned points), lets points
    near a line look wider than they are; what it seems to tell of the rotation is taken off.
    """
    center = mapped_mm.mean(axis=-2)
    weight = np.asarray(np.linalg.inv(combined_mm2), dtype=np.float64)
    jacobian = point_jacobian(mapped_mm - center[..., None, :])
    seen = (jacobian.swapaxes(-1, -2) @ weight @ jacobian).sum(axis=-3)
    spread = np.linalg.inv(seen)
    if remaining_mm2 is not None:
        spurious = np.zeros((3, 3)) if own_mm2 is None else _turning_information(own_mm2, weight)
        spread = _second_order(seen, spread, spurious, _turning_information(remaining_mm2, weight))
    move = about(-center)  # the origin, as seen from the centroid
    covariance: FloatArray = move @ spread @ move.swapaxes(-1, -2)
    return covariance


def corrected_points(
    matrix: FloatArray, moving_mm: FloatArray, fixed_mm: FloatArray, moving_mm2: FloatArray, fixed_mm2: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return where the points (..., N, 3) most likely are in the fixed frame, from both sides, and what error is left.

    The error (..., N, 3, 3) is zero where one side is exact.
    """
    rotation = matrix[..., None, :3, :3]
    carried = rotation @ moving_mm2 @ rotation.swapaxes(-1, -2)
    mapped = transform_points(matrix, moving_mm)
    gain = carried @ np.linalg.inv(carried + fixed_mm2)
    corrected = mapped + (gain @ (fixed_mm - mapped)[..., None])[..., 0]
    return corrected, remaining_error(carried, fixed_mm2)


def remaining_error(one_mm2: FloatArray, other_mm2: FloatArray) -> FloatArray:
    """Return the covariance (..., 3, 3) that points have left when both readings, of these covariances, are joined."""
    remaining: FloatArray = one_mm2 - one_mm2 @ np.linalg.inv(one_mm2 + other_mm2) @ one_mm2
    return remaining


def _turning_information(covariances_mm2: FloatArray, weight: FloatArray) -> FloatArray:
    """Return the information (..., 3, 3) about a rotation that points hold by their errors alone, on average.

    That is the mean of ``[e]x' weight [e]x``, summed over the points, for errors ``e`` of the given covariances.
    """
    identity = np.eye(3)
    product = covariances_mm2 @ weight
    sizes, weights, products = (
        np.trace(m, axis1=-2, axis2=-1)[..., None, None] for m in (covariances_mm2, weight, product)
    )
    mean = (sizes * weights - products) * identity - weights * covariances_mm2 - sizes * weight
    information: FloatArray = (mean + product + product.swapaxes(-1, -2)).sum(axis=-3)
    return information


def _second_order(seen: FloatArray, spread: FloatArray, spurious: FloatArray, noise: FloatArray) -> FloatArray:
    """Return the covariance (..., 6, 6) when a part of the information ``seen`` is ``spurious``.

    ``spread`` is the inverse of ``seen``; ``noise`` is what the errors of both sides together add to the scatter of the
    likelihood's slope. It and ``spurious`` are about the rotation, (..., 3, 3).
    """
    root = np.linalg.cholesky(spread[..., :3, :3])
    share, axes = np.linalg.eigh(root.swapaxes(-1, -2) @ spurious @ root)
    back = np.linalg.solve(root.swapaxes(-1, -2), axes)
    true = seen.copy()
    true[..., :3, :3] -= (back * np.minimum(share, LARGEST_SPURIOUS_SHARE)[..., None, :]) @ back.swapaxes(-1, -2)
    scatter = true.copy()
    scatter[..., :3, :3] += noise
    bread = np.linalg.inv(true)
    covariance: FloatArray = bread @ scatter @ bread
    return covariance
