"""Which marker to doubt: leave-one-out residuals, and a proposal (never an act) to exclude one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ronnaplan.errors import InputError, check_type
from ronnaplan.geometry import FloatArray
from ronnaplan.registration.covariances import SMALLEST_VARIANCE_MM2, combined_covariances
from ronnaplan.registration.registration import Registration
from ronnaplan.rigid import fit_closed_form, fit_likelihood, freedom, pose_covariance, spans_a_plane
from ronnaplan.sigmas import MISFIT_PROBABILITY
from ronnaplan.transforms import point_jacobian, transform_points

A_STRETCH = "a stretch of one side"
"""What else than a marker may explain the misfit: see `Registration.stretch`."""


OF_MARKERS = "register_points returns one, and what register_markers returned has it as its registration"


@dataclass(frozen=True, eq=False)
class LeaveOneOut:
    """Each marker against the registration of the *others*: N rows, NaN where those cannot be registered."""

    vectors_mm: FloatArray
    """Fixed point minus the point that the others' registration predicts (N, 3)."""
    covariances_mm2: FloatArray
    """Expected covariance of `vectors_mm` (N, 3, 3): the others' registration error, to first order, plus the
    marker's own."""
    probabilities: FloatArray
    """Chance that the marker disagrees with the others by this much (N,), from the stated errors, or from the
    others' scatter if none were."""
    rest_probabilities: FloatArray
    """Chance of the others' residuals among themselves (N,); NaN when no errors were stated."""

    @property
    def residuals_mm(self) -> FloatArray:
        """Length of each leave-one-out residual (N,)."""
        lengths: FloatArray = np.linalg.norm(self.vectors_mm, axis=1)
        return lengths


@dataclass(frozen=True)
class Doubt:
    """A proposal about one marker. ``certain`` is whether it alone explains the misfit; ``rivals`` would too.

    They are other markers, or `A_STRETCH`.
    """

    label: str
    probability: float
    certain: bool
    rivals: tuple[str, ...]

    def __str__(self) -> str:
        proposal = f"marker {self.label} disagrees with the others (chance {self.probability:.1g})"
        if self.certain:
            return f"{proposal}; check it, and exclude it if its reading is bad"
        return f"{proposal}, but so could {', '.join(self.rivals) or 'more than one marker'}: measure again"


def leave_one_out(registration: Registration) -> LeaveOneOut:
    """Return every marker's leave-one-out residual. Needs four pairs or more (`InputError`)."""
    check_type(registration, Registration, "the registration", OF_MARKERS)
    count = len(registration)
    if count < 4:
        raise InputError(f"{count} pairs leave too few when one is left out; leave-one-out needs at least four")
    solvable = np.array([spans_a_plane(np.delete(registration.moving_mm, i, axis=0)) for i in range(count)])
    vectors = np.full((count, 3), np.nan)
    covariances = np.full((count, 3, 3), np.nan)
    chance, rest = np.full(count, np.nan), np.full(count, np.nan)
    for i in np.flatnonzero(solvable):
        vectors[i], covariances[i], chance[i], rest[i] = _leave_out(registration, int(i))
    return LeaveOneOut(vectors, covariances, chance, rest)


def doubted_marker(registration: Registration) -> Doubt | None:
    """Return the marker to doubt, or None when all agree (or there are too few to tell).

    A marker is doubted when its leave-one-out residual has a chance below `MISFIT_PROBABILITY` / N. It is
    `certain` when the rest fit without it and would not fit without any other one instead, nor if one side were
    stretched.
    """
    check_type(registration, Registration, "the registration", OF_MARKERS)
    if len(registration) < 4:
        return None
    left_out = leave_one_out(registration)
    if not np.isfinite(left_out.probabilities).any():
        return None
    suspect = int(np.nanargmin(left_out.probabilities))
    if left_out.probabilities[suspect] >= MISFIT_PROBABILITY / len(registration):
        return None
    if registration.errors_stated:
        explains = left_out.rest_probabilities >= MISFIT_PROBABILITY
    else:
        explains = left_out.probabilities < MISFIT_PROBABILITY / len(registration)
    others = [registration.labels[i] for i in np.flatnonzero(explains) if i != suspect]
    if registration.stretch is not None:
        others.append(A_STRETCH)
    return Doubt(
        registration.labels[suspect],
        float(left_out.probabilities[suspect]),
        bool(explains[suspect]) and not others,
        tuple(others),
    )


def _leave_out(registration: Registration, index: int) -> tuple[FloatArray, FloatArray, float, float]:
    """Return marker ``index``'s vector, its covariance and chance, and the chance of the others' own residuals.

    The chance is that of the likelihood ratio: by how much the misfit of all exceeds that of the others. To first order
    that is the vector's own distance; but it stays right where the others leave a rotation so uncertain that the
    predicted place is spread along an arc.
    """
    from scipy.special import fdtrc, gammaincc

    keep = np.arange(len(registration)) != index
    moving, fixed = registration.moving_mm[keep], registration.fixed_mm[keep]
    stated = registration.stated_mm2
    if stated is not None:
        errors = stated[0][keep], stated[1][keep]
        matrix, _ = fit_likelihood(moving, fixed, *errors)
        combined = combined_covariances(matrix, *stated)
    else:
        matrix = fit_closed_form(moving, fixed)
        combined = registration.covariances_mm2
    mapped = transform_points(matrix, registration.moving_mm)
    residual = registration.fixed_mm - mapped
    squares = (residual * np.linalg.solve(combined, residual[..., None])[..., 0]).sum(axis=-1)
    chi_square = float(squares[keep].sum())
    excess = max(registration.chi_square - chi_square, 0.0)
    free = freedom(len(moving))
    if stated is None:  # scale by what the others scatter, so that the suspect does not hide itself
        scale = max(chi_square / free, SMALLEST_VARIANCE_MM2 / float(combined[index, 0, 0]))
        combined, excess = combined * scale, excess / scale
    jacobian = point_jacobian(mapped[index])
    covariance = jacobian @ pose_covariance(mapped[keep], combined[keep]) @ jacobian.T + combined[index]
    if stated is None:
        return residual[index], covariance, float(fdtrc(3, free, excess / 3)), np.nan
    return (
        residual[index],
        covariance,
        float(gammaincc(1.5, excess / 2)),
        float(gammaincc(free / 2, chi_square / 2)),
    )
