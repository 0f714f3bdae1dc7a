"""The room and the robot as tuples of arrays, which the compiled kernels take; mm and rad."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ronnaplan.errors import InputError
from ronnaplan.geometry import FloatArray, unit
from ronnaplan.robot.arm.arm import Body, SerialArm
from ronnaplan.robot.arm.wrist import Wrist, wrist_of
from ronnaplan.robot.placement.room import Box, Capsule, Room

HEAD_SPACING_MM = 12.0
"""Places on the head's surface are thinned to this: with its half added to them they cover the surface."""

PLENTY_MM, PLENTY_DEG = 100.0, 45.0
"""Clearance and margin of the tracker's view beyond which more counts no more."""


class Machine(NamedTuple):
    """The arm with what its flange carries. Bodies are in their links' frames; the last ones are the tool's."""

    wrist: Wrist
    origins: FloatArray
    axes: FloatArray
    links: NDArray[np.int64]
    bodies: FloatArray
    """Capsules (K, 7)."""
    tool_from: int
    """Bodies from this one on belong to the tool."""
    trolley: FloatArray
    """Boxes (V, 8) in the base's frame."""
    marker: FloatArray
    """Place and normal (2, 3) of the tool's marker, in the last link."""


class World(NamedTuple):
    """What stands in the room, and what is asked for."""

    boxes: FloatArray
    capsules: FloatArray
    head: FloatArray
    """Places (H, 3) on the head's surface."""
    head_ball: FloatArray
    """Middle and radius (4,) of a ball about them all, radius included."""
    head_radius: float
    tracker: FloatArray
    """Its place (3,)."""
    sight: FloatArray
    """Nearest, farthest, its own body, beam radius, greatest angle in rad (5,); all zero where nothing is tracked."""
    needs: FloatArray
    """Joint, singularity (rad), clearance (mm), tracker (rad) margins (4,)."""
    plenty: FloatArray
    """Clearance (mm) and tracker's margin (rad) beyond which more counts no more (2,)."""


def machine_of(arm: SerialArm, room: Room) -> Machine:
    """Return the robot with the room's tool.

    Raises `InputError` for an arm that has no closed form, no bodies, or does not reach the room's reference posture.
    """
    wrist = wrist_of(arm)
    _require_posture(arm, room.reference_deg)
    of_links = [
        (body.link, _row(body.start_mm, body.end_mm, body.radius_mm)) for body in clad(arm, room.arm_bodies).bodies
    ]
    if not of_links:
        raise InputError(
            f"the links of {arm.name} have no simple shapes; state capsules as [[arm_body]] in the room"
        )
    tool = [(len(arm), _moved(arm.flange, capsule_row(one))) for one in room.tool.bodies]
    marker = np.zeros((2, 3))
    if room.tool.marker is not None:
        marker[0] = arm.flange[:3, :3] @ np.array(room.tool.marker.at_mm) + arm.flange[:3, 3]
        marker[1] = arm.flange[:3, :3] @ unit(room.tool.marker.normal)
    every = of_links + tool
    return Machine(
        wrist,
        np.ascontiguousarray(arm.origins),
        np.ascontiguousarray(arm.axes),
        np.array([link for link, _ in every], dtype=np.int64),
        np.array([row for _, row in every]),
        len(of_links),
        box_rows(room.floor.trolley),
        marker,
    )


def clad(arm: SerialArm, told: Sequence[tuple[int, Capsule]]) -> SerialArm:
    """Return the arm with the bodies that a room has ``told`` of, with each link's number, or else with its own."""
    if not told:
        return arm
    return arm.with_bodies(
        [Body(one.name, link, np.array(one.start_mm), np.array(one.end_mm), one.radius_mm) for link, one in told]
    )


def _require_posture(arm: SerialArm, reference_deg: Sequence[float]) -> None:
    """Raise `InputError` for a joint beyond its limits; joint 1 counts from the tasks, and is kept within its own."""
    told = zip(arm.joints, reference_deg, arm.limits_rad.tolist(), strict=True)
    for number, (joint, angle, (least, greatest)) in list(enumerate(told, start=1))[1:]:
        if not least <= np.radians(angle) <= greatest:
            raise InputError(
                f"reference_deg in the room has {angle:g} degrees for joint {number} of {arm.name}, {joint}; expected "
                f"{np.degrees(least):.1f} to {np.degrees(greatest):.1f}"
            )


def world_of(room: Room, head_mm: FloatArray, tracker_mm: FloatArray | None) -> World:
    """Return the room with the places ``head_mm`` (H, 3) on the head, and the tracker's place (3,) in the room."""
    thinned = _thinned(head_mm)
    middle = thinned.mean(axis=0)
    radius = HEAD_SPACING_MM / 2
    reach = float(np.linalg.norm(thinned - middle, axis=1).max()) + radius
    sight = np.zeros(5)
    if tracker_mm is not None and room.tracker is not None and room.tool.marker is not None:
        told = room.tracker
        sight[:] = (told.nearest_mm, told.farthest_mm, told.body_mm, told.beam_mm, 0.0)
        sight[4] = np.radians(room.tool.marker.seen_deg)
    needs = room.margins
    return World(
        box_rows(room.boxes),
        np.array([capsule_row(one) for one in room.capsules]).reshape(-1, 7),
        thinned,
        np.array([*middle, reach]),
        radius,
        np.zeros(3) if tracker_mm is None else np.array(tracker_mm, dtype=np.float64),
        sight,
        np.array(
            [
                np.radians(needs.joint_deg),
                np.radians(needs.singularity_deg),
                needs.clearance_mm,
                np.radians(needs.tracker_deg),
            ]
        ),
        np.array([PLENTY_MM, np.radians(PLENTY_DEG)]),
    )


def box_rows(boxes: Sequence[Box]) -> FloatArray:
    """Return boxes as rows (B, 8)."""
    turns = np.radians([box.turn_deg for box in boxes])
    rows = [
        [*box.center_mm, *(side / 2 for side in box.size_mm), np.cos(turn), np.sin(turn)]
        for box, turn in zip(boxes, turns, strict=True)
    ]
    return np.array(rows, dtype=np.float64).reshape(-1, 8)


def capsule_row(capsule: Capsule) -> FloatArray:
    """Return a capsule as a row (7,)."""
    return _row(np.array(capsule.start_mm), np.array(capsule.end_mm), capsule.radius_mm)


def _row(start_mm: FloatArray, end_mm: FloatArray, radius_mm: float) -> FloatArray:
    return np.array([*start_mm, *end_mm, radius_mm], dtype=np.float64)


def _moved(pose: FloatArray, row: FloatArray) -> FloatArray:
    ends = row[:6].reshape(2, 3) @ pose[:3, :3].T + pose[:3, 3]
    return np.array([*ends.ravel(), row[6]])


def _thinned(places_mm: FloatArray) -> FloatArray:
    """Return one place of each cube of `HEAD_SPACING_MM`, the mean of those in it."""
    cubes = np.floor(places_mm / HEAD_SPACING_MM).astype(np.int64)
    _, group = np.unique(cubes, axis=0, return_inverse=True)
    counts = np.bincount(group.ravel())
    sums = np.stack([np.bincount(group.ravel(), weights=places_mm[:, k]) for k in range(3)], axis=1)
    return np.ascontiguousarray(sums / counts[:, None])
