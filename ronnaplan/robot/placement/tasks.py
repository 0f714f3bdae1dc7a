"""What the arm must do: drill along trajectories, view markers; each with every roll about its axis.

A task is a set of ways, any one of which serves it: poses of the flange in the room, one after the other, with the
same roll. Trajectories have one line, gone along from before the entry to the target; markers may be viewed from
several sides.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ronnaplan.geometry import FloatArray, unit
from ronnaplan.robot.arm.arm import SerialArm
from ronnaplan.robot.placement.room import Camera, Tool
from ronnaplan.robot.placement.world import moved_row
from ronnaplan.transforms import frame_along, invert, rigid

Kind = Literal["trajectory", "marker"]
SIDES, BETWEEN = 24, 4
"""Directions about the straight view from which a marker may be viewed, tilted. All rolls are tried from every fourth,
and from those between one of four: all would take three times as long, and hardly any view is lost."""


@dataclass(frozen=True, eq=False)
class Task:
    """Lines in the room that the tool's tip goes along: ``starts_mm`` to ``ends_mm`` (W, 3), any one of them."""

    name: str
    kind: Kind
    starts_mm: FloatArray
    ends_mm: FloatArray
    flange_from_tip: FloatArray
    every: tuple[int, ...]
    """Of the rolls about each line one of so many is tried (W,)."""
    instrument: FloatArray
    """The instrument as a capsule (7,) in the flange's frame; of no radius where there is none."""


@dataclass(frozen=True)
class Fineness:
    """How closely tasks are looked at: rolls about an axis, and the distance between two poses on a line."""

    rolls: int
    step_mm: float
    least_steps: int = 2


class Ways(NamedTuple):
    """All ways (N) of all tasks (T), for the kernels."""

    flanges: FloatArray
    """Room from flange (N, P, 4, 4)."""
    firsts: NDArray[np.int64]
    """The first way of each task, and their number (T + 1,)."""
    steps: NDArray[np.int64]
    """How many poses the ways of each task have (T,)."""
    instruments: FloatArray
    """Capsules (T, 7) in the last link's frame."""
    kept: FloatArray
    """Clearance (mm) and tracker's margin (rad) that no posture on a way exceeds, from any base (N, 2)."""


def drill_task(
    name: str, entry_mm: FloatArray, target_mm: FloatArray, tool: Tool, length_mm: float, diameter_mm: float
) -> Task:
    """Return the task of a trajectory (3,) to (3,) in the room, with an instrument of that usable length."""
    inward = unit(target_mm - entry_mm)
    holder = frame_along(np.array(tool.start_mm), np.array(tool.direction))
    tip = holder @ rigid(np.eye(3), np.array([0.0, 0.0, length_mm]))
    instrument = np.array([*holder[:3, 3], *tip[:3, 3], diameter_mm / 2])
    start = entry_mm - tool.standoff_mm * inward
    return Task(name, "trajectory", start[None], np.asarray(target_mm)[None], tip, (1,), instrument)


def view_task(name: str, marker_mm: FloatArray, head_center_mm: FloatArray, camera: Camera) -> Task:
    """Return the task of viewing a marker (3,) of a head about ``head_center_mm`` (3,), both in the room."""
    frame = frame_along(np.zeros(3), marker_mm - head_center_mm)[:3, :3]
    tilt, about = np.radians(camera.tilt_deg), np.arange(SIDES) * 2 * np.pi / SIDES
    every = (1, *(BETWEEN if n % BETWEEN else 1 for n in range(SIDES)))
    tilted = np.stack([np.sin(tilt) * np.cos(about), np.sin(tilt) * np.sin(about), np.full(SIDES, np.cos(tilt))])
    outward = np.concatenate([[[0.0, 0.0, 1.0]], tilted.T]) @ frame.T
    ends = np.broadcast_to(marker_mm, outward.shape).copy()
    tcp = frame_along(np.array(camera.tcp_mm), np.array(camera.direction))
    return Task(name, "marker", ends + camera.standoff_mm * outward, ends, tcp, every, np.zeros(7))


def ways_of(tasks: Sequence[Task], arm: SerialArm, fineness: Fineness) -> Ways:
    """Return every way of every task, as closely as ``fineness`` says."""
    lengths = [float(np.linalg.norm(task.ends_mm - task.starts_mm, axis=1).max()) for task in tasks]
    steps = [max(fineness.least_steps, 1 + int(np.ceil(length / fineness.step_mm))) for length in lengths]
    most = max(steps, default=1)
    parts = [_poses(task, count, most, fineness.rolls) for task, count in zip(tasks, steps, strict=True)]
    firsts = np.cumsum([0, *(len(part) for part in parts)])
    instruments = [moved_row(arm.flange, task.instrument) for task in tasks]
    return Ways(
        np.concatenate(parts),
        firsts.astype(np.int64),
        np.array(steps, dtype=np.int64),
        np.array(instruments),
        np.full((firsts[-1], 2), np.inf),
    )


def _poses(task: Task, steps: int, most: int, rolls: int) -> FloatArray:
    """Return room from flange (N, most, 4, 4), of which the first ``steps`` count."""
    found, tip_from_flange = [], invert(task.flange_from_tip)
    angles = np.arange(rolls) * 2 * np.pi / rolls
    turns = np.zeros((rolls, 3, 3))
    turns[:, 0, 0] = turns[:, 1, 1] = np.cos(angles)
    turns[:, 1, 0], turns[:, 0, 1], turns[:, 2, 2] = np.sin(angles), -np.sin(angles), 1.0
    for start, end, every in zip(task.starts_mm, task.ends_mm, task.every, strict=True):
        rolled = frame_along(start, end - start)[:3, :3] @ turns[::every]
        places = start + np.linspace(0.0, 1.0, steps)[:, None] * (end - start)
        shape = len(rolled), steps, 3
        at = rigid(np.broadcast_to(rolled[:, None], (*shape, 3)), np.broadcast_to(places, shape))
        ways = np.zeros((len(rolled), most, 4, 4))
        ways[:, :steps] = at @ tip_from_flange
        found.append(ways)
    return np.concatenate(found)
