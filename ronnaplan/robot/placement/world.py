"""The room as a tuple of arrays, which the compiled kernels take; mm and rad."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ronnaplan.geometry import FloatArray
from ronnaplan.robot.placement.room import Box, Capsule, Room
from ronnaplan.transforms import transform_points

HEAD_SPACING_MM = 12.0
"""What is of the head is covered by one ball for each cube of this."""
GATHERED_MM = 60.0
"""Balls with their middles in one cube of this are looked at together, and singly only where they are near."""

NO_BALLS = np.zeros((0, 4))

PLENTY_MM, PLENTY_DEG = 100.0, 45.0
"""Clearance and margin of the tracker's view beyond which more counts no more."""


JOINT_NEED, SINGULAR_NEED, CLEARANCE_NEED, VIEW_NEED = range(4)
"""Which margin is asked for at which place of `World.needs`."""

NEAREST, FARTHEST, OWN_BODY, BEAM, WIDEST = range(5)
"""What stands at which place of `World.sight`."""


class World(NamedTuple):
    """What stands in the room, and what is asked for."""

    boxes: FloatArray
    capsules: FloatArray
    head: FloatArray
    """Balls (H, 4), middle and radius, that cover the scalp, then what stands out of it, and the markers."""
    scalp: int
    """How many of them, the first, cover the scalp."""
    gathered: FloatArray
    """Balls (G, 4), each about those of the head that follow each other."""
    firsts: NDArray[np.int64]
    """The first ball of the head in each, and their number (G + 1,)."""
    head_ball: FloatArray
    """The same (4,) of a ball about them all."""
    tracker: FloatArray
    """Its place (3,)."""
    sight: FloatArray
    """What the tracker sees (5,): from `NEAREST` to `FARTHEST`, to `WIDEST` off the marker's normal, in mm and rad.

    Nothing may come within `BEAM` of the line to the marker but on its last `OWN_BODY`, where the tracker itself is.
    All are zero where nothing is tracked.
    """
    needs: FloatArray
    """Margins (4,) that are asked for, in rad, that of clearance in mm."""
    plenty: FloatArray
    """Clearance (mm) and tracker's margin (rad) beyond which more counts no more (2,)."""


def world_of(
    room: Room,
    head_mm: FloatArray,
    tracker_mm: FloatArray | None,
    markers_mm: FloatArray = NO_BALLS,
    beside_mm: FloatArray = NO_BALLS,
) -> World:
    """Return the room with the places ``head_mm`` (H, 3) on the head, and the tracker's place (3,) in the room.

    Balls, middles and radii, belong to the head, too: ``markers_mm`` (M, 4), each where it is and as large, and
    ``beside_mm`` (B, 4), which are covered by fewer.
    """
    scalp = _covered(np.column_stack([head_mm, np.zeros(len(head_mm))]))
    scalp[:, 3] = np.maximum(scalp[:, 3], HEAD_SPACING_MM / 2)
    parts = [_gathered(one) for one in (scalp, np.concatenate([_covered(beside_mm), markers_mm]))]
    head, gathered, counts = (np.concatenate(each) for each in zip(*parts, strict=True))
    middle = head[:, :3].mean(axis=0)
    reach = float((np.linalg.norm(head[:, :3] - middle, axis=1) + head[:, 3]).max())
    sight = np.zeros(5)
    if tracker_mm is not None and room.tracker is not None and room.tool.marker is not None:
        told = room.tracker
        sight[NEAREST], sight[FARTHEST] = told.nearest_mm, told.farthest_mm
        sight[OWN_BODY], sight[BEAM] = told.body_mm, told.beam_mm
        sight[WIDEST] = np.radians(room.tool.marker.seen_deg)
    needs = room.margins
    return World(
        boxes=box_rows(room.boxes),
        capsules=np.array([capsule_row(one) for one in room.capsules]).reshape(-1, 7),
        head=head,
        scalp=len(scalp),
        gathered=gathered,
        firsts=np.cumsum([0, *counts]),
        head_ball=np.array([*middle, reach]),
        tracker=np.zeros(3) if tracker_mm is None else np.array(tracker_mm, dtype=np.float64),
        sight=sight,
        needs=np.array(
            [
                np.radians(needs.joint_deg),
                np.radians(needs.singularity_deg),
                needs.clearance_mm,
                np.radians(needs.tracker_deg),
            ]
        ),
        plenty=np.array([PLENTY_MM, np.radians(PLENTY_DEG)]),
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
    return np.array([*capsule.start_mm, *capsule.end_mm, capsule.radius_mm], dtype=np.float64)


def moved_row(pose: FloatArray, row: FloatArray) -> FloatArray:
    """Return a capsule (7,) brought by ``pose`` (4, 4)."""
    return np.array([*transform_points(pose, row[:6].reshape(2, 3)).ravel(), row[6]])


def _covered(balls: FloatArray) -> FloatArray:
    """Return balls (C, 4) that cover ``balls`` (B, 4), one for those with their middles in a cube."""
    return _about(balls, *_in_cubes(balls, HEAD_SPACING_MM))


def _gathered(balls: FloatArray) -> tuple[FloatArray, FloatArray, NDArray[np.int64]]:
    """Return ``balls`` (B, 4) by cubes, balls (G, 4) about those of each, and how many these are (G,)."""
    group, counts = _in_cubes(balls, GATHERED_MM)
    return balls[np.argsort(group, kind="stable")], _about(balls, group, counts), counts


def _in_cubes(balls: FloatArray, side_mm: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return in which cube with any the middle of each of ``balls`` (B, 4) lies, and how many lie in each."""
    cubes = np.floor(balls[:, :3] / side_mm).astype(np.int64)
    _, group, counts = np.unique(cubes, axis=0, return_inverse=True, return_counts=True)
    return group.ravel(), counts


def _about(balls: FloatArray, group: NDArray[np.int64], counts: NDArray[np.int64]) -> FloatArray:
    """Return balls (C, 4) about those of ``balls`` (B, 4) that are of one ``group`` (B,), ``counts`` (C,) of each."""
    sums = np.stack([np.bincount(group, weights=balls[:, k], minlength=len(counts)) for k in range(3)], axis=1)
    middles, radii = sums / counts[:, None], np.zeros(len(counts))
    np.maximum.at(radii, group, np.linalg.norm(balls[:, :3] - middles[group], axis=1) + balls[:, 3])
    return np.column_stack([middles, radii])
