"""A posture to start from and to go by, for an arm of which nobody has told one."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np

from ronnaplan.geometry import FloatArray, axes_across
from ronnaplan.robot.arm.arm import SerialArm
from ronnaplan.robot.arm.forward import link_frames
from ronnaplan.robot.arm.inverse import inverse
from ronnaplan.robot.arm.quality import joint_margins_deg, singularity_deg
from ronnaplan.robot.arm.wrist import Wrist, reach_mm, shoulder_mm, wrist_of
from ronnaplan.robot.placement.clearances import posture_margins, standing_on
from ronnaplan.robot.placement.machine import unchecked_machine
from ronnaplan.robot.placement.room import Room
from ronnaplan.robot.placement.world import world_of
from ronnaplan.transforms import exponential, frame_along, rigid

AHEAD, UP = np.linspace(0.3, 0.7, 5), np.linspace(0.1, 0.6, 6)
"""Where the flange may be: so many of the arm's reach before its shoulder, and above it."""
DOWN_DEG, ROLLS_DEG = np.arange(0.0, 91.0, 15.0), np.arange(0.0, 360.0, 45.0)
"""How far down it may point from straight ahead, and how it may be turned about that direction."""
BEST_AHEAD, BEST_UP, BEST_DOWN_DEG = 0.5, 0.3, 60.0
"""Of those that keep enough the nearest to this is proposed."""
ENOUGH_DEG, ENOUGH_MM = 30.0, 40.0
"""Margins beyond which more counts no more; of what is less these count alike."""
UPRIGHT = 0.5
HIGH_MM, FAR_MM = 10_000.0, 1e6
"""Floor and trolley count where axis 1 points up by more than this cosine; else, and as the head, they are far."""


def proposed_deg(arm: SerialArm, room: Room) -> tuple[float, ...]:
    """Return a posture (6,) in whole degrees that keeps apart from itself, its limits and singular ones.

    Its flange is before the shoulder and above it (seen from where the arm is mounted), and points ahead and down, with
    the elbow up where it can be. Joint 1, which counts from the tasks, is zero. The ``room`` tells the arm's bodies,
    the tool and the trolley. Where the arm reaches nothing of the kind these are the middles of its limits. Raises
    `InputError` for an arm that has no closed form or no bodies.
    """
    wrist = wrist_of(arm)
    poses, departures = _flanges(wrist, arm)
    found = inverse(arm, poses)
    at, _ = np.nonzero(found.within)
    postures = (
        np.degrees(np.vstack([found.angles_rad[found.within], wrist.middles])).round() + 0.0
    )  # no minus zero
    postures[:, 0] = 0.0
    kept = np.minimum(_margins(arm, room, wrist, np.radians(postures)), 1.0)
    heights = link_frames(arm, np.radians(postures))[:, :, :3, 3].mean(axis=1) @ _mounted(wrist, arm)
    departures = np.append(departures[at], np.inf) - heights / reach_mm(wrist)
    turned = np.abs(postures).sum(axis=1)
    best = np.lexsort((turned, departures.round(2), -kept))[0]
    return tuple(postures[best].tolist())


def _flanges(wrist: Wrist, arm: SerialArm) -> tuple[FloatArray, FloatArray]:
    """Return poses of the flange (M, 4, 4) in the base, and by how much each departs from what is best (M,)."""
    up = _mounted(wrist, arm)
    ahead, _ = axes_across(up)
    shoulder, reach = shoulder_mm(wrist), reach_mm(wrist)
    poses, departures = [], []
    for forwards, above, down_deg, roll_deg in product(AHEAD, UP, DOWN_DEG, ROLLS_DEG):
        down, roll = np.radians(down_deg), np.radians(roll_deg)
        pose = frame_along(
            shoulder + reach * (forwards * ahead + above * up), np.cos(down) * ahead - np.sin(down) * up
        )
        pose[:3, :3] = pose[:3, :3] @ exponential(np.array([0.0, 0.0, roll]))
        poses.append(pose)
        aside_deg = abs(down_deg - BEST_DOWN_DEG)
        departures.append(abs(forwards - BEST_AHEAD) + abs(above - BEST_UP) + np.radians(aside_deg))
    return np.array(poses), np.array(departures)


def _mounted(wrist: Wrist, arm: SerialArm) -> FloatArray:
    """Return the direction of axis 1 away from where the arm is mounted (3,), in the base."""
    first = link_frames(arm, np.zeros(len(arm)))[1]
    axis: FloatArray = first[:3, :3] @ arm.axes[0]
    out = float(axis @ shoulder_mm(wrist))
    return axis if out > 0.0 or (out == 0.0 and axis[2] > 0.0) else -axis


def _margins(arm: SerialArm, room: Room, wrist: Wrist, postures: FloatArray) -> FloatArray:
    """Return the least margin (N,) of each of ``postures`` (N, 6) in rad, as a part of what is enough."""
    joints = joint_margins_deg(arm, postures)[:, 1:].min(axis=1)
    machine, bare = unchecked_machine(arm, room, wrist), replace(room, boxes=(), capsules=(), tracker=None)
    base = rigid(np.eye(3), np.array([0.0, 0.0, room.floor.z_mm[0]]))
    if _mounted(wrist, arm)[2] < UPRIGHT:
        machine, base[2, 3] = machine._replace(trolley=machine.trolley[:0]), HIGH_MM
    world = world_of(bare, np.full((1, 3), FAR_MM), None)._replace(needs=np.full(4, -np.inf))  # all is told
    standing, none = standing_on(machine, base), np.zeros(7)
    apart = [posture_margins(machine, world, standing, none, one, np.inf, False)[0] for one in postures]
    least_deg = np.minimum(joints, singularity_deg(arm, postures))
    kept: FloatArray = np.minimum(least_deg / ENOUGH_DEG, np.array(apart) / ENOUGH_MM)
    return kept
