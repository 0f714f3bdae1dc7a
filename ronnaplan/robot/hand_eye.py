"""Hand-eye calibration over many poses: M from TCP and robot from tracker together.

At every pose ``robot_from_tcp = robot_from_ots @ ots_from_m @ m_from_tcp``. The start is Shah's closed form (2013,
J. Mech. Robot. 5:031007); then all twelve unknowns are fitted together with a steady drift of the tracker, rotations
and translations weighted by the scatter they turn out to have. The errors are taken as the tracker's, and the
covariance counts that those of successive poses may be correlated.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from ronnaplan.errors import InputError, RefusedError
from ronnaplan.geometry import FloatArray
from ronnaplan.pose import Pose, adjoint, as_poses, exponential, invert, point_jacobian, rigid
from ronnaplan.robot.chain import OTS, TCP, M, R
from ronnaplan.robot.memory import least_squares_covariance

SMALLEST_TURN_DEG = 5.0
"""RMS turn about the second axis that the poses need; below it the translation along the first is undetermined."""
LARGEST_ROTATION_DEG, LARGEST_TRANSLATION_MM = 3.0, 10.0
"""Poses of robot and tracker that are off by more (RMS) do not belong together: no tracker errs so much."""
SAME_TIP_PROBABILITY = 1e-6
"""A pivot calibration that errors as stated would put so far off, and more rarely than this, is of another tip."""
SWAPPED = 1.5
"""The tracker's errors are least at its spheres; found larger at M than at the TCP by this, M may be the robot's."""
SAME_POSES = 1e-6
"""Poses that nowhere differ by more, in an entry, are of one recording."""
REWEIGHTINGS = 3


@dataclass(frozen=True)
class HandEye:
    """The two constant poses, their covariance, and how well the recorded poses agree."""

    m_from_tcp: Pose
    robot_from_ots: Pose
    rotation_rms_deg: float
    """RMS over the poses of the angle left."""
    translation_rms_mm: float
    """At M's origin."""
    tcp_rms_mm: float
    """What is left at the TCP."""

    @property
    def doubts(self) -> tuple[str, ...]:
        """What makes the calibration look as if tracker and robot had changed places."""
        if self.translation_rms_mm <= SWAPPED * self.tcp_rms_mm:
            return ()
        return (
            f"the poses of M err by {self.translation_rms_mm:.3f} mm RMS at its origin and by {self.tcp_rms_mm:.3f} mm "
            "at the TCP, as if the TCP were what the tracker sees: check which recording is the tracker's and which "
            "the robot's",
        )


def calibrate_hand_eye(ots_from_m: ArrayLike, robot_from_tcp: ArrayLike) -> HandEye:
    """Return M from TCP and R from OTS from simultaneous poses of both.

    ``ots_from_m`` and ``robot_from_tcp`` are (N, 4, 4) in mm. Raises `InputError` for fewer than four poses,
    unequal numbers, matrices that are no poses, and motions that turn about one axis only; `RefusedError` where the
    poses do not belong together.
    """
    seen = _poses(ots_from_m, "ots_from_m")
    driven = _poses(robot_from_tcp, "robot_from_tcp")
    if len(seen) != len(driven) or len(seen) < 4:
        raise InputError(
            f"{len(seen)} tracker and {len(driven)} robot poses were given; expected four or more of each"
        )
    if np.abs(seen - driven).max() < SAME_POSES:
        raise InputError("the poses of robot and tracker are the same; expected a recording of either")
    require_two_axes(driven[:, :3, :3], "M from TCP")
    left, right = _closed_form(seen, driven)
    found = _refine(seen, driven, left, right)
    if found.rotation_rms_deg > LARGEST_ROTATION_DEG or found.translation_rms_mm > LARGEST_TRANSLATION_MM:
        raise RefusedError(
            f"the poses of robot and tracker contradict each other by {found.rotation_rms_deg:.2f} degrees and "
            f"{found.translation_rms_mm:.2f} mm RMS, expected at most {LARGEST_ROTATION_DEG:g} and "
            f"{LARGEST_TRANSLATION_MM:g}; record both at the same moments"
        )
    return found


def with_tip(found: HandEye, tip_mm: FloatArray, tip_mm2: FloatArray) -> HandEye:
    """Return ``found`` with its TCP also taken from a pivot calibration's tip (3,) in M, of covariance (3, 3).

    The two are weighed by their errors, which are independent of each other as the recordings are. Raises
    `RefusedError` where they contradict each other.
    """
    from scipy.special import gammaincc

    pose = found.m_from_tcp
    jacobian = point_jacobian(pose.translation_mm)
    off = tip_mm - pose.translation_mm
    spread = jacobian @ pose.covariance @ jacobian.T + tip_mm2
    probability = float(gammaincc(3 / 2, off @ np.linalg.solve(spread, off) / 2))
    if probability < SAME_TIP_PROBABILITY:
        raise RefusedError(
            f"the pivot calibration puts the TCP {np.linalg.norm(off):.2f} mm from where the hand-eye calibration "
            "does, more than their errors explain; check that both are of the same tip"
        )
    gain = pose.covariance @ jacobian.T @ np.linalg.inv(spread)
    rest = np.eye(6) - gain @ jacobian
    covariance = rest @ pose.covariance @ rest.T + gain @ tip_mm2 @ gain.T
    return replace(found, m_from_tcp=Pose(_motion(gain @ off) @ pose.matrix, covariance, M, TCP))


def _poses(values: ArrayLike, name: str) -> FloatArray:
    try:
        offered = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name} are not numbers; expected (N, 4, 4)") from error
    if offered.ndim != 3:
        raise InputError(f"{name} have shape {offered.shape}; expected (N, 4, 4)")
    return as_poses(offered, name)


def require_two_axes(rotations: FloatArray, unknown: str) -> None:
    """Raise `InputError` that ``unknown`` is not determined unless robot poses (N, 3, 3) turn about two axes."""
    from scipy.spatial.transform import Rotation

    turns = Rotation.from_matrix(rotations[0].T @ rotations).as_rotvec()
    spread = np.degrees(np.linalg.svd(turns - turns.mean(axis=0), compute_uv=False)[1] / np.sqrt(len(turns)))
    if spread < SMALLEST_TURN_DEG:
        raise InputError(
            f"the robot poses do not determine {unknown}: they turn by {spread:.2g} degrees RMS about their second "
            f"axis, expected {SMALLEST_TURN_DEG:g} or more; turn the robot about two axes"
        )


def _closed_form(seen: FloatArray, driven: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return ``robot_from_ots`` and ``m_from_tcp`` (4, 4): rotations from a Kronecker sum, then translations."""
    kronecker = sum(np.kron(d, s) for d, s in zip(driven[:, :3, :3], seen[:, :3, :3], strict=True))
    u, _, vt = np.linalg.svd(np.asarray(kronecker))
    rotations = [_nearest_rotation(vector.reshape(3, 3)) for vector in (u[:, 0], vt[0])]
    left, right = rotations[0], rotations[1].T
    design = np.concatenate([np.broadcast_to(np.eye(3), (len(seen), 3, 3)), left @ seen[:, :3, :3]], axis=2)
    goal = driven[:, :3, 3] - seen[:, :3, 3] @ left.T
    shifts = np.linalg.lstsq(design.reshape(-1, 6), goal.ravel(), rcond=None)[0]
    return rigid(left, shifts[:3]), rigid(right, shifts[3:])


def _nearest_rotation(matrix: FloatArray) -> FloatArray:
    u, _, vt = np.linalg.svd(matrix * np.sign(np.linalg.det(matrix)))
    rotation: FloatArray = u @ vt
    return rotation


def _refine(seen: FloatArray, driven: FloatArray, left: FloatArray, right: FloatArray) -> HandEye:
    from scipy.optimize import least_squares

    time = np.linspace(-1, 1, len(seen))[:, None]

    def moved(first: FloatArray, second: FloatArray) -> tuple[FloatArray, FloatArray]:
        return left @ _motion(first), right @ _motion(second)

    def misfit(x: FloatArray, weights: FloatArray) -> FloatArray:
        drifting, second = moved(x[:6] + time * x[12:], x[6:12])
        return (_discrepancy(invert(drifting) @ driven @ invert(second), seen) * weights).ravel()

    weights = np.array([1e3, 1e3, 1e3, 1.0, 1.0, 1.0])
    solution = np.zeros(18)
    for _ in range(REWEIGHTINGS):
        fit = least_squares(misfit, solution, args=(weights,), x_scale=np.tile(np.repeat([1e-3, 1], 3), 3))
        solution = fit.x
        error = misfit(solution, np.ones(6)).reshape(-1, 6)
        freedom = 1 - solution.size / error.size
        spread = np.sqrt((error**2).mean(axis=0).reshape(2, 3).mean(axis=1) / freedom)
        weights = np.repeat(1 / np.maximum(spread, 1e-12), 3)
    covariance = _covariance(np.asarray(fit.jac).reshape(-1, 6, 18), np.asarray(fit.fun).reshape(-1, 6), seen)
    robot_from_ots, m_from_tcp = moved(solution[:6], solution[6:12])
    return HandEye(
        Pose(m_from_tcp, _in_target_axes(m_from_tcp, covariance[6:12, 6:12]), M, TCP),
        Pose(robot_from_ots, _in_target_axes(robot_from_ots, covariance[:6, :6]), R, OTS),
        float(np.degrees(np.sqrt((error[:, :3] ** 2).sum(axis=1).mean()))),
        float(np.sqrt((error[:, 3:] ** 2).sum(axis=1).mean())),
        float(np.sqrt(((error @ point_jacobian(m_from_tcp[:3, 3]).T) ** 2).sum(axis=1).mean())),
    )


def _motion(twist: FloatArray) -> FloatArray:
    """Return the motions (..., 4, 4) by rotation vectors in rad and translations in mm (..., 6)."""
    return rigid(exponential(twist[..., :3]), twist[..., 3:])


def _covariance(jacobian: FloatArray, residual: FloatArray, seen: FloatArray) -> FloatArray:
    """Return the covariance (18, 18) of the fit; the noise's memory is in the tool's axes or in the tracker's."""
    turned = np.zeros((len(seen), 6, 6))
    turned[:, :3, :3] = turned[:, 3:, 3:] = seen[:, :3, :3]
    return least_squares_covariance(
        [jacobian, turned @ jacobian], [residual, (turned @ residual[..., None])[..., 0]]
    )


def _discrepancy(predicted: FloatArray, observed: FloatArray) -> FloatArray:
    """Return (N, 6): rotation vector and translation of ``observed^-1 @ predicted``."""
    from scipy.spatial.transform import Rotation

    off = invert(observed) @ predicted
    return np.concatenate([Rotation.from_matrix(off[:, :3, :3]).as_rotvec(), off[:, :3, 3]], axis=1)


def _in_target_axes(matrix: FloatArray, covariance: FloatArray) -> FloatArray:
    """Carry a covariance of right-hand increments ``matrix @ exp(x)`` to the convention of `ronnaplan.pose`."""
    carry = adjoint(matrix)
    carried: FloatArray = carry @ covariance @ carry.T
    return carried
