"""The error to expect along a path: of the registration there is, or of the one that the markers will give."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from functools import cache

import numpy as np
from numpy.typing import ArrayLike

from ronnaplan.errors import InputError
from ronnaplan.geometry import FloatArray, Points, as_points, require_sigma, rms_mm
from ronnaplan.planning.trajectory import Trajectory
from ronnaplan.pose import Pose
from ronnaplan.registration.flags import LOOSE_ROTATION_DEG
from ronnaplan.registration.planned import planned_pose
from ronnaplan.sigmas import SIGMA_CT_MM, SIGMA_OTS_MM
from ronnaplan.transforms import point_jacobian, rotation_sd_deg

TUBE_SIGMAS = 2.4477
"""Root of the 95 % quantile of chi-square with two degrees of freedom: the radius of the tube."""

TUBE_POINTS = 21
"""Places along the path at which the tube is given, both ends included."""

DIRECTIONS = 20_000
"""Directions over which the chance is averaged; leaves less than 0.002."""


class Basis(StrEnum):
    """What an expected error rests on."""

    REGISTERED = "registered"
    PLANNED = "planned"


@dataclass(frozen=True, eq=False)
class ExpectedPose:
    """How far the registration may be off, and what says so: every expected error is computed here.

    ``covariance`` (6, 6) is in LPS, in the convention of `ronnaplan.pose` (rotation in rad, then translation in mm,
    about the origin). It rests on ``markers``, by label, and on standard deviations per axis: ``sigma_ct_mm`` of a
    marker in the scan beyond the localizer's own error, ``sigma_ots_mm`` of the tracker; None where a registration
    does not state them.
    """

    covariance: FloatArray
    basis: Basis
    markers: tuple[str, ...]
    sigma_ct_mm: float | None
    sigma_ots_mm: float | None

    @classmethod
    def planned(
        cls, markers: Points, sigma_ct_mm: float = SIGMA_CT_MM, sigma_ots_mm: float = SIGMA_OTS_MM
    ) -> ExpectedPose:
        """Return the error of the registration that ``markers``, in LPS, will give.

        Raises `InputError` for fewer than three markers, markers on one line, or errors that are none.
        """
        require_sigma(sigma_ct_mm, "the CT error")
        require_sigma(sigma_ots_mm, "the tracker error")
        in_ct = markers.covariances_mm2 + sigma_ct_mm**2 * np.eye(3)
        pose = planned_pose(markers.positions_mm, (in_ct, sigma_ots_mm**2 * np.eye(3)), located=True)
        return cls(pose.covariance, Basis.PLANNED, markers.labels, sigma_ct_mm, sigma_ots_mm)

    @classmethod
    def registered(
        cls, ots_from_ct: Pose, markers: tuple[str, ...], sigma_ct_mm: float | None, sigma_ots_mm: float | None
    ) -> ExpectedPose:
        """Return the error of a registration that was made of the pairs of ``markers``."""
        return cls(ots_from_ct.inverse().covariance, Basis.REGISTERED, markers, sigma_ct_mm, sigma_ots_mm)

    def covariances_mm2(self, places_mm: ArrayLike) -> FloatArray:
        """Return the covariance (N, 3, 3) of the error at ``places_mm`` (N, 3), both in LPS."""
        jacobian = point_jacobian(as_points(places_mm, "places"))
        covariances: FloatArray = jacobian @ self.covariance @ jacobian.swapaxes(-1, -2)
        return covariances

    def tre_rms_mm(self, places_mm: ArrayLike) -> FloatArray:
        """Return the expected root-mean-square error (N,) at ``places_mm`` (N, 3) in LPS."""
        return rms_mm(self.covariances_mm2(places_mm))

    @property
    def is_loose(self) -> bool:
        """Whether a rotation is so uncertain that the expected errors are unreliable."""
        return rotation_sd_deg(self.covariance) > LOOSE_ROTATION_DEG

    @property
    def rests_on(self) -> str:
        """The markers and the sigmas, in words."""
        sigmas = [
            f"{sigma:.3g} mm {where}"
            for sigma, where in ((self.sigma_ct_mm, "in CT"), (self.sigma_ots_mm, "tracked"))
            if sigma is not None
        ]
        stated = f" ({', '.join(sigmas)}, per axis)" if sigmas else ""
        return ", ".join(self.markers) + stated

    def __str__(self) -> str:
        return f"as {self.basis} with {self.rests_on}"


@dataclass(frozen=True, eq=False)
class Expectation:
    """What error is to be expected in a scan, as registered and as planned; None where there is no such error.

    ``remarks`` say, a sentence each, why one of them is missing or to be doubted.
    """

    registered: ExpectedPose | None = None
    planned: ExpectedPose | None = None
    remarks: tuple[str, ...] = ()

    @property
    def counted(self) -> ExpectedPose | None:
        """The one that limits count: as registered, where there is a registration."""
        return self.registered or self.planned

    @property
    def beside(self) -> ExpectedPose | None:
        """The one as planned, where the registered one counts."""
        return self.planned if self.registered else None


@dataclass(frozen=True, eq=False)
class PathError:
    """Expected error along a path: at ``depths_mm`` (D,) from the entry, ``covariances_mm2`` (D, 3, 3) in LPS.

    ``tube_mm`` (D,) is the radius that the axis keeps within, sideways, with a chance of at least 95 %.
    ``probability`` is the chance that target and, sideways, the whole path stay within ``tolerance_mm``.
    """

    expected: ExpectedPose
    depths_mm: FloatArray
    covariances_mm2: FloatArray
    tube_mm: FloatArray
    angular_rms_deg: float
    tolerance_mm: float
    probability: float

    @property
    def tre_rms_mm(self) -> FloatArray:
        """Expected root-mean-square error (D,) at each depth."""
        return rms_mm(self.covariances_mm2)

    @property
    def entry_rms_mm(self) -> float:
        """Expected error at the entry."""
        return float(self.tre_rms_mm[0])

    @property
    def target_rms_mm(self) -> float:
        """Expected error at the target."""
        return float(self.tre_rms_mm[-1])


def path_error(trajectory: Trajectory, expected: ExpectedPose, tolerance_mm: float) -> PathError:
    """Return the error along ``trajectory``, of the scan that ``expected`` is of."""
    if not (np.isfinite(tolerance_mm) and tolerance_mm > 0):
        raise InputError(f"the tolerance is {tolerance_mm} mm; expected a positive length")
    depths = np.linspace(0.0, trajectory.length_mm, TUBE_POINTS)
    # The ends themselves, not where rounding leads along the path: the figure there is the same everywhere.
    places = np.stack([trajectory.entry_mm, *trajectory.at_depth(depths[1:-1]), trajectory.target_mm])
    covariances = expected.covariances_mm2(places)
    sideways = np.eye(3) - np.outer(trajectory.inward, trajectory.inward)
    across = sideways @ covariances @ sideways
    tube = TUBE_SIGMAS * np.sqrt(np.linalg.eigvalsh(across)[:, -1])
    angular = np.sqrt(np.trace(sideways @ expected.covariance[:3, :3] @ sideways))
    jacobian = point_jacobian(places)
    chance = _chance(sideways @ jacobian[0], jacobian[-1], expected.covariance, tolerance_mm)
    return PathError(expected, depths, covariances, tube, float(np.degrees(angular)), tolerance_mm, chance)


@cache
def _directions() -> FloatArray:
    """Return unit vectors (DIRECTIONS, 6) spread over the sphere, always the same."""
    directions = np.random.default_rng(2018).standard_normal((DIRECTIONS, 6))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    directions.setflags(write=False)
    return directions


def _chance(entry: FloatArray, target: FloatArray, pose_mm2: FloatArray, tolerance_mm: float) -> float:
    """Return the chance that both |entry xi| and |target xi| (Jacobians (3, 6)) stay within the tolerance.

    The sideways error is linear along the path, so it is largest at an end. In each whitened direction the error
    grows with the radius, whose distribution (chi, six degrees of freedom) is known; only directions are averaged.
    """
    from scipy.special import gammainc

    values, vectors = np.linalg.eigh(pose_mm2)
    root = vectors * np.sqrt(np.clip(values, 0.0, None))
    directions = _directions()
    growth = np.maximum(
        np.linalg.norm(directions @ (entry @ root).T, axis=1),
        np.linalg.norm(directions @ (target @ root).T, axis=1),
    )
    radius = tolerance_mm / np.maximum(growth, 1e-12)
    return float(gammainc(3.0, radius**2 / 2.0).mean())
