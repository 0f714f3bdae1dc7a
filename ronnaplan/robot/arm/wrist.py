"""What lets an arm be solved in closed form: a spherical wrist on a shoulder and elbow that lie in a plane."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ronnaplan.errors import InputError
from ronnaplan.geometry import FloatArray
from ronnaplan.robot.arm.arm import SerialArm
from ronnaplan.robot.arm.forward import link_frames

ANGLE_TOLERANCE = 1e-7
"""Axes whose cosine or sine is below this are perpendicular or parallel, to the digits of a description."""
MEETING_MM = 1e-4
"""Axes that pass each other nearer than this meet."""
OTHERWISE = "`inverse_numeric` solves it, `robot place` needs a closed form"
"""What is left of an arm that has none."""


class Wrist(NamedTuple):
    """An arm at angle zero, seen from its shoulder: x forward, y along axis 2, z along axis 1; mm and rad.

    A tuple of arrays, because the compiled kernels take it.
    """

    shoulder: FloatArray
    """Shoulder from base (3, 3), its rows the shoulder's axes."""
    origin: FloatArray
    """A place (3,) on axis 1, in the base."""
    center: FloatArray
    """Where the wrist's axes meet (3,), in the flange."""
    axis_2: FloatArray
    """(x, z) of axis 2."""
    upper: FloatArray
    """(x, z) from axis 2 to axis 3."""
    lower: FloatArray
    """(x, z) from axis 3 to the wrist's center."""
    beside: float
    """y of the wrist's center."""
    elbow_sign: float
    """1 when axis 3 points along axis 2, -1 when against it."""
    to_wrist: FloatArray
    """The wrist's axes from the shoulder (3, 3) at angle zero: z along axis 4, y along axis 5."""
    from_flange: FloatArray
    """The flange from the wrist's axes (3, 3), those of axis 6 turned onto axis 4."""
    bend: float
    """Angle from axis 4 to axis 6 about axis 5 at angle zero; with it joint 5 is straight."""
    middles: FloatArray
    """The middles (6,) of the joints' limits."""
    limits: FloatArray
    """The limits (6, 2)."""


def wrist_of(arm: SerialArm) -> Wrist:
    """Return the closed-form geometry of ``arm``; raises `InputError` saying what it lacks."""
    if len(arm) != 6:
        raise InputError(f"the arm {arm.name} has {len(arm)} joints, a closed form needs six; {OTHERWISE}")
    frames = link_frames(arm, np.zeros(6))
    places = frames[1:, :3, 3]
    axes = np.einsum("nij,nj->ni", frames[1:, :3, :3], arm.axes)
    flange = frames[-1] @ arm.flange
    center = _meeting(places[3:], axes[3:])
    _require(arm, float(np.linalg.norm(np.cross(axes[1], axes[2]))), "axes 2 and 3 are not parallel")
    _require(arm, abs(axes[0] @ axes[1]), "axes 1 and 2 are not perpendicular")
    _require(arm, abs(axes[3] @ axes[4]), "axes 4 and 5 are not perpendicular")
    _require(arm, abs(axes[4] @ axes[5]), "axes 5 and 6 are not perpendicular")
    apart = np.linalg.norm(np.cross(center - places[3:], axes[3:]), axis=1).max()
    _require(arm, apart / MEETING_MM * ANGLE_TOLERANCE, f"axes 4, 5 and 6 pass each other by {apart:.3g} mm")
    shoulder = np.stack([np.cross(axes[1], axes[0]), axes[1], axes[0]])
    two, three, wrist = (shoulder @ (place - places[0]) for place in (places[1], places[2], center))
    at_wrist = np.column_stack([np.cross(axes[4], axes[3]), axes[4], axes[3]])
    bend = float(np.arctan2(axes[5] @ at_wrist[:, 0], axes[5] @ at_wrist[:, 2]))
    cosine, sine = np.cos(bend), np.sin(bend)
    turn = np.array([[cosine, 0.0, sine], [0.0, 1.0, 0.0], [-sine, 0.0, cosine]])
    return Wrist(
        shoulder,
        places[0].copy(),
        flange[:3, :3].T @ (center - flange[:3, 3]),
        two[[0, 2]],
        (three - two)[[0, 2]],
        (wrist - three)[[0, 2]],
        float(wrist[1]),
        float(np.sign(axes[1] @ axes[2])),
        (shoulder @ at_wrist).T.copy(),
        flange[:3, :3].T @ at_wrist @ turn,
        bend,
        arm.limits_rad.mean(axis=1),
        np.ascontiguousarray(arm.limits_rad),
    )


def _meeting(places: FloatArray, axes: FloatArray) -> FloatArray:
    """Return the place (3,) nearest to all lines through ``places`` (N, 3) along ``axes`` (N, 3)."""
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    found: FloatArray = np.linalg.lstsq(across.sum(axis=0), (across @ places[:, :, None]).sum(axis=0)[:, 0])[0]
    return found


def _require(arm: SerialArm, miss: float, what: str) -> None:
    if not miss < ANGLE_TOLERANCE:
        raise InputError(f"the arm {arm.name} has no closed form: {what}; {OTHERWISE}")
