"""``ronnaplan robot export``: the plan's trajectories as points in the robot's coordinates."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import TYPE_CHECKING

from ronnaplan.cli.output import tell, warn
from ronnaplan.cli.values import number
from ronnaplan.documents.robot_formats import ENDINGS, RobotFormat

if TYPE_CHECKING:
    from ronnaplan.documents.chain import ChainDocument
    from ronnaplan.documents.fields import Vector
    from ronnaplan.planning import Plan
    from ronnaplan.robot.trajectories import RobotTrajectory

HELP = "Write a plan's trajectories in the robot's coordinates: JSON, CSV, YAML for ROS, points for a KUKA."
APPROACH_MM, LARGEST_APPROACH_MM = 50.0, 500.0


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``robot export``."""
    parser.add_argument("chain", metavar="CHAIN", help="chain.json")
    parser.add_argument("plan", metavar="PLAN", help="the plan of the same scan")
    parser.add_argument(
        "--to",
        choices=[one.value for one in RobotFormat],
        default=RobotFormat.JSON.value,
        help="krl: points for a KUKA; ros: YAML (default %(default)s)",
    )
    parser.add_argument(
        "--approach",
        type=number,
        metavar="MM",
        help=f"distance before the entry (default {APPROACH_MM:g}; with --placement, from where that comes)",
    )
    rolls = parser.add_mutually_exclusive_group()
    rolls.add_argument(
        "--x-axis",
        nargs=3,
        type=number,
        default=(1.0, 0.0, 0.0),
        metavar=("X", "Y", "Z"),
        help="direction in R that the tool's x axis keeps close to (default 1 0 0)",
    )
    rolls.add_argument(
        "--placement",
        metavar="FILE",
        help="placement.json of 'robot place' with this chain: roll as the arm does there (the room has to state "
        "x_axis in [tool])",
    )
    parser.add_argument("-o", "--output", metavar="FILE", help="file to write (default: standard output)")


def run(arguments: argparse.Namespace) -> int:
    """Write the plan's trajectories in R."""
    from pathlib import Path

    from ronnaplan.documents.chain import read_chain
    from ronnaplan.documents.files import require_ending, write_result
    from ronnaplan.documents.plan import read_plan
    from ronnaplan.documents.robot_points import KRL_LIST, POINTS_NOTICE, export_points
    from ronnaplan.robot.trajectories import robot_trajectory

    _check(arguments)
    to = RobotFormat(arguments.to)
    if arguments.output:
        require_ending(arguments.output, to, ENDINGS.get(to, ("",)))
    chain, plan = read_chain(arguments.chain), read_plan(arguments.plan)
    plan.identity.require(chain.identity)
    x_axes, approach_mm = _rolls(arguments, plan, chain)
    trajectories = [
        robot_trajectory(one.name, one.entry_mm, one.target_mm, chain.pose, frame=plan.frame, x_axis=x_axis)
        for one, x_axis in zip(plan.trajectories, x_axes, strict=True)
    ]
    named = Path(arguments.output).stem if arguments.output else KRL_LIST
    write_result(arguments.output, export_points(trajectories, chain, to, approach_mm, named))
    warn(*chain.notes, *_doubts(arguments, trajectories))
    for one in trajectories:
        entry, target = one.expected_errors_mm
        tell(f"{one.name}: expected error {entry:.3f} mm RMS at the entry, {target:.3f} at the target")
    tell(POINTS_NOTICE)
    return 0


def _check(arguments: argparse.Namespace) -> None:
    """Raise `UsageError` for a distance or a direction that is none."""
    from ronnaplan.errors import UsageError

    if arguments.approach is not None and not 0 <= arguments.approach <= LARGEST_APPROACH_MM:
        raise UsageError(f"--approach {arguments.approach:g} is no distance of 0 to {LARGEST_APPROACH_MM:g} mm")
    if not any(arguments.x_axis):
        raise UsageError("--x-axis 0 0 0 has no direction; give one in R")


def _rolls(arguments: argparse.Namespace, plan: Plan, chain: ChainDocument) -> tuple[Sequence[Vector], float]:
    """Return for each trajectory where the tool's x axis shall point in R, and the distance before the entries (mm).

    With a placement both are what that looked at. Raises `InputError` for a point further out.
    """
    from ronnaplan.documents.placement import read_placement
    from ronnaplan.documents.robot_points import placed_x_axes
    from ronnaplan.errors import InputError

    asked: float | None = arguments.approach
    if arguments.placement is None:
        return [tuple(arguments.x_axis)] * len(plan.trajectories), APPROACH_MM if asked is None else asked
    placement = read_placement(arguments.placement)
    x_axes = placed_x_axes(placement, plan, chain)
    looked_at = placement.standoff_mm
    if asked is not None and asked > looked_at:
        raise InputError(
            f"--approach {asked:g} lies further out than {arguments.placement} looked at ({looked_at:g} mm before the "
            "entries, standoff_mm in [tool] of the room); ask for less, or run 'robot place' with more"
        )
    return x_axes, looked_at if asked is None else asked


def _doubts(arguments: argparse.Namespace, trajectories: Sequence[RobotTrajectory]) -> tuple[str, ...]:
    """Return what is doubtful of the rolls that were asked for; those of a placement are the arm's own."""
    from ronnaplan.robot.trajectories import roll_doubts

    return roll_doubts(trajectories, arguments.x_axis) if arguments.placement is None else ()
