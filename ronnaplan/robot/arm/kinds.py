"""Which of three kinds of closed form an arm has by how its six axes stand and meet, and the nearest that has it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ronnaplan.errors import InputError
from ronnaplan.geometry import FloatArray, unit
from ronnaplan.robot.arm.forward import LENGTH_MM

ANGLE_TOLERANCE = 1e-7
"""Axes whose cosine or sine is below this are perpendicular or parallel, to the digits of a description."""
NEARLY = 1e-2
"""Axes that miss by less were meant to be so: robots are built, and calibrated, some thousandths off."""
MEETING_MM = 1e-4
"""Axes meet that all pass one place nearer than this."""
NEARLY_MM = 3.0
"""Axes were meant to meet that all pass one place nearer than this."""


class Axes(NamedTuple):
    """Six axes as their kind of closed form needs them, in the order in which they are solved."""

    off: float
    """By how much they stand and meet otherwise (rad, mm per `LENGTH_MM`); zero to the digits."""
    places: FloatArray
    """A place (6, 3) on each."""
    axes: FloatArray
    """Their directions (6, 3)."""
    center: FloatArray
    """Where those of the wrist meet (3,)."""
    parallel: bool
    """Whether axis 4 is parallel to axes 2 and 3; otherwise axes 4, 5 and 6 meet."""


def shoulder_is_spherical(axes: FloatArray) -> bool:
    """Whether of ``axes`` (6, 3) the third is across the second, as it is of no other kind: parallel to it there."""
    return abs(float(axes[1] @ axes[2])) < NEARLY


def from_base(joints: tuple[str, ...], places: FloatArray, axes: FloatArray) -> Axes:
    """Return axes of a spherical or a parallel wrist, from those that go through ``places`` (6, 3) along ``axes``.

    Raises `InputError` that names ``joints`` whose axes are not even nearly of either kind.
    """
    off = _angles_off(joints, axes, "parallel")
    wrist_off, parallel, center = _wrist(joints, places, axes)
    off = max(off, wrist_off)
    if off:
        places, axes = _nearest(places, axes, parallel, center)
    return Axes(off, places, axes, center, parallel)


def from_flange(joints: tuple[str, ...], places: FloatArray, axes: FloatArray) -> Axes:
    """Return the same of a spherical shoulder, the wrist of the arm seen from its flange: axes (6, 3), sixth first."""
    off = _angles_off(joints, axes, "perpendicular")
    center, apart_mm = _meeting(places[3:], axes[3:])
    origin, apart_two_mm = _meeting(places[:2], axes[:2])
    beside_mm = abs(float((center - origin) @ axes[2]))
    six, five, four, three, two, one = joints
    miss_mm, what, expected = max(
        (apart_mm, f"the axes of {one}, {two} and {three} pass each other by", "expected all three to meet"),
        (apart_two_mm, f"the axes of {five} and {six} pass each other by", "expected both to meet"),
        (beside_mm, f"along the axis of {four} wrist and shoulder are apart by", "expected them in one plane"),
    )
    if miss_mm >= NEARLY_MM:
        raise InputError(f"{what} {miss_mm:.3g} mm, {expected}")
    if miss_mm >= MEETING_MM:
        off = max(off, miss_mm / LENGTH_MM)
    stood = axes.copy()
    if off:
        for n in (1, 2, 4, 5):
            stood[n] = _across(axes[n], stood[n - 1])
    return Axes(off, np.stack([origin, origin, *places[2:]]), stood, center, False)


def _angles_off(joints: tuple[str, ...], axes: FloatArray, elbow: str) -> float:
    """Return by how much the axes (6, 3) stand otherwise than a closed form needs it (rad), zero to the digits.

    Axis 3 shall be parallel to axis 2, or perpendicular, as ``elbow`` says. Raises `InputError` naming the first two
    joints where that is not even nearly so.
    """
    largest = 0.0
    for a, b, stand in (
        (1, 2, elbow),
        (0, 1, "perpendicular"),
        (3, 4, "perpendicular"),
        (4, 5, "perpendicular"),
    ):
        miss = _off_parallel(axes[a], axes[b]) if stand == "parallel" else abs(float(axes[a] @ axes[b]))
        if miss >= NEARLY:
            raise InputError(
                f"the axes of {joints[a]} and {joints[b]} are {_degrees(miss)} from {stand}, expected {stand}"
            )
        largest = max(largest, miss)
    return 0.0 if largest < ANGLE_TOLERANCE else largest


def _wrist(joints: tuple[str, ...], places: FloatArray, axes: FloatArray) -> tuple[float, bool, FloatArray]:
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
    _, two, _, four, five, six = joints
    raise InputError(
        f"the axes of {four}, {five} and {six} pass each other by {apart_mm:.3g} mm, those of {five} and {six} by "
        f"{apart_two_mm:.3g} mm, and that of {four} is {_degrees(miss)} from parallel to that of {two}; expected all "
        "three to meet, or the last two and a parallel one"
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
        stood[n] = _across(axes[n], stood[n - 1])
    return placed, stood


def _across(axis: FloatArray, other: FloatArray) -> FloatArray:
    """Return the direction (3,) nearest to ``axis`` (3,) that is perpendicular to ``other`` (3,)."""
    return unit(axis - (axis @ other) * other)


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
