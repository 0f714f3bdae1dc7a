"""``ronnaplan robot place``: where the robot shall stand, or whether it stands well where it was parked."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING

from ronnaplan.cli.output import tell, warn
from ronnaplan.cli.robot_arm import configure_arm, example, named_arm
from ronnaplan.cli.values import number

if TYPE_CHECKING:
    from ronnaplan.case.folder import Case
    from ronnaplan.documents.chain import ChainDocument
    from ronnaplan.documents.fiducials import Source
    from ronnaplan.geometry import Points
    from ronnaplan.planning.head import Head
    from ronnaplan.robot.arm.arm import SerialArm
    from ronnaplan.robot.placement.job import Job
    from ronnaplan.robot.placement.placement import Placement
    from ronnaplan.robot.placement.room import Room

HELP = (
    "Find where the robot serves every trajectory and marker; exit 3, with reasons, where there is no such place."
)


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``robot place``."""
    parser.add_argument(
        "--example", action="store_true", help="print an annotated room.toml, for --arm if that is a file, and end"
    )
    parser.add_argument("--plan", metavar="FILE", help="plan.json: the trajectories")
    parser.add_argument("--ct", metavar="PATH", help="the scan that the plan is tied to")
    parser.add_argument("--series", metavar="UID", help="the series to use, where PATH holds several")
    parser.add_argument(
        "--fiducials", metavar="FILE", help="fiducials.json: markers to view (default: those registered)"
    )
    parser.add_argument(
        "--registration", metavar="FILE", help="registration.json: the tracker stands where it was then"
    )
    configure_arm(parser)
    parser.add_argument("--scene", metavar="FILE", help="room.toml: what stands in the room")
    measured = parser.add_mutually_exclusive_group()
    measured.add_argument(
        "--chain",
        metavar="FILE",
        help="chain.json taken after parking: check the base where it was measured, instead of searching",
    )
    measured.add_argument(
        "--parked",
        nargs=4,
        type=number,
        metavar=("X", "Y", "Z", "TURN"),
        help="check the base as it was measured in the room (mm, degrees), instead of searching",
    )
    parser.add_argument("-o", "--output", metavar="FILE", help="placement.json (default: standard output)")


def run(arguments: argparse.Namespace) -> int:
    """Search, or check; a placement that is blocked, or from where no way is free, is written and refused."""
    from ronnaplan.documents.room import read_room
    from ronnaplan.errors import RefusedError, UsageError

    if arguments.example:
        sys.stdout.write(example(arguments))
        return 0
    missing = [name for name in ("plan", "ct", "scene") if getattr(arguments, name) is None]
    if missing:
        raise UsageError(f"robot place needs --{missing[0]} (see 'ronnaplan robot place --help')")
    _check_parked(arguments.parked)
    from ronnaplan.documents.placement import placement_text, read_placement
    from ronnaplan.documents.placement_made import placement_document
    from ronnaplan.documents.revision import write_document

    room = read_room(arguments.scene)
    arm, of_arm = named_arm(arguments, room)
    warn(*of_arm)  # first, as they may tell why the arm is refused
    job, case, of_case = _job(arguments, arm, room)
    chain = _chain(arguments, case)
    of_chain = (*chain.notes, *job.doubts_of(chain.pose)) if chain is not None else ()
    of_job = tuple(dict.fromkeys((*of_case, *of_chain)))  # both tell of the registration's
    warn(*of_job)
    notes = (*of_arm, *of_job)
    found = _found(arguments, job, chain)
    parked = arguments.parked is not None or chain is not None
    document = placement_document(
        found, room, arm, _source(case), case.plan, markers=_markers(case), parked=parked, notes=notes
    )
    tell(placement_text(document))
    write_document(arguments.output, document, read_placement)
    if document.status == "blocked":
        raise RefusedError("no place serves every task; " + document.blocked[0])
    best = document.robot_from_ct[0]
    if best.no_way is not None:
        raise RefusedError(
            f"the robot has {best.no_way}; state another reference_deg in the room, in which nothing comes nearer, and "
            "from where the arm reaches all without passing head, table or itself"
        )
    return 0


def _check_parked(parked: Sequence[float] | None) -> None:
    """Raise `UsageError` for a base that no room could state."""
    from ronnaplan.bounds import FARTHEST_POINT_MM
    from ronnaplan.documents.room_fields import LARGEST_TURN_DEG
    from ronnaplan.errors import UsageError

    if parked is None:
        return
    *place, turn = parked
    if max(abs(value) for value in place) > FARTHEST_POINT_MM or abs(turn) > LARGEST_TURN_DEG:
        told = " ".join(f"{value:g}" for value in parked)
        raise UsageError(
            f"--parked is {told}; expected up to {FARTHEST_POINT_MM:g} mm and {LARGEST_TURN_DEG:g} degrees either way"
        )


def _chain(arguments: argparse.Namespace, case: Case) -> ChainDocument | None:
    """Return the chain that was taken after parking, of the same scan; None where there is none."""
    from ronnaplan.documents.chain import read_chain

    if arguments.chain is None:
        return None
    chain = read_chain(arguments.chain)
    assert case.plan is not None
    case.plan.identity.require(chain.identity)
    return chain


def _found(arguments: argparse.Namespace, job: Job, chain: ChainDocument | None) -> Placement:
    """Search, or look at the base as it was measured."""
    import numpy as np

    from ronnaplan.robot.placement.placement import check_parked, find_places
    from ronnaplan.robot.placement.room import base_pose

    if chain is not None:
        return check_parked(job, job.base_of(chain.pose))
    if arguments.parked is None:
        return find_places(job)
    return check_parked(job, base_pose(np.array(arguments.parked)))


def _job(arguments: argparse.Namespace, arm: SerialArm, room: Room) -> tuple[Job, Case, tuple[str, ...]]:
    """Read the case, and return what the robot has to do in it, and what makes that doubtful."""
    from pathlib import Path

    from ronnaplan.case.folder import CaseFiles, read_case
    from ronnaplan.ct import read_ct
    from ronnaplan.documents.agreement import disagreement
    from ronnaplan.errors import InputError
    from ronnaplan.planning.beside import beside
    from ronnaplan.planning.head import Head
    from ronnaplan.robot.placement.job import Job

    names = (arguments.plan, arguments.fiducials, arguments.registration)
    files = CaseFiles(*(Path(name) if name else None for name in names))
    case = read_case(files, lambda: read_ct(arguments.ct, arguments.series, progress=True))
    assert case.plan is not None
    assert case.volume is not None
    head = Head.of(case.volume)
    of_plan = _doubts_of_plan(case, head)
    ots_from_ct = None
    doubts: tuple[str, ...] = ()
    if case.registration is not None:
        if room.tracker is None:
            raise InputError(f"{arguments.scene} names no [tracker], which the registration places; add one")
        ots_from_ct = case.registration.pose.matrix
        outdated = disagreement(case.fiducials, case.registration) if case.fiducials is not None else None
        doubts = (*([outdated] if outdated else []), *case.registration.doubts)
    job = Job.of_plan(
        arm,
        room,
        case.plan,
        _markers(case),
        head.boundary_mm,
        head.center_mm,
        ots_from_ct,
        radii_mm=case.fiducials.radii_mm if case.fiducials is not None else None,
        beside_ct_mm=beside(head),
    )
    return job, case, (*of_plan, *doubts, *_untold_markers(case), *job.doubts)


def _doubts_of_plan(case: Case, head: Head) -> list[str]:
    """Say what makes trajectories doubtful in the scan; raises `InputError` for one whose ends are not in the head.

    A plan may come from elsewhere than `plan add`, and a place beside the head is reached as well.
    """
    from ronnaplan.planning.measures import check_ends, end_doubts

    assert case.plan is not None
    plan = case.plan
    return [
        doubt
        for one in plan.trajectories
        for doubt in end_doubts(one, check_ends(one, head), head, plan.landmarks)
    ]


def _untold_markers(case: Case) -> list[str]:
    """Say that no markers are viewed where nobody tells of them, or are of a usual size where the registration does."""
    from ronnaplan.robot.placement.job import MARKER_RADIUS_MM

    if case.fiducials is not None:
        return []
    if case.registration is None:
        return [
            "no markers are named, so that no view of any is looked for; give --fiducials or --registration where the "
            "cameras shall find them again"
        ]
    return [
        f"the registration does not tell how large the markers are, so that they count as balls of "
        f"{2 * MARKER_RADIUS_MM:g} mm; give --fiducials where they are larger"
    ]


def _source(case: Case) -> Source:
    """Return the scan that a case is of."""
    from ronnaplan.documents.fiducials import Source

    assert case.plan is not None
    assert case.volume is not None
    return Source.model_validate({**case.volume.source.uids, "voxel_sha256": case.volume.voxel_sha256})


def _markers(case: Case) -> Points | None:
    """Return the markers to view: those named, or else those registered."""
    from ronnaplan.geometry import Points

    if case.fiducials is not None:
        return case.fiducials.points
    if case.registration is None:
        return None
    pairs = case.registration.pairs
    labels = tuple(pair.ct for pair in pairs)
    return Points.exact([pair.center for pair in pairs], labels, case.registration.ct_frame)
