"""What lets an arm be solved in closed form: a shoulder, an elbow in a plane, and a wrist that is one of two kinds.

Axis 1 is perpendicular to axis 2, axis 3 parallel to axis 2, axis 5 perpendicular to axes 4 and 6. A *spherical* wrist
is one whose three axes meet. A *parallel* one is that of UR-like arms: axis 4 is parallel to axes 2 and 3, and only
axes 5 and 6 meet. In both the place where they meet tells joint 1 and, with the elbow, the joints of the plane, and the
flange's axes, seen from the shoulder, turn about axes 4, 5 and 6 as Euler's angles about z, y and z.

Where an arm's axes are so but for errors, as a calibration finds them, the nearest that are so begin what `refined`
ends.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ronnaplan.errors import InputError
from ronnaplan.geometry import FloatArray, unit
from ronnaplan.robot.arm.arm import SerialArm
from ronnaplan.robot.arm.forward import LENGTH_MM, link_frames
from ronnaplan.robot.arm.refined import chain_of

JOINTS = 6
ANGLE_TOLERANCE = 1e-7
"""Axes whose cosine or sine is below this are perpendicular or parallel, to the digits of a description."""
NEARLY = 1e-2
"""Axes that miss by less were meant to be so: robots are built, and calibrated, some thousandths off."""
MEETING_MM = 1e-4
"""Axes meet that all pass one place nearer than this."""
NEARLY_MM = 3.0
"""Axes were meant to meet that all pass one place nearer than this."""
OTHERWISE = "`inverse_numeric` solves it, `robot place` needs a closed form"
"""What is left of an arm that has none."""


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
    """(x, z) from axis 3 to the wrist's center, or to an axis 4 that is parallel."""
    hand: FloatArray
    """(x, z) from an axis 4 that is parallel to the wrist's center; zero where axis 4 goes through it."""
    beside: float
    """y of the wrist's center."""
    elbow_sign: float
    """1 when axis 3 points along axis 2, -1 when against it."""
    hand_sign: float
    """The same of an axis 4 that is parallel."""
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
    angles_off = _angles_off(arm, axes)
    wrist_off, parallel, center = _wrist(arm, places, axes)
    off = max(angles_off, wrist_off)
    if off:
        places, axes = _nearest(places, axes, parallel, center)
    shoulder = np.stack([np.cross(axes[1], axes[0]), axes[1], axes[0]])
    two, three, four, wrist = (shoulder @ (place - places[0]) for place in (*places[1:4], center))
    end = four if parallel else wrist
    at_wrist = np.column_stack([np.cross(axes[4], axes[3]), axes[4], axes[3]])
    bend = float(np.arctan2(axes[5] @ at_wrist[:, 0], axes[5] @ at_wrist[:, 2]))
    cosine, sine = np.cos(bend), np.sin(bend)
    turn = np.array([[cosine, 0.0, sine], [0.0, 1.0, 0.0], [-sine, 0.0, cosine]])
    flange = frames[-1] @ arm.flange
    return Wrist(
        off,
        parallel,
        shoulder,
        places[0].copy(),
        flange[:3, :3].T @ (center - flange[:3, 3]),
        two[[0, 2]],
        (three - two)[[0, 2]],
        (end - three)[[0, 2]],
        (wrist - end)[[0, 2]],
        float(wrist[1]),
        float(np.sign(axes[1] @ axes[2])),
        float(np.sign(axes[1] @ axes[3])) if parallel else 0.0,
        (shoulder @ at_wrist).T.copy(),
        flange[:3, :3].T @ at_wrist @ turn,
        bend,
        arm.limits_rad.mean(axis=1),
        np.ascontiguousarray(arm.limits_rad),
        chain_of(arm),
    )


def stretched_mm(wrist: Wrist) -> float:
    """Return how far from axis 2 the wrist's center comes in the arm's plane."""
    return float(sum(np.linalg.norm(part) for part in (wrist.upper, wrist.lower, wrist.hand)))


def _angles_off(arm: SerialArm, axes: FloatArray) -> float:
    """Return by how much the axes (6, 3) stand otherwise than both kinds need it (rad), zero to the digits.

    Raises `InputError` naming the first two joints where that is not even nearly so.
    """
    largest = 0.0
    for a, b, stand in (
        (1, 2, "parallel"),
        (0, 1, "perpendicular"),
        (3, 4, "perpendicular"),
        (4, 5, "perpendicular"),
    ):
        miss = _off_parallel(axes[a], axes[b]) if stand == "parallel" else abs(float(axes[a] @ axes[b]))
        if miss >= NEARLY:
            what = f"the axes of {arm.joints[a]} and {arm.joints[b]} are {_degrees(miss)} from {stand}"
            raise _refused(arm, f"{what}, expected {stand}; {_otherwise(arm)}")
        largest = max(largest, miss)
    return 0.0 if largest < ANGLE_TOLERANCE else largest


def _wrist(arm: SerialArm, places: FloatArray, axes: FloatArray) -> tuple[float, bool, FloatArray]:
    """Return how far the wrist is off its kind (rad, mm per `LENGTH_MM`), whether that is parallel, and its center.

    Raises `InputError` for a wrist that is not even nearly of either kind.
    """
    center, apart_mm = _meeting(places[3:], axes[3:])
    center_two, apart_two_mm = _meeting(places[4:], axes[4:])
    miss = _off_parallel(axes[1], axes[3])
    if apart_mm < MEETING_MM:
        return 0.0, False, center
    if miss < ANGLE_TOLERANCE and apart_two_mm < MEETING_MM:
        return 0.0, True, center_two
    if apart_mm < NEARLY_MM:
        return apart_mm / LENGTH_MM, False, center
    if miss < NEARLY and apart_two_mm < NEARLY_MM:
        return max(miss, apart_two_mm / LENGTH_MM), True, center_two
    _, two, _, four, five, six = arm.joints
    raise _refused(
        arm,
        f"the axes of {four}, {five} and {six} pass each other by {apart_mm:.3g} mm, those of {five} and {six} by "
        f"{apart_two_mm:.3g} mm, and that of {four} is {_degrees(miss)} from parallel to that of {two}; expected all "
        f"three to meet, or the last two and a parallel one; {_otherwise(arm)}",
    )


def _nearest(
    places: FloatArray, axes: FloatArray, parallel: bool, center: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return places (6, 3) on the axes, and axes (6, 3) near to ``axes`` that stand as they have to.

    Those parallel to axis 2 are met abreast of the wrist's ``center`` (3,), as axes that are not quite parallel come
    near to others wherever their frames happen to lie.
    """
    placed, stood = places.copy(), axes.copy()
    abreast = [1, 2, 3] if parallel else [1, 2]
    signs = np.sign(axes[abreast] @ axes[1])
    along = signs @ axes[abreast]
    two = unit(along - (along @ axes[0]) * axes[0])
    stood[abreast] = signs[:, None] * two
    for n in abreast:
        placed[n] += ((center - places[n]) @ two) / (axes[n] @ two) * axes[n]
    for n in (4, 5):
        stood[n] = unit(axes[n] - (axes[n] @ stood[n - 1]) * stood[n - 1])
    return placed, stood


def _otherwise(arm: SerialArm) -> str:
    """Say what to do with an arm of six joints that has no closed form."""
    if not arm.held:
        return OTHERWISE
    before = arm.held[-1].before
    others = "" if before is None else _told_held(before)
    return f"hold {_held(arm)} at another angle, or another joint{f' ({others})' if others else ''}"


def _held(arm: SerialArm) -> str:
    return " and ".join(one.joint for one in arm.held)


def _refused(arm: SerialArm, what: str) -> InputError:
    return InputError(f"the arm {arm.name} has no closed form: {what}")


def _off_parallel(one: FloatArray, other: FloatArray) -> float:
    """Return the sine between two axes (3,)."""
    return float(np.linalg.norm(np.cross(one, other)))


def _degrees(sine: float) -> str:
    return f"{np.degrees(np.arcsin(min(sine, 1.0))):.3g} degrees"


def _meeting(places: FloatArray, axes: FloatArray) -> tuple[FloatArray, float]:
    """Return the place (3,) nearest to all lines through ``places`` (N, 3) along ``axes`` (N, 3), and how near (mm)."""
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    found: FloatArray = np.linalg.lstsq(across.sum(axis=0), (across @ places[:, :, None]).sum(axis=0)[:, 0])[0]
    return found, float(np.linalg.norm(np.cross(found - places, axes), axis=1).max())


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
    return "hold one that leaves a closed form (`--hold JOINT=DEGREES`; at 0 degrees none does)"


def _told_held(arm: SerialArm) -> str:
    """Return the options that hold at zero any of the joints that then leave a closed form."""
    return " or ".join(f"--hold {joint}=0" for joint in arm.joints if _is_served(arm, joint))


def _is_served(arm: SerialArm, joint: str) -> bool:
    """Whether an arm that has one joint too many is served with ``joint`` held at zero."""
    try:
        wrist_of(replace(arm.holding(joint, 0.0), held=()))  # of which no other joint is asked in turn
    except InputError:
        return False
    return True
