"""Pivot calibration: the tip of a tool from poses taken while the tip rests in a divot, slips told and left out.

Every pose gives ``rotation @ tip + translation = pivot``. The sum of the residuals' *lengths* is minimized (the
spatial median's criterion), which is convex and lets no pose pull harder than another; poses that lie far off
are then left out. Trackers filter their poses, so residuals are correlated in time and the covariance must
count that.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ronnaplan.errors import InputError
from ronnaplan.geometry import FloatArray
from ronnaplan.pose import as_pose

SLIP_SDS = 6.0
"""A pose whose residual is longer than this many robust standard deviations (per axis) has slipped."""
MAXWELL_MEDIAN = 1.5382
"""Median length of a 3D normal vector of unit standard deviation per axis."""
SMALLEST_TURN_DEG = 10.0
"""The tool's axes must spread by this much over the poses, or the tip is not determined."""
SOFTENING_MM = 0.01
"""Rounds the length's kink at zero, well below any tracker's noise."""
MEMORY_TIMES = 5
"""The covariance counts correlations up to this many decorrelation times."""
MAXIMUM_ITERATIONS = 300
CONVERGED_MM = 1e-7


@dataclass(frozen=True, eq=False)
class PivotCalibration:
    """The tip found by pivoting, what it is worth, and which poses were left out."""

    tip_mm: FloatArray
    """Tip (3,) in the tool's frame."""
    tip_covariance_mm2: FloatArray
    """Covariance (3, 3) of the tip, correlations between successive poses counted."""
    pivot_mm: FloatArray
    """The divot (3,) in the tracker's frame."""
    pivot_covariance_mm2: FloatArray
    residuals_mm: FloatArray
    """Distance of each pose's tip from the pivot (N,), slipped poses included."""
    slipped: np.ndarray[tuple[int], np.dtype[np.bool_]]
    """Which poses (N,) were left out, because their tip lies too far from the pivot."""
    sd_mm: float
    """Robust standard deviation per axis of the tip's scatter about the pivot."""

    @property
    def rms_mm(self) -> float:
        """RMS distance of the tip from the pivot over the poses kept."""
        return float(np.sqrt(np.mean(self.residuals_mm[~self.slipped] ** 2)))

    @property
    def slips(self) -> tuple[tuple[int, int], ...]:
        """Runs (first, last) of successive poses that slipped."""
        index = np.flatnonzero(self.slipped)
        runs = np.split(index, np.flatnonzero(np.diff(index) > 1) + 1) if index.size else []
        return tuple((int(run[0]), int(run[-1])) for run in runs)


def calibrate_pivot(poses: ArrayLike) -> PivotCalibration:
    """Return the tip of a tool from ``poses`` (N, 4, 4), tracker from tool in mm, in the order of recording.

    Raises `InputError` for a matrix that is no pose (left-handed, scaled, not finite), for fewer than ten
    poses, and for poses that turn the tool too little, or about one axis only.
    """
    try:
        offered = np.asarray(poses, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError("pivot poses are not numbers; expected (N, 4, 4)") from error
    if offered.ndim != 3 or len(offered) < 10:
        raise InputError(f"pivot poses have shape {offered.shape}; expected (N, 4, 4) with ten poses or more")
    matrices = np.array([as_pose(matrix, f"pivot pose {i}") for i, matrix in enumerate(offered)])
    _require_turning(matrices[:, :3, :3])
    design = np.concatenate([matrices[:, :3, :3], np.broadcast_to(-np.eye(3), (len(matrices), 3, 3))], axis=2)
    shift = -matrices[:, :3, 3]
    solution, kept = _fit_without_slips(design, shift)
    residual = design @ solution - shift
    length = np.linalg.norm(residual, axis=1)
    covariance = _covariance(design, np.where(kept[:, None], residual, 0.0), kept)
    return PivotCalibration(
        solution[:3],
        covariance[:3, :3],
        solution[3:],
        covariance[3:, 3:],
        length,
        ~kept,
        float(np.median(length) / MAXWELL_MEDIAN),
    )


def _fit_without_slips(
    design: FloatArray, shift: FloatArray
) -> tuple[FloatArray, np.ndarray[tuple[int], np.dtype[np.bool_]]]:
    kept = np.ones(len(design), dtype=bool)
    solution = _least_lengths(design, shift)
    for _ in range(MAXIMUM_ITERATIONS):
        length = np.linalg.norm(design @ solution - shift, axis=1)
        closer = length <= SLIP_SDS * max(float(np.median(length)) / MAXWELL_MEDIAN, SOFTENING_MM)
        if (closer == kept).all():
            break
        kept = closer
        solution = _least_lengths(design[kept], shift[kept])
    return solution, kept


def _least_lengths(design: FloatArray, shift: FloatArray) -> FloatArray:
    """Return the (6,) that minimizes the sum of lengths of ``design @ x - shift``, by reweighted least squares."""
    weight = np.ones(len(design))
    solution = np.full(6, np.inf)
    for _ in range(MAXIMUM_ITERATIONS):
        weighted = design * weight[:, None, None]
        normal = np.einsum("nij,nik->jk", weighted, design)
        update = np.linalg.solve(normal, np.einsum("nij,ni->j", weighted, shift))
        done = np.abs(update - solution).max() < CONVERGED_MM
        solution = update
        if done:
            break
        weight = 1.0 / np.sqrt(((design @ solution - shift) ** 2).sum(axis=1) + SOFTENING_MM**2)
    return solution


def _covariance(
    design: FloatArray, residual: FloatArray, kept: np.ndarray[tuple[int], np.dtype[np.bool_]]
) -> FloatArray:
    """Return the (6, 6) sandwich covariance of the estimate, robust to heavy tails and to correlation in time.

    The meat sums the scores' autocovariances with Bartlett's window (Newey & West 1987, Econometrica 55:703).
    That window and the fit itself take some of the correlation away: the last factor gives it back, so that the
    result is not smaller than a block bootstrap's.
    """
    length = np.sqrt((residual**2).sum(axis=1) + SOFTENING_MM**2)
    unit = residual / length[:, None]
    bend = (np.eye(3) - unit[:, :, None] * unit[:, None, :]) / length[:, None, None] * kept[:, None, None]
    bread = np.linalg.inv(np.einsum("nij,nik,nkl->jl", design, bend, design))
    scores = np.einsum("nij,ni->nj", design, unit)
    meat = scores.T @ scores
    window = min(MEMORY_TIMES * _decorrelation(scores), len(scores) // 4)
    for lag in range(1, window + 1):
        product = scores[lag:].T @ scores[:-lag]
        meat += (1 - lag / (window + 1)) * (product + product.T)
    covariance: FloatArray = bread @ meat @ bread * (len(scores) / (len(scores) - 2 * window))
    return covariance


def _decorrelation(scores: FloatArray) -> int:
    """Return the lag at which every score's autocorrelation has fallen below 1/e."""
    variance = (scores**2).sum(axis=0)
    for lag in range(1, len(scores) // 4):
        if ((scores[lag:] * scores[:-lag]).sum(axis=0) < np.exp(-1) * variance).all():
            return lag
    return max(1, len(scores) // 4)


def _require_turning(rotations: FloatArray) -> None:
    """Raise `InputError` unless the poses turn about at least two axes."""
    information = np.einsum("nij,nik->jk", rotations - rotations.mean(axis=0), rotations - rotations.mean(axis=0))
    weakest = float(np.linalg.eigvalsh(information)[0]) / len(rotations)
    spread = float(np.degrees(np.sqrt(max(weakest, 0.0))))
    if spread < SMALLEST_TURN_DEG / 2:
        raise InputError(
            f"the pivot poses turn the tool by {spread:.2g} degrees RMS in their weakest direction; "
            "tilt it by 30 degrees or more about two axes while the tip rests"
        )
