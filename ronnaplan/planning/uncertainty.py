"""The error to expect along a path once the markers are registered: a tube, an angle, and a chance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ronnaplan.errors import InputError
from ronnaplan.geometry import FloatArray, as_points
from ronnaplan.planning.trajectory import Trajectory
from ronnaplan.pose import point_jacobian
from ronnaplan.registration.covariances import as_pair
from ronnaplan.rigid import pose_covariance, require_spread

TUBE_SIGMAS = 2.4477
"""Root of the 95 % quantile of chi-square with two degrees of freedom: the radius of the tube."""

TUBE_POINTS = 21
"""Places along the path at which the tube is given, both ends included."""

DIRECTIONS = 20_000
"""Directions over which the chance is averaged; leaves less than 0.002."""


@dataclass(frozen=True, eq=False)
class PathError:
    """Expected error along a path: at ``depths_mm`` (D,) from the entry, ``covariances_mm2`` (D, 3, 3) in LPS.

    ``tube_mm`` (D,) is the radius that the axis keeps within, sideways, with a chance of at least 95 %.
    ``probability`` is the chance that target and, sideways, the whole path stay within ``tolerance_mm``.
    """

    depths_mm: FloatArray
    covariances_mm2: FloatArray
    tube_mm: FloatArray
    angular_rms_deg: float
    tolerance_mm: float
    probability: float

    @property
    def tre_rms_mm(self) -> FloatArray:
        """Expected root-mean-square error (D,) at each depth."""
        rms: FloatArray = np.sqrt(np.trace(self.covariances_mm2, axis1=-2, axis2=-1))
        return rms

    @property
    def entry_rms_mm(self) -> float:
        """Expected error at the entry."""
        return float(self.tre_rms_mm[0])

    @property
    def target_rms_mm(self) -> float:
        """Expected error at the target."""
        return float(self.tre_rms_mm[-1])


def planned_pose_covariance(markers_mm: ArrayLike, covariances_mm2: ArrayLike) -> FloatArray:
    """Return the covariance (6, 6) of the registration that ``markers_mm`` (N, 3), LPS, will give.

    ``covariances_mm2``, (3, 3) or (N, 3, 3), is the sum of both sides' localization errors. The convention is that
    of `ronnaplan.pose` (rotation in rad, then translation in mm, about the origin of LPS).
    """
    markers = as_points(markers_mm, "markers")
    require_spread(markers, "markers")
    stated = as_pair(covariances_mm2, len(markers))
    assert stated is not None
    return pose_covariance(markers, stated[1])


def path_error(trajectory: Trajectory, pose_mm2: FloatArray, tolerance_mm: float) -> PathError:
    """Return the error along ``trajectory`` for a registration with covariance ``pose_mm2`` (6, 6) in LPS."""
    if not (np.isfinite(tolerance_mm) and tolerance_mm > 0):
        raise InputError(f"the tolerance is {tolerance_mm} mm; expected a positive length")
    depths = np.linspace(0.0, trajectory.length_mm, TUBE_POINTS)
    jacobian = point_jacobian(trajectory.at_depth(depths))
    covariances = jacobian @ pose_mm2 @ jacobian.swapaxes(-1, -2)
    sideways = np.eye(3) - np.outer(trajectory.inward, trajectory.inward)
    across = sideways @ covariances @ sideways
    tube = TUBE_SIGMAS * np.sqrt(np.linalg.eigvalsh(across)[:, -1])
    angular = np.sqrt(np.trace(sideways @ pose_mm2[:3, :3] @ sideways))
    chance = _chance(sideways @ jacobian[0], jacobian[-1], pose_mm2, tolerance_mm)
    return PathError(depths, covariances, tube, float(np.degrees(angular)), tolerance_mm, chance)


def _chance(entry: FloatArray, target: FloatArray, pose_mm2: FloatArray, tolerance_mm: float) -> float:
    """Return the chance that both |entry xi| and |target xi| (Jacobians (3, 6)) stay within the tolerance.

    The sideways error is linear along the path, so it is largest at an end. In each whitened direction the error
    grows with the radius, whose distribution (chi, six degrees of freedom) is known; only directions are averaged.
    """
    from scipy.special import gammainc

    values, vectors = np.linalg.eigh(pose_mm2)
    root = vectors * np.sqrt(np.clip(values, 0.0, None))
    directions = np.random.default_rng(2018).standard_normal((DIRECTIONS, 6))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    growth = np.maximum(
        np.linalg.norm(directions @ (entry @ root).T, axis=1),
        np.linalg.norm(directions @ (target @ root).T, axis=1),
    )
    radius = tolerance_mm / np.maximum(growth, 1e-12)
    return float(gammainc(3.0, radius**2 / 2.0).mean())
