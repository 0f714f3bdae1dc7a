"""The compiled kernels of the arm: the eight postures that reach a pose.

What `near_postures` is made of is inlined, and so is it: to hand over the wrist takes longer than most of it.
"""

from __future__ import annotations

import numpy as np

from kernelcache import njit
from ronnaplan.geometry import FloatArray
from ronnaplan.robot.arm.links import invert_into, times
from ronnaplan.robot.arm.refined import refined
from ronnaplan.robot.arm.wrist import Wrist

STRAIGHT = 1e-9
"""Below this sine of joint 5, axes 4 and 6 point one way: the turn about axis 4 is left at zero."""
TURN = 2.0 * np.pi
ALL = 255
"""All eight postures, a bit for each."""
BEYOND = 8.0
"""So many times what an arm is off, its nearest geometry may miss the pose by, in squares of lengths.

It then begins as far within its reach: where both ends of a joint's way meet, it tells nothing of what is near.
"""
NEARER = 0.25
"""Of that, so much an arm begins within its reach that is solved from its flange: its squares are of its whole length.

Of 0.05 to 1 it is among those by which a calibrated Franka misses least.
"""


@njit(cache=True, nogil=True, error_model="numpy")
def nearest_turn(angle: float, middle: float) -> float:
    """Return ``angle`` by whole turns nearest to ``middle``."""
    return float(angle - TURN * np.round((angle - middle) / TURN))


@njit(cache=True, nogil=True, error_model="numpy")
def swung(vector: FloatArray, angle: float) -> tuple[float, float]:
    """Return ``vector`` (x, z) turned by ``angle`` about y."""
    c, s = np.cos(angle), np.sin(angle)
    return c * vector[0] + s * vector[1], c * vector[1] - s * vector[0]


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def near_postures(wrist: Wrist, pose: FloatArray, asked: int, angles: FloatArray) -> int:
    """Fill ``angles`` (8, 6) with the joints that bring the flange to ``pose`` (4, 4) in the base.

    Bit n of what is returned says that row n is an answer, of those rows that are ``asked`` for alike. Rows 0 to 3
    reach forwards, 4 to 7 over the shoulder; of each four, two have one bend of the elbow; of each two, the wrist is
    one way or flipped. Limits are not looked at.

    All is by the nearest geometry that has a closed form. Where an arm is ``off`` that, `refined` begins with it and
    tells which are answers.
    """
    if wrist.backwards:
        return _from_flange(wrist, pose, angles) & asked
    seen = np.empty((3, 3))
    x, y, z = _seen_from_shoulder(wrist, pose, seen)
    forwards = _forwards(wrist, x, y, wrist.beside, 1.0)
    if np.isnan(forwards):
        return 0
    found = 0
    for side in range(2):
        these = asked >> (4 * side) & 15
        if these == 0:
            continue
        forward = forwards if side == 0 else -forwards
        first = np.arctan2(y, x) - np.arctan2(wrist.beside, forward)
        px, pz = forward - wrist.axis_2[0], z - wrist.axis_2[1]
        rows = angles[4 * side : 4 * side + 4]
        if wrist.parallel:
            found |= _wrist_before_elbow(wrist, seen, first, px, pz, these, rows) << (4 * side)
        else:
            found |= _elbow_before_wrist(wrist, seen, first, px, pz, these, rows) << (4 * side)
    return found


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _seen_from_shoulder(wrist: Wrist, pose: FloatArray, seen: FloatArray) -> tuple[float, float, float]:
    """Return where the wrist's center is at ``pose`` (4, 4), from the shoulder; fill ``seen`` (3, 3) with its axes."""
    offset = np.empty(3)
    for a in range(3):
        offset[a] = pose[a, 3] - wrist.origin[a]
        for b in range(3):
            offset[a] += pose[a, b] * wrist.center[b]
    x = y = z = 0.0
    for a in range(3):
        x += wrist.shoulder[0, a] * offset[a]
        y += wrist.shoulder[1, a] * offset[a]
        z += wrist.shoulder[2, a] * offset[a]
    turned_pose = np.empty((3, 3))
    times(pose, wrist.from_flange, turned_pose)
    times(wrist.shoulder, turned_pose, seen)
    return x, y, z


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _elbow_before_wrist(
    wrist: Wrist, seen: FloatArray, first: float, px: float, pz: float, asked: int, rows: FloatArray
) -> int:
    """Fill ``rows`` (4, 6) of a spherical wrist, whose center is at (px, pz) from axis 2; return which are answers."""
    bends = _bends(wrist, px, pz)
    if np.isnan(bends[0]):
        return 0
    for elbow in range(2):
        these = asked >> (2 * elbow) & 3
        if these == 0:
            continue
        bent = bends[elbow]
        second = _second(wrist, bent, px, pz)
        fourth, tilt, sixth = _wrist_angles(wrist.to_wrist, seen, first, second + bent)
        for flip in range(2):
            if these >> flip & 1:
                _fill(wrist, flip, first, second, bent, fourth + flip * np.pi, tilt, sixth, rows[2 * elbow + flip])
    return asked


@njit(cache=True, nogil=True, error_model="numpy")
def _wrist_before_elbow(
    wrist: Wrist, seen: FloatArray, first: float, px: float, pz: float, asked: int, rows: FloatArray
) -> int:
    """Do the same of a parallel wrist: it tells how far joints 2, 3 and 4 turn together, and so where axis 4 is."""
    found = 0
    fourth, tilt, sixth = _wrist_angles(wrist.to_wrist, seen, first, 0.0)
    for flip in range(2):
        if asked & (5 << flip) == 0:
            continue
        together = fourth + flip * np.pi
        hx, hz = swung(wrist.hand, wrist.hand_sign * together)
        bends = _bends(wrist, px - hx, pz - hz)
        if np.isnan(bends[0]):
            continue
        for elbow in range(2):
            row = 2 * elbow + flip
            if not asked >> row & 1:
                continue
            bent = bends[elbow]
            second = _second(wrist, bent, px - hx, pz - hz)
            left = together - wrist.hand_sign * (second + bent)
            _fill(wrist, flip, first, second, bent, left, tilt, sixth, rows[row])
            found |= 1 << row
    return found


@njit(cache=True, nogil=True, error_model="numpy")
def _from_flange(wrist: Wrist, pose: FloatArray, angles: FloatArray) -> int:
    """Do as `near_postures` of an arm with a spherical shoulder, which is solved backwards, from its flange.

    How far off the shoulder is tells the elbow, which turns in a plane through it and axis 5; joints 6 and 5 bring that
    plane to where the shoulder is seen, with either side of it towards axis 6: rows 0 to 3 and 4 to 7.
    """
    base, seen = np.empty((3, 4)), np.empty((3, 3))
    invert_into(base, pose)
    x, y, z = _seen_from_shoulder(wrist, base, seen)
    bends = _bends(wrist, np.sqrt(x * x + y * y), z)
    if np.isnan(bends[0]):
        return 0
    found = 0
    unbent, to_wrist = np.eye(3), np.empty((3, 3))
    for elbow in range(2):
        bent = bends[elbow]
        beside, away = swung(wrist.lower, bent)
        beside, away = wrist.upper[0] + beside, wrist.upper[1] + away
        forwards = _forwards(wrist, x, y, beside, NEARER)
        if np.isnan(forwards):
            continue
        unbent[0, 0], unbent[0, 1] = np.cos(bent), np.sin(bent)
        unbent[1, 0], unbent[1, 1] = -np.sin(bent), np.cos(bent)
        times(wrist.to_wrist, unbent, to_wrist)
        for side in range(2):
            forward = forwards if side == 0 else -forwards
            first = np.arctan2(y, x) - np.arctan2(beside, forward)
            turned = np.arctan2(-z, forward) - np.arctan2(0.0, away)
            fourth, tilt, sixth = _wrist_angles(to_wrist, seen, first, turned)
            for flip in range(2):
                n = 4 * side + 2 * elbow + flip
                third = fourth + flip * np.pi
                _fill(wrist, flip, first, turned - wrist.plane, bent, third, tilt, sixth, angles[n])
                found |= 1 << n
    return found


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _forwards(wrist: Wrist, x: float, y: float, beside: float, begin: float) -> float:
    """Return how far forward of axis 1 a place is, ``beside`` the arm's plane, that is seen at (x, y); NaN if never.

    Where it is a little beyond, the place is taken to be within by ``begin`` of what is allowed for.
    """
    across = x * x + y * y - beside * beside
    if across < 0.0:
        beyond = BEYOND * wrist.off * (x * x + y * y)
        across = begin * beyond if across >= -beyond else np.nan
    forwards: float = np.sqrt(across)
    return forwards


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _bends(wrist: Wrist, px: float, pz: float) -> tuple[float, float]:
    """Return both turns of the elbow about axis 2's direction that reach (px, pz) from axis 2; NaN out of reach."""
    reach_u = wrist.upper[0] * wrist.upper[0] + wrist.upper[1] * wrist.upper[1]
    reach_l = wrist.lower[0] * wrist.lower[0] + wrist.lower[1] * wrist.lower[1]
    cosine = (px * px + pz * pz - reach_u - reach_l) / (2.0 * np.sqrt(reach_u * reach_l))
    if not abs(cosine) <= 1.0:
        beyond = BEYOND * wrist.off
        if not abs(cosine) <= 1.0 + beyond:
            return np.nan, np.nan
        cosine = (1.0 - beyond) * np.sign(cosine)
    along = wrist.upper[0] * wrist.lower[0] + wrist.upper[1] * wrist.lower[1]
    turned = wrist.upper[0] * wrist.lower[1] - wrist.upper[1] * wrist.lower[0]
    start, opened = np.arctan2(turned, along), np.arccos(cosine)
    return start + opened, start - opened


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _second(wrist: Wrist, bent: float, px: float, pz: float) -> float:
    """Return the angle of joint 2 that brings the end of an elbow ``bent`` so far to (px, pz)."""
    c, s = np.cos(bent), np.sin(bent)
    gx = wrist.upper[0] + c * wrist.lower[0] + s * wrist.lower[1]
    gz = wrist.upper[1] - s * wrist.lower[0] + c * wrist.lower[1]
    second: float = np.arctan2(-pz, px) - np.arctan2(-gz, gx)
    return second


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _wrist_angles(
    to_wrist: FloatArray, seen: FloatArray, first: float, turned: float
) -> tuple[float, float, float]:
    """Return what axes 4, 5 and 6 turn by (rad) to show the axes ``seen`` (3, 3) from the shoulder.

    Joint 1 has turned by ``first``, the arm about axis 2's direction by ``turned``; axis 5 counts from straight.
    """
    c1, s1 = np.cos(first), np.sin(first)
    c2, s2 = np.cos(turned), np.sin(turned)
    held, r = np.empty((3, 3)), np.empty((3, 3))
    for n in range(3):
        x = c1 * seen[0, n] + s1 * seen[1, n]
        held[1, n] = c1 * seen[1, n] - s1 * seen[0, n]
        held[0, n] = c2 * x - s2 * seen[2, n]
        held[2, n] = s2 * x + c2 * seen[2, n]
    times(to_wrist, held, r)
    sine = np.hypot(r[0, 2], r[1, 2])
    tilt = np.arctan2(sine, r[2, 2])
    if sine > STRAIGHT:
        return np.arctan2(r[1, 2], r[0, 2]), tilt, np.arctan2(r[2, 1], -r[2, 0])
    return 0.0, tilt, np.arctan2(r[1, 0], r[1, 1])


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _fill(
    wrist: Wrist,
    flip: int,
    first: float,
    second: float,
    bent: float,
    fourth: float,
    tilt: float,
    sixth: float,
    row: FloatArray,
) -> None:
    """Fill ``row`` (6,) with the joints' angles, the wrist one way or flipped."""
    row[0], row[1], row[2] = first, second, wrist.elbow_sign * bent
    row[3] = fourth
    row[4] = (tilt if flip == 0 else -tilt) - wrist.bend
    row[5] = sixth + flip * np.pi
    if wrist.backwards:
        for n in range(3):
            row[n], row[5 - n] = row[5 - n], row[n]
    for n in range(6):
        row[n] = nearest_turn(row[n], wrist.middles[n])


@njit(cache=True, nogil=True, error_model="numpy")
def all_postures(wrist: Wrist, poses: FloatArray, angles: FloatArray, found: FloatArray) -> None:
    """Fill ``angles`` (M, 8, 6) and ``found`` (M,), bits in a number, for ``poses`` (M, 4, 4)."""
    for m in range(len(poses)):
        found[m] = near_postures(wrist, poses[m], ALL, angles[m])
    if wrist.off == 0.0:
        return
    for m in range(len(poses)):
        found[m] = refined(wrist.chain, wrist.handed, poses[m], angles[m], int(found[m]))
        for n in range(8):
            for joint in range(6):
                angles[m, n, joint] = nearest_turn(angles[m, n, joint], wrist.middles[joint])
