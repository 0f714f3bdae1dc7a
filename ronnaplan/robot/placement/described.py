"""What the description of an arm may mean otherwise than it is taken, and what it does not tell, told as doubts."""

from __future__ import annotations

import numpy as np

from ronnaplan.geometry import unit
from ronnaplan.robot.arm.arm import SerialArm
from ronnaplan.robot.arm.urdf import BASE, UrdfArm
from ronnaplan.robot.arm.urdf_chain import FLANGE
from ronnaplan.robot.placement.room import Room

USUAL_M = (0.1, 10.0)
"""Arms beside a patient are longer than the one, stretched, and shorter than the other."""
ALONG = 0.7
"""A tool whose direction has a larger cosine with the last joint's axis points out of the flange."""


def doubts_of_description(
    read: UrdfArm, room: Room, *, tip_is_named: bool, base_is_named: bool
) -> tuple[str, ...]:
    """Return what of an arm's file may be meant otherwise in ``room``, a sentence each, and what of it is not known.

    A link that is named as the tip or as the base is taken to be meant.
    """
    doubts = []
    if not tip_is_named and read.arm.flange_link != FLANGE:
        doubts.append(
            f"no link is called {FLANGE}, so that the flange is taken to be {read.arm.flange_link}, the last that "
            "turns; name it, or another, with --tip"
        )
    doubts += _tool_aside(read.arm, room)
    if not base_is_named and read.base_apart:
        doubts.append(
            f"R is the root link of the arm's description, and its link {BASE} stands elsewhere; where the robot's "
            "controller reports poses in that, as UR's do, name it with --base"
        )
    if read.shapeless and not room.arm_bodies:
        doubts.append(
            f"collisions of {', '.join(read.shapeless)} are not or not wholly looked at, as their shapes are meshes, "
            "are not told for collisions, or are moved by joints apart; state [[arm_body]] in the scene"
        )
    return tuple(doubts)


def doubts_of_arm(arm: SerialArm, room: Room) -> tuple[str, ...]:
    """Return why the lengths of an arm, none of its joints held, and its bodies in ``room`` may be wrong or missing."""
    doubts = []
    length_m = length_mm(arm) / 1000.0
    if not USUAL_M[0] <= length_m <= USUAL_M[1]:
        doubts.append(
            f"from its first joint to its flange the arm {arm.name} is {length_m:.3g} m long; expected "
            f"{USUAL_M[0]:g} to {USUAL_M[1]:g} m: lengths in a URDF are metres, bring to these what is in inches or "
            "other units"
        )
    bare = set(range(len(arm.joints))) - {link for link, _ in room.arm_bodies}  # the last link is a mere flange
    if room.arm_bodies and bare:
        doubts.append(
            "[[arm_body]] in the scene take the place of all shapes of the arm, and there are none of link "
            f"{', '.join(map(str, sorted(bare)))}: collisions of these are not looked at"
        )
    return tuple(doubts)


def length_mm(arm: SerialArm) -> float:
    """Return how long an arm is from its first joint to its flange, along its links (mm)."""
    steps_mm = [*arm.origins[1:, :3, 3], arm.flange[:3, 3]]
    return float(np.linalg.norm(steps_mm, axis=1).sum())


def _tool_aside(arm: SerialArm, room: Room) -> list[str]:
    """Say that the flange's z may not be what the room takes it for.

    The room states the tool in the flange's axes, mostly along its z; many descriptions turn the last joint about x.
    """
    axis = arm.flange[:3, :3].T @ arm.axes[-1]
    if max(abs(axis[2]), abs(axis @ unit(room.tool.direction))) >= ALONG:
        return []
    return [
        f"{arm.joints[-1]} does not turn about z of the flange {arm.flange_link} but about its "
        f"{'xyz'[np.argmax(np.abs(axis))]}, and the tool of the scene points across that; [tool] and [camera] are "
        "in the axes of that link: turn what they state, or name another link with --tip"
    ]
