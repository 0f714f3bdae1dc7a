"""Registration of paired points: the transform, how well the pairs fit, and the error to expect anywhere else."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ronnaplan.display import Shown, coordinates
from ronnaplan.errors import InputError, check_type
from ronnaplan.geometry import FloatArray, Frame, as_points, rms_mm
from ronnaplan.pose import Pose as Pose
from ronnaplan.registration.covariances import (
    Covariances,
    as_pair,
    combined_covariances,
    estimated_variance,
    fitted_pose_covariance,
)
from ronnaplan.registration.flags import LOOSE_ROTATION_DEG, MIRROR_GAIN, RegistrationFlag
from ronnaplan.registration.stretch import explaining_stretch
from ronnaplan.rigid import fit_closed_form, fit_likelihood, fit_probability, fre_rms_mm, freedom, require_spread
from ronnaplan.sigmas import MISFIT_PROBABILITY
from ronnaplan.transforms import invert, point_jacobian, rotation_sd_deg, transform_points

if TYPE_CHECKING:
    from ronnaplan.ct.volume import CTVolume, ScalarMap
    from ronnaplan.figures import Picture

LOG = logging.getLogger(__name__)

MOVING, FIXED = Frame("moving"), Frame("fixed")
"""The frames of points of which nobody said in what frame they are."""


class RegisteredPair(NamedTuple):
    """One pair: its points (3,), each in its own frame, and the length of what is left between them."""

    label: str
    moving_mm: FloatArray
    fixed_mm: FloatArray
    residual_mm: float


@dataclass(frozen=True, eq=False, repr=False)
class Registration(Shown[RegisteredPair]):
    """A rigid registration ``fixed_from_moving`` of N pairs and what it is worth: a sequence of the pairs.

    Residuals and FRE tell how well the *markers* agree; they do not measure the error at a target: `tre` does.
    """

    moving_mm: FloatArray
    """Moving points (N, 3)."""
    fixed_mm: FloatArray
    """Fixed points (N, 3), row by row the partners of the moving ones."""
    covariances_mm2: FloatArray
    """Covariance (N, 3, 3) of fixed minus mapped moving point, in the fixed frame."""
    pose: Pose
    """The fitted ``fixed_from_moving`` with its covariance (6, 6)."""
    labels: tuple[str, ...]
    stated_mm2: tuple[FloatArray, FloatArray] | None = field(repr=False, default=None)
    """The stated covariances (N, 3, 3) of the moving and of the fixed points, each in its own frame; None where none
    were, and they were estimated from the residuals."""
    settled: bool = True
    """Whether the fit converged."""

    def _items(self) -> Sequence[RegisteredPair]:
        rows = zip(self.labels, self.moving_mm, self.fixed_mm, self.residuals_mm.tolist(), strict=True)
        return [RegisteredPair(*row) for row in rows]

    def _headline(self) -> str:
        middle = float(self.tre_rms_mm(self.moving_mm.mean(axis=0, keepdims=True))[0])
        flags = "".join(f", {flag.name.lower()}" for flag in self.flags)
        return (
            f"{len(self.labels)} pairs, FRE {self.fre_rms_mm:.3g} mm, "
            f"expected error at their centroid {middle:.3g} mm{flags}"
        )

    def _columns(self) -> Mapping[str, Sequence[object]]:
        return {
            "label": list(self.labels),
            **coordinates("moving_", list(self.moving_mm)),
            **coordinates("fixed_", list(self.fixed_mm)),
            "residual_mm": self.residuals_mm.tolist(),
        }

    def plot(self) -> Picture:
        """Return the expected error about the markers, in the fixed frame, and the residuals, magnified."""
        from ronnaplan.figures import DOUBT_COLOUR, MARGIN_MM, ThreeViews

        middle, ends = self.fixed_mm.mean(axis=0), self.fixed_mm - self.residual_vectors_mm
        reach_mm = float(np.abs(self.fixed_mm - middle).max()) + MARGIN_MM
        magnified = 10.0 ** np.floor(np.log10(reach_mm / 2 / max(float(self.residuals_mm.max()), 1e-6)))
        views = ThreeViews(f"{self._headline()}; residuals x {magnified:g}", frame=self.pose.to_frame)
        moving_from_fixed = invert(self.transform)
        views.fields(
            lambda places: self.tre_rms_mm(transform_points(moving_from_fixed, places)),
            middle,
            middle - reach_mm,
            middle + reach_mm,
            "expected error, mm RMS",
        )
        drawn = ends + magnified * self.residual_vectors_mm
        views.segments(ends, drawn, [DOUBT_COLOUR] * len(drawn))
        views.points(ends, self.labels)
        return views.picture

    @property
    def errors_stated(self) -> bool:
        """Whether the marker errors were stated by the caller."""
        return self.stated_mm2 is not None

    @property
    def transform(self) -> FloatArray:
        """``fixed_from_moving`` (4, 4), mm."""
        return self.pose.matrix

    @cached_property
    def residual_vectors_mm(self) -> FloatArray:
        """Fixed minus mapped moving point (N, 3), in the fixed frame."""
        return self.fixed_mm - transform_points(self.transform, self.moving_mm)

    @property
    def residuals_mm(self) -> FloatArray:
        """Length of each marker's residual (N,)."""
        lengths: FloatArray = np.linalg.norm(self.residual_vectors_mm, axis=1)
        return lengths

    @property
    def fre_rms_mm(self) -> float:
        """Fiducial registration error: root of the mean squared residual (Eq. 1 of the paper)."""
        return float(fre_rms_mm(self.transform, self.moving_mm, self.fixed_mm))

    @property
    def degrees_of_freedom(self) -> int:
        """Independent residual components, 3 N - 6."""
        return freedom(len(self.moving_mm))

    @cached_property
    def chi_square(self) -> float:
        """Sum of squared residuals in units of their errors; near `degrees_of_freedom` if those are right."""
        whitened = np.linalg.solve(self.covariances_mm2, self.residual_vectors_mm[..., None])[..., 0]
        return float((whitened * self.residual_vectors_mm).sum())

    @property
    def fit_probability(self) -> float | None:
        """Chance that errors as stated give residuals this large or larger; None when no errors were stated."""
        if not self.errors_stated:
            return None
        return fit_probability(self.chi_square, len(self.moving_mm))

    @cached_property
    def stretch(self) -> FloatArray | None:
        """By which shares (3,) the moving points would have to be longer along their axes for the pairs to agree.

        None where no errors were stated, of three pairs, and where distances are right or do not explain the misfit.
        """
        if not self.errors_stated or len(self) == 3:
            return None
        return explaining_stretch(self.transform, self.moving_mm, self.residual_vectors_mm, self.covariances_mm2)

    def tre(self, points_mm: ArrayLike, frame: Frame | None = None) -> FloatArray:
        """Return the covariance (N, 3, 3), in the fixed frame, of the error at moving ``points_mm``.

        Its trace is the expected squared target registration error. ``frame``, if given, must be the moving
        frame (`FrameMismatchError`).
        """
        if frame is not None:
            self.pose.from_frame.require(frame)
        return self.pose.point_covariances(points_mm)

    def tre_rms_mm(self, points_mm: ArrayLike, frame: Frame | None = None) -> FloatArray:
        """Return the expected root-mean-square target registration error (N,) at moving ``points_mm`` (N, 3)."""
        return rms_mm(self.tre(points_mm, frame))

    def tre_map(self, volume: CTVolume | ScalarMap) -> ScalarMap:
        """Return the expected root-mean-square TRE (mm) at every voxel of a scan or a map in the moving frame.

        Raises `FrameMismatchError` for the scan of another frame, where `register_points` was told the moving frame.
        """
        from ronnaplan.registration.maps import error_map

        moving = self.pose.from_frame
        return error_map(self.pose, volume, None if moving == MOVING else moving)

    @property
    def gain(self) -> FloatArray:
        """How the pose's ``xi`` follows each fixed point, to first order (N, 6, 3): rad and mm for each mm."""
        jacobian = point_jacobian(transform_points(self.transform, self.moving_mm))
        return self.pose.covariance @ jacobian.swapaxes(-1, -2) @ np.linalg.inv(self.covariances_mm2)

    @property
    def rotation_sd_deg(self) -> float:
        """Standard deviation of the rotation about its most uncertain axis."""
        return rotation_sd_deg(self.pose.covariance)

    @cached_property
    def flags(self) -> tuple[RegistrationFlag, ...]:
        """Reasons to doubt the result; empty when there is none."""
        probability = self.fit_probability
        checks = {
            RegistrationFlag.THREE_MARKERS: len(self) == 3,
            RegistrationFlag.ERRORS_FROM_RESIDUALS: not self.errors_stated,
            RegistrationFlag.LOOSE_ROTATION: self.rotation_sd_deg > LOOSE_ROTATION_DEG,
            RegistrationFlag.MISFIT: probability is not None and probability < MISFIT_PROBABILITY,
            RegistrationFlag.TOO_GOOD: probability is not None and probability > 1 - MISFIT_PROBABILITY,
            RegistrationFlag.MIRRORED: self._fits_a_mirror(),
            RegistrationFlag.STRETCHED: self.stretch is not None,
            RegistrationFlag.UNSETTLED: not self.settled,
        }
        return tuple(flag for flag, raised in checks.items() if raised)

    def _fits_a_mirror(self) -> bool:
        mirrored = -self.moving_mm
        mirrored_mm = float(fre_rms_mm(fit_closed_form(mirrored, self.fixed_mm), mirrored, self.fixed_mm))
        return self.fre_rms_mm > MIRROR_GAIN * mirrored_mm and len(self) > 3


def register_points(
    moving: ArrayLike,
    fixed: ArrayLike,
    covariances: Covariances = None,
    *,
    labels: Sequence[str] | None = None,
    moving_frame: Frame = MOVING,
    fixed_frame: Frame = FIXED,
) -> Registration:
    """Return the rigid registration of ``moving`` (N, 3) onto ``fixed`` (N, 3), paired row by row, in mm.

    ``covariances`` are what the points err by, in mm^2, each in its own frame: (3, 3) for all or (N, 3, 3), of the
    fixed points with the moving ones exact, or a tuple (moving, fixed). With them the fit is of maximum likelihood, for
    errors that differ by direction and point; without, it is the closed form of least squares, and one error for all is
    estimated from the residuals. It is a rotation and a translation, never a reflection. ``labels`` name the pairs.

    Raises `InputError` for fewer than three pairs, sets of unequal length, a pair given twice, collinear points,
    numbers that are not finite or not in mm, and covariances that are not positive definite.
    """
    moving_mm, fixed_mm = as_points(moving, "moving points").copy(), as_points(fixed, "fixed points").copy()
    if len(moving_mm) != len(fixed_mm):
        raise InputError(f"{len(moving_mm)} moving and {len(fixed_mm)} fixed points were given; expected pairs")
    require_spread(moving_mm, "moving points")
    require_spread(fixed_mm, "fixed points")
    _require_once(np.hstack([moving_mm, fixed_mm]))
    for frame in (moving_frame, fixed_frame):
        check_type(frame, Frame, "a frame", "give Frame('CT'), say")
    names = _names(labels, len(moving_mm))
    stated = as_pair(covariances, (len(moving_mm),))
    if stated is None:
        matrix, settled = fit_closed_form(moving_mm, fixed_mm), True
        combined = np.broadcast_to(estimated_variance(matrix, moving_mm, fixed_mm) * np.eye(3), (len(names), 3, 3))
    else:
        matrix, converged = fit_likelihood(moving_mm, fixed_mm, *stated)
        settled = bool(converged)
        combined = combined_covariances(matrix, *stated)
    covariance = fitted_pose_covariance(matrix, moving_mm, fixed_mm, combined, stated)
    pose = Pose(matrix, covariance, fixed_frame, moving_frame)
    registration = Registration(moving_mm, fixed_mm, combined, pose, names, stated, settled)
    LOG.info("registered %s onto %s: %r", moving_frame, fixed_frame, registration)
    if LOG.isEnabledFor(logging.DEBUG):
        for pair in registration:
            LOG.debug("%s is left %.4f mm off", pair.label, pair.residual_mm)
    return registration


def _names(labels: Sequence[str] | None, count: int) -> tuple[str, ...]:
    """Return the labels of so many pairs, numbers from 1 where none are given; raises `InputError` for too few."""
    check_type(labels, (Sequence, type(None)), "labels", "give a name for each pair")
    names = tuple(labels) if labels is not None else tuple(str(i + 1) for i in range(count))
    if len(names) != count:
        raise InputError(f"{len(names)} labels were given for {count} pairs; give one for each")
    return names


def _require_once(pairs_mm: FloatArray) -> None:
    """Raise `InputError` where two of ``pairs_mm`` (N, 6) are the same to the digit: one marker would count as two."""
    _, first = np.unique(pairs_mm, axis=0, return_index=True)
    again = np.setdiff1d(np.arange(len(pairs_mm)), first)
    if again.size:
        raise InputError(f"pair {again[0]} is given twice, with the same numbers; expected each marker once")
