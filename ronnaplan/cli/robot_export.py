"""``ronnaplan robot export``: the plan's trajectories as points in the robot's coordinates."""

from __future__ import annotations

import argparse
import sys

from ronnaplan.cli.output import warn
from ronnaplan.cli.values import number
from ronnaplan.documents.robot_formats import ENDINGS, RobotFormat

HELP = "Write a plan's trajectories in the robot's coordinates: JSON, CSV, YAML for ROS, points for a KUKA."
LARGEST_APPROACH_MM = 500.0


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
        default=50.0,
        metavar="MM",
        help="distance before the entry (default %(default)s)",
    )
    parser.add_argument(
        "--x-axis",
        nargs=3,
        type=number,
        default=(1.0, 0.0, 0.0),
        metavar=("X", "Y", "Z"),
        help="direction in R that the tool's x axis keeps close to (default 1 0 0)",
    )
    parser.add_argument("-o", "--output", metavar="FILE", help="file to write (default: standard output)")


def run(arguments: argparse.Namespace) -> int:
    """Write the plan's trajectories in R."""
    from pathlib import Path

    from ronnaplan.documents.chain import read_chain
    from ronnaplan.documents.files import require_ending, write_result
    from ronnaplan.documents.plan import read_plan
    from ronnaplan.documents.robot_points import KRL_LIST, NOTICE, export_points
    from ronnaplan.errors import UsageError
    from ronnaplan.robot.trajectories import robot_trajectory, roll_doubts

    if not 0 <= arguments.approach <= LARGEST_APPROACH_MM:
        raise UsageError(f"--approach {arguments.approach:g} is no distance of 0 to {LARGEST_APPROACH_MM:g} mm")
    if not any(arguments.x_axis):
        raise UsageError("--x-axis 0 0 0 has no direction; give one in R")
    to = RobotFormat(arguments.to)
    if arguments.output:
        require_ending(arguments.output, to, ENDINGS.get(to, ("",)))
    chain, plan = read_chain(arguments.chain), read_plan(arguments.plan)
    plan.require_source(chain.ct_frame, chain.source.voxel_sha256)
    trajectories = [
        robot_trajectory(
            one.name, one.entry_mm, one.target_mm, chain.pose, frame=plan.frame, x_axis=arguments.x_axis
        )
        for one in plan.trajectories
    ]
    named = Path(arguments.output).stem if arguments.output else KRL_LIST
    write_result(arguments.output, export_points(trajectories, chain, to, arguments.approach, named))
    warn(*chain.notes, *roll_doubts(trajectories, arguments.x_axis))
    for one in trajectories:
        entry, target = one.expected_errors_mm
        print(
            f"{one.name}: expected error {entry:.3f} mm RMS at the entry, {target:.3f} at the target",
            file=sys.stderr,
        )
    print(NOTICE, file=sys.stderr)
    return 0
