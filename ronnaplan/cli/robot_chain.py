"""``ronnaplan robot chain``: the scan in the robot's coordinates, by the tracker or by the cameras."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from ronnaplan.cli import GIVEN
from ronnaplan.cli.case_options import with_sigma_ct, with_sigma_ots
from ronnaplan.cli.output import tell, warn
from ronnaplan.cli.robot_options import other_tool, with_robot_sigmas, with_sigma_geometry, with_tool
from ronnaplan.cli.values import whole

if TYPE_CHECKING:
    from ronnaplan.documents.chain import ChainDocument
    from ronnaplan.tracking import Recording

HELP = "Join the links from scan to robot, by the tracker or by re-localized markers, with covariance."
BY_TRACKER = ("registration", "hand_eye", "tracker", "geometry", "robot")
BY_STEREO = ("fiducials", "spheres")
OF_TRACKER = ("frame", "tool", "sigma_geometry", "sigma_ots", "sigma_robot", "sigma_robot_deg")
OF_STEREO = ("expected", "sigma_ct")


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``robot chain``."""
    tracker = parser.add_argument_group("by the tracker")
    tracker.add_argument("--registration", metavar="FILE", help="registration.json of the head")
    tracker.add_argument("--hand-eye", metavar="FILE", help="hand-eye.json of the tool")
    tracker.add_argument("--tracker", metavar="READINGS", help="the tool seen at rest: its poses, or its spheres")
    tracker.add_argument("--geometry", metavar="FILE", help="template.json with the centers of its spheres in M")
    tracker.add_argument("--robot", metavar="READINGS", help="the robot's pose of its TCP meanwhile")
    tracker.add_argument("--frame", type=whole(0), metavar="N", help="use one frame of both recordings")
    with_sigma_geometry(tracker)
    with_sigma_ots(tracker)
    with_tool(tracker)
    with_robot_sigmas(tracker)
    stereo = parser.add_argument_group("by the cameras")
    stereo.add_argument("--fiducials", metavar="FILE", help="fiducials.json of the scan")
    stereo.add_argument("--spheres", metavar="FILE", help="spheres.json of relocate")
    stereo.add_argument("--expected", type=whole(3), metavar="N", help="the number of markers in both")
    with_sigma_ct(stereo)
    parser.add_argument("-o", "--output", metavar="FILE", help="chain.json (default: standard output)")


def run(arguments: argparse.Namespace) -> int:
    """Join the links, or register to the re-localized spheres."""
    from ronnaplan.documents.chain import read_chain
    from ronnaplan.documents.revision import write_document
    from ronnaplan.errors import UsageError

    given: set[str] = vars(arguments).get(GIVEN, set())
    named = given & {*BY_TRACKER, *BY_STEREO}
    if named not in (set(BY_TRACKER), set(BY_STEREO)):
        ways = (" ".join(map(_option, way)) for way in (BY_TRACKER, BY_STEREO))
        raise UsageError(f"robot chain goes one of two ways; give all of {' or all of '.join(ways)}")
    tracked = named == set(BY_TRACKER)
    idle = [_option(name) for name in (OF_STEREO if tracked else OF_TRACKER) if name in given]
    if idle:
        other = "cameras" if tracked else "tracker"
        raise UsageError(
            f"{idle[0]} belongs to the way by the {other}, and would change nothing here; leave it out"
        )
    document = _by_tracker(arguments) if tracked else _by_stereo(arguments)
    warn(*document.notes)
    write_document(arguments.output, document, read_chain)
    for share in document.shares:
        tell(f"{share.link:<24} {share.rms:.3f} mm RMS at the markers' middle")
    return 0


def _option(name: str) -> str:
    return f"--{name.replace('_', '-')}"


def _by_tracker(arguments: argparse.Namespace) -> ChainDocument:
    import numpy as np

    from ronnaplan.documents.chain import tracked_chain
    from ronnaplan.documents.registration import read_registration
    from ronnaplan.documents.template import read_template_document
    from ronnaplan.documents.tool import read_hand_eye
    from ronnaplan.errors import InputError
    from ronnaplan.robot.chain import Capture, M
    from ronnaplan.robot.elsewhere import elsewhere
    from ronnaplan.robot.hand_eye import SAME_POSES
    from ronnaplan.robot.recorded import MovedError, resting_matrix, robot_pose, robots_poses, seen_tool, uncounted
    from ronnaplan.tracking import read_recording

    registration, hand_eye = read_registration(arguments.registration), read_hand_eye(arguments.hand_eye)
    registration.require_tracker()
    geometry = read_template_document(arguments.geometry).placed(M, arguments.sigma_geometry)
    tracker = _only(read_recording(arguments.tracker), arguments.frame)
    robot = _only(read_recording(arguments.robot), arguments.frame)
    tool = arguments.tool or (hand_eye.tool if hand_eye.tool in tracker.tool_names else None)
    try:
        driven = resting_matrix(robots_poses(robot), "the robot")
        seen = seen_tool(tracker, geometry, tool=tool, sigma_mm=arguments.sigma_ots)
    except MovedError as error:
        raise MovedError(f"{error}, or name one frame (--frame)") from error
    if np.abs(seen.matrix - driven).max() < SAME_POSES:
        raise InputError(
            f"{arguments.tracker} and {arguments.robot} tell the same pose; expected the tool's in the tracker and the "
            "TCP's in R"
        )
    capture = Capture(
        seen, hand_eye.tcp_in_m, robot_pose(driven, arguments.sigma_robot, arguments.sigma_robot_deg)
    )
    notes = (*registration.doubts, *registration.notes, *hand_eye.notes, *tracker.notes, *robot.notes)
    notes += (*uncounted(tracker, tool), *uncounted(robot))
    notes += other_tool(hand_eye.tool, tool or next(iter(tracker.tool_names), None))
    notes += elsewhere(capture, hand_eye.tracker_in_r)
    middle = np.array([pair.center for pair in registration.pairs]).mean(axis=0)
    return tracked_chain(registration.pose, capture, registration.source, middle, notes)


def _by_stereo(arguments: argparse.Namespace) -> ChainDocument:
    from ronnaplan.documents.chain import stereo_chain
    from ronnaplan.documents.fiducials import read_fiducials
    from ronnaplan.documents.rig import read_spheres
    from ronnaplan.robot.stereo.markers import register_robot_markers

    fiducials, spheres = read_fiducials(arguments.fiducials), read_spheres(arguments.spheres)
    found = register_robot_markers(
        fiducials.points, spheres.markers, expected=arguments.expected, sigma_ct_mm=arguments.sigma_ct
    )
    flags = (str(flag) for flag in found.registration.flags)
    notes = (*fiducials.doubts, *flags, *found.notes, *spheres.notes)
    return stereo_chain(found, fiducials.source, found.registration.moving_mm.mean(axis=0), notes)


def _only(recording: Recording, frame: int | None) -> Recording:
    """Return the recording, or one frame of it; raises `InputError` where it has no such frame."""
    from dataclasses import replace

    from ronnaplan.errors import InputError

    if frame is None:
        return recording
    points = tuple(one for one in recording.points if one.frame == frame)
    tools = tuple(one for one in recording.tools if one.frame == frame)
    if not points and not tools:
        raise InputError(f"{recording.source} has no reading of frame {frame}; name one that both recordings have")
    return replace(recording, points=points, tools=tools)
