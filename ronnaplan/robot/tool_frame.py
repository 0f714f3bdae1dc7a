"""The pose of a tool from its single spheres: the x-shaped frame M or an NDI-style rigid body."""

from __future__ import annotations

from ronnaplan.errors import RefusedError
from ronnaplan.geometry import Points
from ronnaplan.registration.marker_registration import MarkerRegistration, register_markers


def locate_tool(geometry: Points, readings: Points, *, expected: int | None = None) -> MarkerRegistration:
    """Return where a tool is: its spheres' ``geometry`` (in its own frame) among the tracker's ``readings``.

    Readings may hold other markers and come in any order. The pose, tracker from tool, is ``registration.pose``.
    Raises `RefusedError` when the spheres are not recognized beyond doubt, for example by a symmetric geometry.
    """
    found = register_markers(geometry, readings, expected=expected, sigma_ct_mm=0.0)
    if found.registration is None:
        raise RefusedError(
            f"the tool {geometry.frame} is not recognized among the readings: {found.pairing.reason}"
        )
    return found
