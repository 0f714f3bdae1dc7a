"""``ronnaplan robot watch``: the chain held against the tracker's stream, moment by moment."""

from __future__ import annotations

import argparse
import json
from typing import TYPE_CHECKING

from ronnaplan.cli import GIVEN
from ronnaplan.cli.case_options import with_server, with_sigma_ots
from ronnaplan.cli.output import ended_gently, tell, warn
from ronnaplan.cli.robot_options import with_output, with_robot_sigmas, with_sigma_geometry, with_tool
from ronnaplan.cli.values import seconds, wait

if TYPE_CHECKING:
    from ronnaplan.documents.chain import ChainDocument
    from ronnaplan.robot.live import LiveChain, Moment

HELP = "Watch head and robot live over OpenIGTLink; no pose is called valid when either moved (exit 3)."


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``robot watch``."""
    parser.add_argument("--chain", required=True, metavar="FILE", help="chain.json by the tracker")
    parser.add_argument("--registration", required=True, metavar="FILE", help="the registration.json that it has")
    parser.add_argument(
        "--geometry", required=True, metavar="FILE", help="template.json of the tool's spheres in M"
    )
    with_tool(parser)
    parser.add_argument(
        "--robot-device", metavar="NAME", help="device of the robot's poses of its TCP (default: the robot rests)"
    )
    parser.add_argument(
        "--head-device",
        metavar="NAME",
        help="device of the head's markers, where several show them (default: the only one)",
    )
    with_server(parser)
    parser.add_argument("--seconds", type=seconds, default=3600.0, help="how long to watch (default %(default)s)")
    parser.add_argument(
        "--rejoin",
        type=wait,
        default=60.0,
        metavar="S",
        help="how long a server that went away is tried again; 0: not at all (default %(default)s)",
    )
    parser.add_argument(
        "--every", type=seconds, default=0.5, metavar="S", help="length of a moment (default %(default)s)"
    )
    with_sigma_ots(parser)
    with_sigma_geometry(parser)
    with_robot_sigmas(parser)
    with_output(parser, "a line of JSON a moment")


@ended_gently()
def run(arguments: argparse.Namespace) -> int:
    """Watch; tell every change of the verdict; 3 when the last one is not that nothing moved."""
    from ronnaplan.documents.chain import read_chain
    from ronnaplan.documents.files import GrowingFile
    from ronnaplan.errors import UsageError
    from ronnaplan.robot.live import LiveStatus
    from ronnaplan.tracking.openigtlink import rejoined_moments

    idle = [name for name in ("sigma_robot", "sigma_robot_deg") if name in vars(arguments).get(GIVEN, ())]
    if idle and arguments.robot_device is None:
        raise UsageError(f"--{idle[0].replace('_', '-')} is of the poses of --robot-device; name that, too")
    out = None if arguments.output is None else GrowingFile(arguments.output)
    chain = read_chain(arguments.chain)
    live = _live(arguments, chain)
    last = None
    try:
        for recording in rejoined_moments(
            arguments.host,
            arguments.port,
            every_s=arguments.every,
            seconds=arguments.seconds,
            resting=() if arguments.robot_device is None else (arguments.robot_device,),
            rejoin_s=arguments.rejoin,
        ):
            warn(*recording.notes)
            ended = recording.end is not None
            if not ended and not recording.points and not recording.tools and last is not None:
                continue  # the time is up, and what the last whole moment told still stands
            moment = live.judge(recording)
            if last is None or moment.status is not last.status:
                tell(_sentence(moment, chain))
            last = moment
            line = json.dumps(_row(moment))
            if out is None:
                print(line, flush=True)
            else:
                out.add(line)
    except KeyboardInterrupt:
        tell("ronnaplan: stopped by hand")
    if out is not None:
        out.end()
    return 0 if last is not None and last.status is LiveStatus.VALID else 3


def _live(arguments: argparse.Namespace, chain: ChainDocument) -> LiveChain:
    from ronnaplan.documents.poses import same_pose
    from ronnaplan.documents.registration import read_registration
    from ronnaplan.documents.template import read_template_document
    from ronnaplan.errors import InputError
    from ronnaplan.robot.chain import OTS, M
    from ronnaplan.robot.live import LiveChain

    if chain.links is None:
        raise InputError(
            f"{arguments.chain} is of the way by the cameras; the tracker can watch one of its own way"
        )
    registration = read_registration(arguments.registration)
    pose = chain.links.ots_from_ct.pose(OTS, chain.ct_frame)
    if registration.status != "unique" or not same_pose(registration.pose, pose):
        raise InputError(
            f"{arguments.registration} is not the registration that {arguments.chain} was made with; take that one, or "
            "make the chain anew"
        )
    return LiveChain(
        head=registration.readings,
        ots_from_ct=pose,
        capture=chain.links.capture,
        tool=read_template_document(arguments.geometry).placed(M, arguments.sigma_geometry),
        tool_device=arguments.tool,
        robot_device=arguments.robot_device,
        sigma_mm=arguments.sigma_ots,
        sigma_robot_mm=arguments.sigma_robot,
        sigma_robot_deg=arguments.sigma_robot_deg,
        head_device=arguments.head_device,
    )


def _sentence(moment: Moment, chain: ChainDocument) -> str:
    """Say what a moment tells, and how far what moved went."""
    from ronnaplan.geometry import rms_mm
    from ronnaplan.registration import DriftStatus

    told = [f"{moment.status}"]
    if moment.why:
        told.append(moment.why)
    if moment.head is not None and moment.head.status in (DriftStatus.PATIENT_MOVED, DriftStatus.MARKER_MOVED):
        told.append(f"head: {moment.head.shift_mm:.2f} mm, {moment.head.rotation_deg:.2f} degrees")
    if moment.robot is not None and moment.robot.moved:
        told.append(f"robot: {moment.robot.shift_mm:.2f} mm, {moment.robot.rotation_deg:.2f} degrees")
    if moment.robot_from_ct is not None:
        spread = moment.robot_from_ct.point_covariances([chain.middle])[0]
        told.append(f"expected error {rms_mm(spread):.3f} mm RMS at the markers' middle")
    return "; ".join(told)


def _row(moment: Moment) -> dict[str, object]:
    """Return a moment, judged now, as one line of JSON holds it."""
    from datetime import UTC, datetime

    from ronnaplan.documents.poses import pose_entry

    head, robot, pose = moment.head, moment.robot, moment.robot_from_ct
    return {
        "time": datetime.now(UTC).isoformat(timespec="milliseconds"),
        "status": moment.status.name.lower(),
        "told": str(moment.status),
        "why": moment.why,
        "robot_from_ct": None if pose is None else pose_entry(pose),
        "head": None if head is None else _moved(head.probability, head.shift_mm, head.rotation_deg),
        "robot": None if robot is None else _moved(robot.probability, robot.shift_mm, robot.rotation_deg),
    }


def _moved(probability: float, shift_mm: float, rotation_deg: float) -> dict[str, float | None]:
    numbers = {"probability": probability, "shift_mm": shift_mm, "rotation_deg": rotation_deg}
    return {name: value if value == value else None for name, value in numbers.items()}
