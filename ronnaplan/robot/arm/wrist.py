"""What lets an arm be solved in closed form: a wrist, a shoulder, and an elbow between them, of one of three kinds.

With a *spherical* wrist axes 4, 5 and 6 meet, with a *parallel* one, that of UR-like arms, only axes 5 and 6 do, and
axis 4 is parallel to axes 2 and 3. With either axis 1 is perpendicular to axis 2, axis 3 parallel to axis 2, axis 5
perpendicular to axes 4 and 6. The place where they meet tells joint 1 and, with the elbow, the joints of the plane, and
the flange's axes, seen from the shoulder, turn about axes 4, 5 and 6 as Euler's angles about z, y and z.

With a *spherical shoulder*, Franka's with joint 7 held, axes 1, 2 and 3 meet, and axes 5 and 6, each perpendicular to
the one before, and axis 4 is perpendicular to axis 5. Both places lie in one plane across axis 4. Seen from its flange
such an arm has a spherical wrist, and an elbow that turns in a plane through axis 2 in place of one across it. (For
Franka's numbers: Y. He and S. Liu, Analytical inverse kinematics for Franka Emika Panda, 2021.)

Where an arm's axes are so but for errors, as a calibration finds them, the nearest that are so begin what `refined`
ends.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ronnaplan.errors import InputError
from ronnaplan.geometry import FloatArray
from ronnaplan.robot.arm import kinds
from ronnaplan.robot.arm.arm import SerialArm
from ronnaplan.robot.arm.forward import link_frames
from ronnaplan.robot.arm.refined import chain_of
from ronnaplan.text import listed
from ronnaplan.transforms import invert, transform_points

JOINTS = 6
OTHERWISE = "`inverse_numeric` solves it, `robot place` needs a closed form"
"""What is left of an arm that has none."""
HELD_DEG = (0.0, 90.0, -90.0, 180.0)
"""Joints are tried at these angles, at which the axes before and after them are parallel or at right angles."""


class Wrist(NamedTuple):
    """An arm at angle zero, seen from its shoulder: x forward, y along axis 2, z along axis 1; mm and rad.

    A tuple of arrays, because the compiled kernels take it.
    """

    off: float
    """By how much the arm's axes stand and meet otherwise (rad, mm per `LENGTH_MM`); zero to the digits.

    All but ``chain`` is of the nearest that stand and meet so.
    """
    parallel: bool
    """Whether axis 4 is parallel to axes 2 and 3; otherwise axes 4, 5 and 6 meet."""
    backwards: bool
    """Whether it is a spherical shoulder: all but the joints' limits and ``chain`` is seen from the flange.

    The flange is then the base, and the base the flange; joint 6 is the first and joint 1 the last.
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
    """(x, z) from axis 2 to axis 3; backwards (y, x) in the elbow's plane, from the place on axis 1."""
    lower: FloatArray
    """The same from axis 3 to the wrist's center, or to an axis 4 that is parallel."""
    hand: FloatArray
    """(x, z) from an axis 4 that is parallel to the wrist's center; zero where axis 4 goes through it."""
    beside: float
    """y of the wrist's center; zero backwards, where it follows from the elbow."""
    plane: float
    """Backwards: the angle about y of the elbow's plane at angle zero, from x to its own, with axis 3 as its z."""
    elbow_sign: float
    """1 when axis 3 points along axis 2, -1 when against it; 1 backwards."""
    hand_sign: float
    """The same of an axis 4 that is parallel."""
    handed: float
    """The sign of the Jacobian's determinant in posture 0; it changes with every bit of a posture's number."""
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
    chain: FloatArray
    """The arm as it is described (7, 4, 4), by `chain_of`."""


def wrist_of(arm: SerialArm) -> Wrist:
    """Return the geometry by which ``arm`` is solved; raises `InputError` saying what it lacks."""
    if len(arm) != JOINTS:
        raise InputError(f"the arm {arm.name} has {len(arm)} joints, a closed form needs six; {_way_out(arm)}")
    frames = link_frames(arm, np.zeros(JOINTS))
    places = frames[1:, :3, 3]
    axes = np.einsum("nij,nj->ni", frames[1:, :3, :3], arm.axes)
    flange = frames[-1] @ arm.flange
    backwards = kinds.shoulder_is_spherical(axes)
    try:
        if backwards:
            base, flange = flange, invert(flange)
            axes = -axes[::-1] @ base[:3, :3]
            found = kinds.from_flange(arm.joints[::-1], transform_points(flange, places[::-1]), axes)
        else:
            found = kinds.from_base(arm.joints, places, axes)
    except InputError as error:
        raise InputError(f"the arm {arm.name} has no closed form: {error}; {_otherwise(arm)}") from None
    return _seen(arm, found, flange, backwards)


def _seen(arm: SerialArm, found: kinds.Axes, flange: FloatArray, backwards: bool) -> Wrist:
    """Return the wrist of axes that are ``found``, at the other end of which is the ``flange`` (4, 4)."""
    places, axes = found.places, found.axes
    shoulder = np.stack([np.cross(axes[1], axes[0]), axes[1], axes[0]])
    plane = float(np.arctan2(shoulder[0] @ axes[2], shoulder[2] @ axes[2])) if backwards else 0.0
    in_plane = _about_y(-plane) @ shoulder if backwards else shoulder
    elbow_sign = 1.0 if backwards else float(np.sign(axes[1] @ axes[2]))
    two_of = [1, 0] if backwards else [0, 2]
    two, three, four, wrist = (in_plane @ (place - places[0]) for place in (*places[1:4], found.center))
    end = four if found.parallel else wrist
    at_wrist = np.column_stack([np.cross(axes[4], axes[3]), axes[4], axes[3]])
    bend = float(np.arctan2(axes[5] @ at_wrist[:, 0], axes[5] @ at_wrist[:, 2]))
    return Wrist(
        off=found.off,
        parallel=found.parallel,
        backwards=backwards,
        shoulder=shoulder,
        origin=places[0].copy(),
        center=flange[:3, :3].T @ (found.center - flange[:3, 3]),
        axis_2=two[two_of],
        upper=(three - two)[two_of],
        lower=(end - three)[two_of],
        hand=(wrist - end)[two_of],
        beside=0.0 if backwards else float(wrist[1]),
        plane=plane,
        elbow_sign=elbow_sign,
        hand_sign=float(np.sign(axes[1] @ axes[3])) if found.parallel else 0.0,
        handed=-1.0 if backwards else elbow_sign,
        to_wrist=(in_plane @ at_wrist).T.copy(),
        from_flange=flange[:3, :3].T @ at_wrist @ _about_y(bend),
        bend=bend,
        middles=arm.limits_rad.mean(axis=1),
        limits=np.ascontiguousarray(arm.limits_rad),
        chain=chain_of(arm),
    )


def _about_y(angle: float) -> FloatArray:
    """Return the turn (3, 3) about y by ``angle``."""
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.array([[cosine, 0.0, sine], [0.0, 1.0, 0.0], [-sine, 0.0, cosine]])


def shoulder_mm(wrist: Wrist) -> FloatArray:
    """Return the place (3,) in the base about which the arm reaches: abreast of axis 2 on axis 1, or where all meet."""
    if wrist.backwards:
        return wrist.center
    abreast: FloatArray = wrist.origin + wrist.axis_2[1] * wrist.shoulder[2]
    return abreast


def center_mm(wrist: Wrist) -> FloatArray:
    """Return where axes 5 and 6 meet (3,), in the flange."""
    return wrist.origin if wrist.backwards else wrist.center


def stretched_mm(wrist: Wrist) -> float:
    """Return how far from axis 2 the wrist's center comes in the arm's plane, or from where a shoulder's axes meet."""
    return float(sum(np.linalg.norm(part) for part in (wrist.upper, wrist.lower, wrist.hand)))


def reach_mm(wrist: Wrist) -> float:
    """Return how far from axis 1 the wrist's center comes, with the arm stretched."""
    return float(stretched_mm(wrist) + abs(wrist.axis_2[0]))


def _otherwise(arm: SerialArm) -> str:
    """Say what to do with an arm of six joints that has no closed form."""
    if not arm.held:
        return OTHERWISE
    others = _told_held(arm.held[-1].before)
    return f"hold {_held(arm)} at another angle, or another joint{f' ({others})' if others else ''}"


def _held(arm: SerialArm) -> str:
    return " and ".join(one.joint for one in arm.held)


def _way_out(arm: SerialArm) -> str:
    """Say what to do with an arm that has not six joints: where it has one too many, which of them to hold."""
    if len(arm) < JOINTS:
        spare = min(JOINTS - len(arm), len(arm.held))
        return f"hold {spare} fewer (of {_held(arm)}), so that six turn" if spare else OTHERWISE
    if len(arm) > JOINTS + 1:
        return f"hold {len(arm) - JOINTS} of {', '.join(arm.joints)} (`--hold JOINT=DEGREES`)"
    held = _told_held(arm)
    if held:
        return f"hold one where it shall stay ({held})"
    return f"no joint held at {listed(f'{angle:g}' for angle in HELD_DEG)} degrees leaves one; {OTHERWISE}"


def _told_held(arm: SerialArm) -> str:
    """Return the options that hold any of the joints so that a closed form is left, at the first angle that does."""
    for angle in HELD_DEG:
        if held := [joint for joint in arm.joints if _is_served(arm, joint, angle)]:
            return " or ".join(f"--hold {joint}={angle:g}" for joint in held)
    return ""


def _is_served(arm: SerialArm, joint: str, angle_deg: float) -> bool:
    """Whether an arm that has one joint too many is served with ``joint`` held."""
    try:
        held = arm.holding(joint, float(np.radians(angle_deg)))
        wrist_of(replace(held, held=()))  # of which no other joint is asked in turn
    except InputError:
        return False
    return True
