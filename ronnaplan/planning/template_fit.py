"""How a template is bent so that it follows the scalp of one head."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ronnaplan.errors import InputError, RefusedError
from ronnaplan.geometry import FloatArray, unit
from ronnaplan.planning.sites import Sites
from ronnaplan.planning.template_layout import Bridge

ROOM_MM = 3.0
"""Between the plate and the scalp where they come nearest."""
FLATTEST_MM = 2000.0
LEAST_SITES = 30
NEAR_SITE_MM = 20.0
"""A template's place is a place on the scalp within so much."""
BACK = np.array([0.0, 1.0, 0.0])


@dataclass(frozen=True, eq=False)
class Fitted:
    """A bridge that was bent to a head, and ``lps_from_template`` (4, 4), mm: where it lies there."""

    bridge: Bridge
    lps_from_template: FloatArray
    widest_gap_mm: float
    """Between the plate and the scalp; the narrowest is `ROOM_MM`."""


def bent_to_scalp(bridge: Bridge, sites: Sites, at_mm: FloatArray | None = None) -> Fitted:
    """Return ``bridge`` bent from side to side so that it follows the scalp about ``at_mm`` (3,), else about the crown.

    Of all radii the one whose widest gap to the scalp is least. Raises `InputError` for a place off the scalp or too
    few sites beneath the plate, `RefusedError` for a place on the front or the back of the head.
    """
    from scipy.optimize import minimize_scalar

    places, normals = sites.scalp_mm, sites.normals
    wanted = places[places[:, 2].argmax()] if at_mm is None else at_mm
    near = int(np.linalg.norm(places - wanted, axis=1).argmin())
    off_mm = float(np.linalg.norm(places[near] - wanted))
    if off_mm > NEAR_SITE_MM:
        raise InputError(
            f"the template was to lie at a place {off_mm:.0f} mm off the scalp, expected at most {NEAR_SITE_MM:g} mm"
        )
    axes = _axes(normals[near])
    local = (places - places[near]) @ axes.T
    beneath = local[
        (np.abs(local[:, :2]) <= np.array(bridge.size_mm) / 2).all(axis=1) & (local[:, 2] > -bridge.size_mm[0])
    ]
    if len(beneath) < LEAST_SITES:
        raise InputError(
            f"{len(beneath)} places of the scalp lie beneath the template, expected {LEAST_SITES} or more; the scan "
            "does not show the head there"
        )

    def heights_mm(curvature: float) -> FloatArray:
        """Of the plate over the scalp, the plate's top at the place."""
        heights: FloatArray = -_sunk(beneath[:, 0], curvature) - beneath[:, 2]
        return heights

    bounds = (1.0 / FLATTEST_MM, 2.0 / bridge.size_mm[0])
    curvature = float(
        minimize_scalar(lambda curvature: np.ptp(heights_mm(curvature)), bounds=bounds, method="bounded").x
    )
    heights = heights_mm(curvature)
    pose = np.eye(4)
    pose[:3, :3] = axes.T
    pose[:3, 3] = places[near] + (ROOM_MM - heights.min()) * axes[2]
    return Fitted(replace(bridge, radius_mm=1.0 / curvature), pose, float(np.ptp(heights)) + ROOM_MM)


def _sunk(across_mm: FloatArray, curvature: float) -> FloatArray:
    """Return how far a plate bent so much lies below its top at ``across_mm`` (N,) from its middle."""
    inside = np.maximum(1.0 - (curvature * across_mm) ** 2, 0.0)
    sunk: FloatArray = curvature * across_mm**2 / (1.0 + np.sqrt(inside))
    return sunk


def _axes(normal: FloatArray) -> FloatArray:
    """Return the template's axes as rows (3, 3): x to the left, y backwards along the scalp, z outwards."""
    back = BACK - (BACK @ normal) * normal
    if float(np.linalg.norm(back)) < 0.5:
        raise RefusedError(
            "the scalp there faces the front or the back, so that from side to side is no way across the template; "
            "choose a place nearer to the crown"
        )
    y = unit(back)
    return np.stack([np.cross(y, normal), y, normal])
