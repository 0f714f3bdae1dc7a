"""The arm that ``robot place`` is told of: ``--arm``, ``--base``, ``--tip``, ``--hold``; what of it is not known."""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ronnaplan.robot.arm.arm import SerialArm
    from ronnaplan.robot.arm.urdf import UrdfArm
    from ronnaplan.robot.placement.room import Room

BUILT_IN = "kr6r900"
"""What ``--arm`` calls the arm that needs no file."""
USUAL_M = (0.1, 10.0)
"""Arms beside a patient are longer than the one, stretched, and shorter than the other."""
ALONG = 0.7
"""A tool whose direction has a larger cosine with the last joint's axis points out of the flange."""


def named_arm(arguments: argparse.Namespace, room: Room) -> tuple[SerialArm, list[str]]:
    """Return the built-in arm, or that of a file, with the joints held that are to be, and what of it is not known."""
    arm, notes = _described(arguments, room)
    notes += _length_notes(arm)
    bare = set(range(len(arm.joints))) - {link for link, _ in room.arm_bodies}  # the last link is a mere flange
    if room.arm_bodies and bare:
        notes.append(
            "[[arm_body]] in the scene take the place of all shapes of the arm, and there are none of link "
            f"{', '.join(map(str, sorted(bare)))}: collisions of these are not looked at"
        )
    return _held(arm, arguments.hold), notes


def _length_notes(arm: SerialArm) -> list[str]:
    """Say how long an arm is that no arm beside a head is: its description may be in inches."""
    import numpy as np

    steps_mm = [*arm.origins[1:, :3, 3], arm.flange[:3, 3]]
    length_m = float(np.linalg.norm(steps_mm, axis=1).sum()) / 1000.0
    if USUAL_M[0] <= length_m <= USUAL_M[1]:
        return []
    return [
        f"from its first joint to its flange the arm {arm.name} is {length_m:.3g} m long; expected {USUAL_M[0]:g} to "
        f"{USUAL_M[1]:g} m: lengths in a URDF are metres, bring to these what is in inches or other units"
    ]


def _held(arm: SerialArm, holds: Sequence[tuple[str, float]]) -> SerialArm:
    for joint, angle_deg in holds:
        arm = arm.holding(joint, math.radians(angle_deg))
    return arm


def example(arguments: argparse.Namespace) -> str:
    """Return a room to begin with, for the arm that is named; raises `InputError` for one that is not served."""
    from ronnaplan.documents.room_example import EXAMPLE, example_of
    from ronnaplan.robot.arm.kuka import kr6_r900
    from ronnaplan.robot.arm.wrist import wrist_of

    if arguments.arm == BUILT_IN:
        _require_no_link(arguments)
        wrist_of(_held(kr6_r900(), arguments.hold))
        return EXAMPLE
    read = _read(arguments)
    turning = _held(read.arm, arguments.hold)
    wrist_of(turning)  # nobody shall measure a room for an arm that is refused
    return example_of(read.arm, turning, are_meshes=bool(read.shapeless))


def _require_no_link(arguments: argparse.Namespace) -> None:
    """Raise `UsageError` for a link that is named of the built-in arm."""
    from ronnaplan.errors import UsageError

    for option, link in (("--tip", arguments.tip), ("--base", arguments.base)):
        if link is not None:
            raise UsageError(
                f"{option} is a link of a URDF file, and {BUILT_IN} is none; give the file with --arm"
            )


def _read(arguments: argparse.Namespace) -> UrdfArm:
    """Read the arm of a file; raises `InputError`, which names the built-in one, too, where there is no such file."""
    from ronnaplan.robot.arm.urdf import read_urdf
    from ronnaplan.untrusted import require_file

    require_file(arguments.arm, expected=f"a URDF file, or {BUILT_IN}, which needs none")
    return read_urdf(arguments.arm, tip=arguments.tip, base=arguments.base)


def _described(arguments: argparse.Namespace, room: Room) -> tuple[SerialArm, list[str]]:
    """Return the built-in arm, or that of a file, and what of its shapes is not known."""
    from ronnaplan.robot.arm.kuka import kr6_r900
    from ronnaplan.robot.arm.urdf import BASE

    if arguments.arm == BUILT_IN:
        _require_no_link(arguments)
        return kr6_r900(), []
    read = _read(arguments)
    notes = _flange_notes(read, room, arguments.tip is not None)
    if arguments.base is None and read.base_apart:
        notes.append(
            f"R is the root link of the arm's description, and its link {BASE} stands elsewhere; where the robot's "
            "controller reports poses in that, as UR's do, name it with --base"
        )
    if read.shapeless and not room.arm_bodies:
        notes.append(
            f"collisions of {', '.join(read.shapeless)} are not or not wholly looked at, as their shapes are meshes, "
            "are not told for collisions, or are moved by joints apart; state [[arm_body]] in the scene"
        )
    return read.arm, notes


def _flange_notes(read: UrdfArm, room: Room, is_named: bool) -> list[str]:
    """Say which link counts as the flange where nobody named it, and that its z may not be what the room takes it for.

    The room states the tool in the flange's axes, mostly along its z; many descriptions turn the last joint about x.
    """
    import numpy as np

    from ronnaplan.geometry import unit
    from ronnaplan.robot.arm.urdf import FLANGE

    notes, flange = [], read.arm.flange_link
    if not is_named and flange != FLANGE:
        notes.append(
            f"no link is called {FLANGE}, so that the flange is taken to be {flange}, the last that turns; name it, "
            "or another, with --tip"
        )
    axis = read.arm.flange[:3, :3].T @ read.arm.axes[-1]
    aside = max(abs(axis[2]), abs(axis @ unit(room.tool.direction))) < ALONG
    if aside:
        notes.append(
            f"{read.arm.joints[-1]} does not turn about z of the flange {flange} but about its "
            f"{'xyz'[np.argmax(np.abs(axis))]}, and the tool of the scene points across that; [tool] and [camera] are "
            "in the axes of that link: turn what they state, or name another link with --tip"
        )
    return notes
