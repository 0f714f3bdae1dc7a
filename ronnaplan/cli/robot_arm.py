"""The arm that ``robot place`` is told of: ``--arm``, ``--base``, ``--tip``, ``--hold``."""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from ronnaplan.cli.values import held

if TYPE_CHECKING:
    from ronnaplan.robot.arm.arm import SerialArm
    from ronnaplan.robot.arm.urdf import UrdfArm
    from ronnaplan.robot.placement.room import Room

BUILT_IN = "kr6r900"
"""What ``--arm`` calls the arm that needs no file."""


def configure_arm(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments that name an arm."""
    parser.add_argument(
        "--arm", default=BUILT_IN, metavar="ARM", help="kr6r900 or a URDF file (default %(default)s)"
    )
    parser.add_argument(
        "--tip", metavar="LINK", help="the link of the URDF that is the flange, z pointing out of it"
    )
    parser.add_argument(
        "--base",
        metavar="LINK",
        help="the link of the URDF in which the robot's controller reports poses (default: the file's root link)",
    )
    parser.add_argument(
        "--hold",
        action="append",
        default=[],
        type=held,
        metavar="JOINT=DEGREES",
        help="a joint of the arm that stays at an angle, so that one of seven joints is planned with as one of six "
        "(repeatable)",
    )


def named_arm(arguments: argparse.Namespace, room: Room) -> tuple[SerialArm, tuple[str, ...]]:
    """Return the built-in arm, or that of a file, with the joints held that are to be, and what of it is doubtful."""
    from ronnaplan.robot.arm.kuka import kr6_r900
    from ronnaplan.robot.placement.described import doubts_of_arm, doubts_of_description

    doubts: tuple[str, ...] = ()
    if arguments.arm == BUILT_IN:
        _require_no_link(arguments)
        arm = kr6_r900()
    else:
        read = _read(arguments)
        arm = read.arm
        doubts = doubts_of_description(
            read, room, tip_is_named=arguments.tip is not None, base_is_named=arguments.base is not None
        )
    return _held(arm, arguments.hold), (*doubts, *doubts_of_arm(arm, room))


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
