"""Hand-eye calibration over many poses: M from TCP and robot from tracker together.

At every pose ``robot_from_tcp = robot_from_ots @ ots_from_m @ m_from_tcp``. The start is a closed form
(`hand_eye_start`); then all twelve unknowns are fitted together with steady drifts of the tracker and of M on
the tool, rotations and translations weighted by the scatter they turn out to have. The errors are taken as the
tracker's, and the covariance counts that those of successive poses may be correlated.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from ronnaplan.errors import InputError, RefusedError, check_type
from ronnaplan.geometry import FloatArray
from ronnaplan.pose import Pose, as_poses, first_told
from ronnaplan.robot.by_pose import Cause, Suspicion
from ronnaplan.robot.by_pose_fields import fields, shows_scale
from ronnaplan.robot.chain import OTS, TCP, M, R
from ronnaplan.robot.hand_eye_fit import CONSTANTS, IN_TOOL, IN_TRACKER, Fit, design_of, refine, turned
from ronnaplan.robot.hand_eye_found import HandEye
from ronnaplan.robot.hand_eye_late import Late, Matched, how_late
from ronnaplan.robot.hand_eye_refused import agree, contradiction, rms
from ronnaplan.robot.hand_eye_start import closed_form, discrepancies, far_off, out_of_step
from ronnaplan.robot.hand_eye_step import step_in
from ronnaplan.robot.memory import Equations, least_squares_covariance
from ronnaplan.robot.pivot import LONGEST_TOOL_MM
from ronnaplan.robot.rests import beside_rests
from ronnaplan.robot.twists import apart, motion
from ronnaplan.transforms import adjoint, carried, invert, point_jacobian

FEWEST_POSES = 4
"""Three poses tell both unknowns, and next to nothing of their errors."""
SMALLEST_TURN_DEG = 5.0
"""RMS turn about the second axis that the poses need; below it the translation along the first is undetermined."""
SAME_TIP_PROBABILITY = 1e-6
"""A pivot calibration that errors as stated would put so far off, and more rarely than this, is of another tip."""
SAME_POSES = 1e-6
"""Poses that nowhere differ by more, in an entry, are of one recording."""


def calibrate_hand_eye(
    ots_from_m: ArrayLike, robot_from_tcp: ArrayLike, *, frames: Sequence[int] | None = None
) -> HandEye:
    """Return M from TCP and R from OTS from simultaneous poses of both.

    ``ots_from_m`` and ``robot_from_tcp`` are (N, 4, 4) in mm; ``frames`` (N,) number them where they are named, from
    zero if they are not given. Raises `InputError` for fewer than `FEWEST_POSES` different poses, unequal numbers,
    matrices that are no poses, and motions that turn about one axis only; `RefusedError` where the poses do not belong
    together, or the TCP lies where no tool's is.
    """
    seen, driven = _as_pairs(ots_from_m, robot_from_tcp, frames)
    told, _ = first_told(seen)
    repeated = len(seen) - len(told)
    if len(told) < FEWEST_POSES:
        raise InputError(
            f"{len(seen)} poses were given, of which {len(told)} of the tracker's differ; expected four or more that do"
        )
    told = told[beside_rests(driven[told, :3, :3], driven[told, :3, 3])]
    rested = len(seen) - repeated - len(told)
    seen, driven = seen[told], driven[told]
    if np.abs(seen - driven).max() < SAME_POSES:
        raise InputError("the poses of robot and tracker are the same; expected a recording of either")
    for whose, poses in (("robot", driven), ("tracker", seen)):
        require_two_axes(poses[:, :3, :3], "M from TCP", whose)
    left, right = closed_form(seen, driven)
    fit = refine(seen, driven, left, right)
    numbers = range(len(told)) if frames is None else [frames[one] for one in told]
    at_once = Matched(seen, driven, numbers, np.arange(len(seen)))
    late = how_late(fit, at_once)
    then = late.poses if late else at_once
    far = np.zeros(len(seen), dtype=np.bool_)
    far[then.rows] = far_off(then.seen, then.driven)
    start = closed_form(then.seen, then.driven) if late else (left, right)
    step = step_in(discrepancies(then.seen, then.driven, *start), design_of(then.seen, start[1], np.ones(6)))
    step = step and step.among(then.rows)
    if not agree(fit.error):
        raise RefusedError(contradiction(fit.error, at_once, far, step, late))
    found = _found(fit, then, late)
    away_mm = float(np.linalg.norm(found.m_from_tcp.translation_mm))
    if away_mm > LONGEST_TOOL_MM:
        raise RefusedError(
            f"the TCP lies {away_mm:.0f} mm from M, expected at most {LONGEST_TOOL_MM:g}; check that the poses are "
            "tracker from tool and robot from TCP, and not both the other way round"
        )
    one_apart = out_of_step(seen, driven, left, right)
    step = None if one_apart or step is None else step.among(told)
    far_ones = tuple(map(int, told[far]))
    return replace(found, far=far_ones, out_of_step=one_apart, step=step, repeated=repeated, rested=rested)


def _as_pairs(
    ots_from_m: ArrayLike, robot_from_tcp: ArrayLike, frames: Sequence[int] | None
) -> tuple[FloatArray, FloatArray]:
    """Return poses (N, 4, 4) of both, as many of either and of ``frames``; raises `InputError` for others."""
    seen = as_poses(ots_from_m, "ots_from_m")
    driven = as_poses(robot_from_tcp, "robot_from_tcp")
    if len(seen) != len(driven) or len(seen) < FEWEST_POSES:
        raise InputError(
            f"{len(seen)} tracker and {len(driven)} robot poses were given; expected as many of each, four or more"
        )
    if frames is not None and len(frames) != len(seen):
        raise InputError(f"{len(frames)} frames were given for {len(seen)} poses; expected one for each")
    if frames is not None and len(set(frames)) < len(frames):
        again = next(number for number, times in Counter(frames).items() if times > 1)
        raise InputError(f"frame {again} was given more than once; expected another for each pose")
    return seen, driven


def with_tip(found: HandEye, tip_mm: FloatArray, tip_mm2: FloatArray) -> HandEye:
    """Return ``found`` with its TCP also taken from a pivot calibration's tip (3,) in M, of covariance (3, 3).

    The two are weighed by their errors, which are independent of each other as the recordings are. Raises
    `RefusedError` where they contradict each other.
    """
    from scipy.special import gammaincc

    check_type(found, HandEye, "what was found", "calibrate_hand_eye returns it")
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
    return replace(found, m_from_tcp=Pose(motion(gain @ off) @ pose.matrix, covariance, M, TCP))


def require_two_axes(rotations: FloatArray, unknown: str, whose: str = "robot") -> None:
    """Raise `InputError` that ``unknown`` is not determined unless poses (N, 3, 3) turn about two axes."""
    from scipy.spatial.transform import Rotation

    turns = Rotation.from_matrix(rotations[0].T @ rotations).as_rotvec()
    spread = np.degrees(np.linalg.svd(turns - turns.mean(axis=0), compute_uv=False)[1] / np.sqrt(len(turns)))
    if spread < SMALLEST_TURN_DEG:
        raise InputError(
            f"the {whose} poses do not determine {unknown}: they turn by {spread:.2g} degrees RMS about their second "
            f"axis, expected {SMALLEST_TURN_DEG:g} or more; turn the robot about two axes, and check that radians were "
            "not taken for degrees"
        )


def _found(fit: Fit, then: Matched, late: Late | None) -> HandEye:
    """Return what poses tell, with its covariance.

    Where the tracker's are ``late``, the robot's of ``then`` are as they were so much earlier, and all is linear about
    what fits these: the way of half a frame, and the turn by which R is off for it, are not.
    """
    seen, driven, frames, _ = then
    near = late.fit if late else fit
    robot_from_m = driven @ invert(near.right)
    ots_from_m = invert(near.left) @ robot_from_m
    suspected = fields(ots_from_m, robot_from_m, driven, near.sds, frames)
    if late is not None:
        off = -np.concatenate([_increment(near.left, fit.left), _increment(near.right, fit.right)])
        moved = suspected.added[Cause.DELAY][..., 0] * (late.delay / suspected.delay)
        near = near._replace(residual=near.residual + near.design[..., :CONSTANTS] @ off + moved)
    covariance, suspicion = _covariance(near, seen, suspected.added)
    if not shows_scale(seen, ots_from_m, near.design[..., :CONSTANTS], near.sds[3]):
        suspicion = suspicion._replace(of_any=suspicion.of_any - suspicion.of_scale, of_scale=0.0)
    rotation_deg, translation_mm = rms(fit.error)
    left, right = fit.left, fit.right
    return HandEye(
        m_from_tcp=Pose(right, carried(right, covariance[6:12, 6:12]), M, TCP),
        robot_from_ots=Pose(left, carried(left, covariance[:6, :6]), R, OTS),
        rotation_rms_deg=rotation_deg,
        translation_rms_mm=translation_mm,
        tcp_rms_mm=float(np.sqrt(((fit.error @ point_jacobian(right[:3, 3]).T) ** 2).sum(axis=1).mean())),
        by_pose=suspected.in_units(suspicion),
    )


def _increment(pose: FloatArray, other: FloatArray) -> FloatArray:
    """Return the right-hand increment (6,) from a ``pose`` (4, 4) to the ``other``, as errors are stated."""
    back = invert(other)
    return adjoint(back) @ apart(invert(pose), back)


def _covariance(fit: Fit, seen: FloatArray, of_fields: dict[Cause, FloatArray]) -> tuple[FloatArray, Suspicion]:
    """Return the covariance of the fit, on the right; noise and drift are in the tool's axes or in the tracker's.

    With it comes how likely errors are that depend on the robot's pose, which add ``of_fields`` (N, 6, s).
    """
    frames = [
        Equations(
            axes @ fit.design,
            (axes @ fit.residual[..., None])[..., 0],
            drifts,
            fields={cause: axes @ field for cause, field in of_fields.items()},
        )
        for axes, drifts in ((np.eye(6), IN_TOOL), (turned(seen), IN_TRACKER))
    ]
    return least_squares_covariance(frames, fit.step, CONSTANTS)
