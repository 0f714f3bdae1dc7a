"""``ronnaplan robot hand-eye``: the TCP on the tool that the tracker sees, from poses of robot and tracker together."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Sequence

from ronnaplan.cli.output import tell, warn
from ronnaplan.cli.robot_options import RECORDED, calibrated_tool, error_told, other_tool, with_output, with_tool

HELP = "Find M from TCP (and R from OTS) from simultaneous poses of tracker and robot."


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``robot hand-eye``."""
    parser.add_argument("tracker", metavar="TRACKER", help=f"the tracker's poses of M: {RECORDED}")
    parser.add_argument("robot", metavar="ROBOT", help="the robot's poses of its TCP, numbered alike")
    parser.add_argument("--pivot", metavar="FILE", help="pivot.json of the same tip, to be counted too")
    with_tool(parser)
    with_output(parser, "hand-eye.json")


def run(arguments: argparse.Namespace) -> int:
    """Find M from TCP and R from OTS."""
    from ronnaplan.documents.revision import write_document
    from ronnaplan.documents.tool import hand_eye_document, read_hand_eye, read_pivot
    from ronnaplan.errors import InputError
    from ronnaplan.robot.hand_eye import calibrate_hand_eye, with_tip
    from ronnaplan.robot.orientation import departure_of_eq_5_deg
    from ronnaplan.robot.recorded import require_numbered, robots_poses, simultaneous, trackers_poses
    from ronnaplan.tracking import read_recording

    pivot = read_pivot(arguments.pivot) if arguments.pivot else None
    tracker, robot = read_recording(arguments.tracker), read_recording(arguments.robot)
    seen, driven = trackers_poses(tracker, arguments.tool), robots_poses(robot)
    for recording in (tracker, robot):
        require_numbered(recording)
    frames, ots_from_m, robot_from_tcp = simultaneous(seen, driven)
    found = calibrate_hand_eye(ots_from_m, robot_from_tcp, frames=frames)
    if pivot is not None:
        found = with_tip(found, pivot.tip_mm, pivot.tip_covariance_mm2)
    tool = calibrated_tool(tracker, arguments.tool)
    moved = () if found.step is None else (found.step.told(frames),)
    notes = (*tracker.notes, *robot.notes, *_alone(seen, driven), *_far(frames, found.far), *moved, *found.doubts)
    if pivot is not None:
        notes += (*pivot.notes, *other_tool(pivot.tool, tool))
    warn(*notes)
    counted = len(frames) - found.repeated - found.rested
    document = hand_eye_document(found, tool, counted, pivot=pivot is not None, notes=notes)
    write_document(arguments.output, document, read_hand_eye)
    tell(
        f"M from TCP of {counted} poses, which are off by {found.rotation_rms_deg:.3f} degrees and "
        f"{found.translation_rms_mm:.3f} mm RMS",
        error_told("its error at the TCP", found.m_from_tcp.point_covariances([[0.0, 0.0, 0.0]])),
    )
    if pivot is not None:
        try:
            departure = departure_of_eq_5_deg(ots_from_m, robot_from_tcp, pivot.tip_mm, found.m_from_tcp.rotation)
            tell(f"Eq. 5, from three places of the tip, departs from it by {departure:.3f} degrees")
        except InputError as error:  # poses about one place calibrate, but give Eq. 5 no three points
            tell(f"Eq. 5 cannot be held against it: {error}")
    return 0


def _far(frames: Sequence[int], far: Sequence[int]) -> tuple[str, ...]:
    from ronnaplan.robot.hand_eye_start import which_are_far

    if not far:
        return ()
    which, advice = which_are_far(frames, far)
    return (f"{which}, and were counted as they are: {advice}",)


def _alone(seen: Iterable[int], driven: Iterable[int]) -> tuple[str, ...]:
    alone = len(set(seen) ^ set(driven))
    return (f"poses left out, without a usable partner of the same frame: {alone}",) if alone else ()
