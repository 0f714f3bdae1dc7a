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
CURVATURES = 201
"""From the flattest to the most bent plate: as many are looked at."""
LEAST_SITES = 30
"""Places of the scalp beneath a template that tell its shape there."""
NEAR_SITE_MM = 20.0
"""A template's place is a place on the scalp within so much."""
BACK = np.array([0.0, 1.0, 0.0])


@dataclass(frozen=True, eq=False)
class Fitted:
    """A bridge that was bent to a head, and ``lps_from_template`` (4, 4), mm: where it lies there."""

    bridge: Bridge
    lps_from_template: FloatArray
    widest_gap_mm: float
    """Between the plate and the scalp beneath it, across the plate; the narrowest is `ROOM_MM`."""


def bent_to_scalp(bridge: Bridge, sites: Sites, at_mm: FloatArray | None = None) -> Fitted:
    """Return ``bridge`` bent from side to side so that it follows the scalp about ``at_mm`` (3,), else about the crown.

    Of all radii the one whose widest gap to the scalp is least. Raises `InputError` for a place off the scalp or too
    few sites beneath the plate, `RefusedError` for a place on the front or the back of the head.
    """
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

    width_mm = bridge.size_mm[0]
    curvatures = np.linspace(1.0 / FLATTEST_MM, 2.0 / width_mm, CURVATURES)
    radii_mm = np.maximum(1.0 / curvatures, width_mm / 2)  # not less by a rounding
    widest_mm, radius_mm, lift_mm = min(_lying(beneath, one, width_mm) for one in radii_mm.tolist())
    pose = np.eye(4)
    pose[:3, :3] = axes.T
    pose[:3, 3] = places[near] + lift_mm * axes[2]
    return Fitted(replace(bridge, radius_mm=radius_mm), pose, widest_mm)


def _lying(places_mm: FloatArray, radius_mm: float, width_mm: float) -> tuple[float, float, float]:
    """Return the widest gap to places (N, 3) of the scalp, the radius, and the height of a plate's middle, mm.

    The plate is bent to ``radius_mm`` and lowered until the places beneath it are no nearer than `ROOM_MM`.
    """
    across, up = places_mm[:, 0], places_mm[:, 2] + radius_mm
    beneath = np.abs(np.arctan2(across, up)) * radius_mm <= width_mm / 2
    across, up = across[beneath], up[beneath]
    lift_mm = float((up - np.sqrt(np.maximum((radius_mm - ROOM_MM) ** 2 - across**2, 0.0))).max())
    return float((radius_mm - np.hypot(across, up - lift_mm)).max()), radius_mm, lift_mm


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
