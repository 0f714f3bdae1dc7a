"""Pivot calibration: the tip of a tool from poses taken while the tip rests in a divot, slips told and left out.

Every pose gives ``rotation @ tip + translation = pivot``. Slips are told from the fit that minimizes the sum of the
residuals' *lengths* (the spatial median's criterion), which is convex and lets no pose pull harder than another. The
other poses are fitted by least squares; places and orientations may drift steadily. Trackers filter their poses, so
residuals are correlated in time, and the covariance counts that. Of a tool that is held still few poses count
(`rests`): beside all of them those that move would have slipped.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ronnaplan.errors import InputError, RefusedError
from ronnaplan.geometry import FloatArray, rms_mm
from ronnaplan.pose import as_poses, as_stack, first_told
from ronnaplan.robot.memory import Equations, least_squares, least_squares_covariance
from ronnaplan.robot.misread import misread_as
from ronnaplan.robot.rests import beside_rests
from ronnaplan.robot.scatter import MOST_WRONG, robust_sd, too_long, too_long_for_direction
from ronnaplan.text import counted, place, successive
from ronnaplan.transforms import cross_matrix

FEWEST_FOR_SCATTER = 10
"""Of fewer the scatter is not known, however often each is repeated."""
SMALLEST_TURN_DEG = 5.0
"""RMS turn of the tool's axis that turns least, which the poses need: below it the tip along it is not determined."""
LARGEST_RMS_MM = 10.0
"""A tip whose places scatter by more did not rest in a divot, or the poses are no tool's: no tracker errs so much."""
LONGEST_TOOL_MM = 800.0
"""No tool's tip is farther from its markers; a tracker's divot is, and takes its place where poses are inverted."""
SOFTENING_MM = 0.01
"""Rounds the length's kink at zero, well below any tracker's noise."""
MAXIMUM_ITERATIONS = 300
"""Rounds at most, in which poses are left out, and in which lengths are weighed anew."""
CONVERGED_MM = 1e-7
"""Tip and pivot are found where a round moves neither by more."""
CONSTANTS = 6
"""The unknowns are tip and pivot, ..."""
IN_TRACKER, IN_TOOL = slice(6, 12), slice(12, 15)
"""... steady drifts of place and orientation in the tracker's axes, and of the tip in the tool's."""


@dataclass(frozen=True, eq=False, repr=False)
class PivotCalibration:
    """The tip found by pivoting, what it is worth, and which poses were left out."""

    tip_mm: FloatArray
    """Tip (3,) in the tool's frame; if the tool's own errors drift steadily, in the middle of the poses that count."""
    tip_covariance_mm2: FloatArray
    """Covariance (3, 3) of the tip, correlations between successive poses counted."""
    pivot_mm: FloatArray
    """The divot (3,) in the tracker's frame, in the middle of the poses that count."""
    pivot_covariance_mm2: FloatArray
    residuals_mm: FloatArray
    """Distance of each pose's tip from the pivot (N,), slipped poses included."""
    slipped: np.ndarray[tuple[int], np.dtype[np.bool_]]
    """Which poses (N,) were left out, because their tip lies too far from the pivot."""
    sd_mm: float
    """Robust standard deviation per axis of the tip's scatter about the pivot."""
    repeated: np.ndarray[tuple[int], np.dtype[np.bool_]]
    """Which poses (N,) were left out, because they are an earlier one to the last digit."""
    rested: np.ndarray[tuple[int], np.dtype[np.bool_]]
    """Which poses (N,) were left out, because the tool was held still and others of that rest count."""

    def __repr__(self) -> str:
        error_mm = rms_mm(self.tip_covariance_mm2)
        used = f"{self.kept.sum()} of {len(self.kept)} poses, {self.rms_mm:.3g} mm RMS left"
        return f"PivotCalibration(tip at {place(self.tip_mm)} mm, error {error_mm:.3g} mm RMS, by {used})"

    @property
    def kept(self) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
        """Which poses (N,) count."""
        return ~(self.slipped | self.repeated | self.rested)

    @property
    def rms_mm(self) -> float:
        """RMS distance of the tip from the pivot over the poses kept."""
        return float(np.sqrt(np.mean(self.residuals_mm[self.kept] ** 2)))

    @property
    def doubts(self) -> tuple[str, ...]:
        """What makes the recording look as if the tracker had not seen the tool all the time."""
        if not self.repeated.any():
            return ()
        return (
            f"poses that are an earlier one to the last digit were left out, {self.repeated.sum()} of "
            f"{len(self.repeated)}: look whether the tool was hidden then",
        )

    @property
    def slips(self) -> tuple[tuple[int, int], ...]:
        """Runs (first, last) of successive poses that slipped."""
        return tuple(successive(np.flatnonzero(self.slipped).tolist()))


def calibrate_pivot(poses: ArrayLike) -> PivotCalibration:
    """Return the tip of a tool from ``poses`` (N, 4, 4), tracker from tool in mm, in the order of recording.

    Raises `InputError` for a matrix that is no pose (left-handed, scaled, not finite), for poses in metres, for fewer
    than ten different ones, and for such as turn the tool too little, or about one axis only; `RefusedError` where no
    tip rested, or one did in too few poses, or in such as hardly turn the tool, or it lies where no tool's is.
    """
    offered = as_stack(poses, "pivot poses")
    told, which = first_told(offered)
    different = len(told)
    if different < FEWEST_FOR_SCATTER:
        distinct = counted(different, "different pose" if different < len(offered) else "pose")
        raise InputError(
            f"the pivot has {distinct}, expected {FEWEST_FOR_SCATTER} or more; "
            "turn the tool about the divot to all sides while it is recorded"
        )
    matrices = as_poses(offered, "pivot pose")[told]
    telling = beside_rests(matrices[:, :3, :3])
    _require_turning(matrices[telling, :3, :3])
    design, shift = _equations(matrices)
    rotation, still = design[..., :3], design[..., 3:]
    slipped, steady = _slips(design, shift, telling)
    kept = telling & ~slipped
    sd_mm = robust_sd(np.linalg.norm(design @ steady - shift, axis=1)[telling], SOFTENING_MM)
    levers = cross_matrix(rotation @ (steady[:3] / max(float(np.linalg.norm(steady[:3])), SOFTENING_MM)))
    time = np.linspace(-1, 1, len(matrices))[:, None, None]
    time = time - time[kept].mean()  # drifts are told to the middle of what counts, not to that of a rest
    design = np.concatenate([design / sd_mm, time * still, time * levers, time * rotation], axis=2)
    solution, _ = least_squares(design[kept], shift[kept] / sd_mm, CONSTANTS)
    residual = design @ solution - shift / sd_mm
    covariance = _covariance(design[kept], residual[kept], rotation[kept], levers[kept], solution)
    length = np.linalg.norm(residual, axis=1) * sd_mm
    repeated = told[which] != np.arange(len(offered))
    found = PivotCalibration(
        tip_mm=solution[:3],
        tip_covariance_mm2=covariance[:3, :3],
        pivot_mm=solution[3:6],
        pivot_covariance_mm2=covariance[3:6, 3:6],
        residuals_mm=length[which],
        slipped=slipped[which] & ~repeated,
        sd_mm=robust_sd(length[telling], 0.0),
        repeated=repeated,
        rested=~(telling | slipped)[which] & ~repeated,
    )
    _require_tip(found, matrices)
    return found


def _equations(poses: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return what tip and pivot (6,) are multiplied by, and what it gives, of poses (N, 4, 4)."""
    rotation = poses[:, :3, :3]
    return np.concatenate([rotation, np.broadcast_to(-np.eye(3), rotation.shape)], axis=2), -poses[:, :3, 3]


def _usual_length_mm(poses: FloatArray) -> float:
    """Return how far the tip usually is from the pivot by least squares of poses (N, 4, 4), of whatever kind."""
    design, shift = _equations(poses)
    solution = np.linalg.lstsq(design.reshape(-1, 6), shift.ravel(), rcond=None)[0]
    return float(np.median(np.linalg.norm(design @ solution - shift, axis=1)))


def _covariance(
    design: FloatArray, residual: FloatArray, rotation: FloatArray, levers: FloatArray, solution: FloatArray
) -> FloatArray:
    """Return the covariance of the ``solution``; noise and drift are in the tracker's axes or in the tool's.

    In the tool's axes an orientation that errs moves the tip as a place that errs does; in the tracker's it acts on
    the tip by ``levers`` (N, 3, 3), which turn with the tool.
    """
    in_tool = rotation.transpose(0, 2, 1)
    frames = [
        Equations(design, residual, IN_TRACKER, levers),
        Equations(in_tool @ design, (in_tool @ residual[..., None])[..., 0], IN_TOOL),
    ]
    return least_squares_covariance(frames, solution, CONSTANTS)[0]


def _require_tip(found: PivotCalibration, poses: FloatArray) -> None:
    """Raise `RefusedError` unless ``found`` of ``poses`` (N, 4, 4) is the tip of a tool that rested in a divot."""
    if found.rms_mm > LARGEST_RMS_MM:
        said = (
            f"the tip did not rest: its places scatter by {found.rms_mm:.2f} mm RMS, expected at most "
            f"{LARGEST_RMS_MM:g}"
        )
        if misread := misread_as(poses, lambda meant: _usual_length_mm(meant) < LARGEST_RMS_MM):
            raise RefusedError(
                f"{said}; it rested if in the poses {misread}: turn them into matrices, or a quaternion, anew"
            )
        raise RefusedError(
            f"{said}; check that the recording is of poses about one divot, tracker from tool in mm"
        )
    away_mm = float(np.linalg.norm(found.tip_mm))
    if away_mm > LONGEST_TOOL_MM:
        raise RefusedError(
            f"the tip lies {away_mm:.0f} mm from the tool's origin, expected at most {LONGEST_TOOL_MM:g}; check that "
            "the poses are tracker from tool, and not the other way round"
        )


def _slips(
    design: FloatArray, shift: FloatArray, telling: np.ndarray[tuple[int], np.dtype[np.bool_]]
) -> tuple[np.ndarray[tuple[int], np.dtype[np.bool_]], FloatArray]:
    """Return which poses (N,) slipped, and the tip and pivot (6,), told by those ``telling`` (N,) that did not.

    Raises `RefusedError` where these are too few, or the tool hardly turned in them.
    """
    slipped = np.zeros(len(design), dtype=bool)
    solution = _least_lengths(design[telling], shift[telling])
    for far in (too_long, too_long_for_direction):  # many slips one way would be taken for the shape of the others
        for _ in range(MAXIMUM_ITERATIONS):
            in_tracker = design @ solution - shift
            in_tool = (in_tracker[:, None] @ design[..., :3])[:, 0]
            farther = far((in_tracker, in_tool), SOFTENING_MM, telling)
            if (farther == slipped).all():
                break
            slipped = farther
            solution = _least_lengths(design[telling & ~slipped], shift[telling & ~slipped])
    count, of_all = int((telling & slipped).sum()), int(telling.sum())
    turn_deg = _turn_deg(design[telling & ~slipped, :, :3])
    if count > MOST_WRONG * of_all or turn_deg < SMALLEST_TURN_DEG:
        raise RefusedError(
            f"the tips of {count} of {of_all} poses lie apart from the others', which turn the tool by "
            f"{turn_deg:.2g} degrees RMS in their weakest direction; expected a third or fewer, and "
            f"{SMALLEST_TURN_DEG:g} degrees: else it is open which slipped; record anew, with the tip in the divot "
            "from the first pose to the last"
        )
    return slipped, solution


def _least_lengths(design: FloatArray, shift: FloatArray) -> FloatArray:
    """Return the (6,) that minimizes the sum of lengths of ``design @ x - shift``, by reweighted least squares."""
    weight = np.ones(len(design))
    solution = np.full(6, np.inf)
    for _ in range(MAXIMUM_ITERATIONS):
        weighted = design * weight[:, None, None]
        normal = np.einsum("nij,nik->jk", weighted, design)
        pulled = np.einsum("nij,ni->j", weighted, shift)
        update = np.linalg.lstsq(normal, pulled, rcond=None)[0]  # of poses at rest alone, too
        done = np.abs(update - solution).max() < CONVERGED_MM
        solution = update
        if done:
            break
        weight = 1.0 / np.sqrt(((design @ solution - shift) ** 2).sum(axis=1) + SOFTENING_MM**2)
    return solution


def _require_turning(rotations: FloatArray) -> None:
    """Raise `InputError` unless poses (N, 3, 3) turn each axis of the tool, and so about two axes at least."""
    turn_deg = _turn_deg(rotations)
    if turn_deg < SMALLEST_TURN_DEG:
        raise InputError(
            f"the pivot poses turn the tool by {turn_deg:.2g} degrees RMS in their weakest direction, expected "
            f"{SMALLEST_TURN_DEG:g} or more; tilt it by 30 degrees or more about two axes while the tip rests"
        )


def _turn_deg(rotations: FloatArray) -> float:
    """Return the RMS turn of the axis of the tool that poses of ``rotations`` (N, 3, 3) turn least."""
    off = rotations - rotations.mean(axis=0)
    information = np.einsum("nij,nik->jk", off, off)
    weakest = float(np.linalg.eigvalsh(information)[0]) / len(rotations)
    return float(np.degrees(np.sqrt(max(weakest, 0.0))))
