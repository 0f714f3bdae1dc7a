"""``ronnaplan robot relocate``: the markers found again by the cameras, in the robot's coordinates."""

from __future__ import annotations

import argparse

from ronnaplan.cli.output import tell, warn
from ronnaplan.cli.robot_options import (
    read_looks,
    sigma_deg,
    size_mm,
    with_largest_error,
    with_output,
    with_robot_sigmas,
)
from ronnaplan.sigmas import SIGMA_LAMP_DEG

HELP = "Find the markers again in the cameras' images, in the robot's coordinates."


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``robot relocate``."""
    parser.add_argument(
        "looks", metavar="LOOKS", help="images of the markers, one a look, as for stereo-calibrate"
    )
    parser.add_argument("robot", metavar="ROBOT", help="the robot's poses of its TCP, whose frames are the looks")
    parser.add_argument("--rig", required=True, metavar="FILE", help="rig.json of stereo-calibrate")
    parser.add_argument("--diameter", type=size_mm, required=True, metavar="MM", help="of the markers")
    with_largest_error(parser, "a marker")
    parser.add_argument(
        "--lamp-offset",
        type=sigma_deg,
        default=SIGMA_LAMP_DEG,
        metavar="DEG",
        help="how far the middle of a lamp about a lens is from the lens, as seen from the marker, one standard "
        "deviation (default: %(default)s); decides where a marker's rim is as dark as what is behind it",
    )
    with_robot_sigmas(parser)
    with_output(parser, "spheres.json")


def run(arguments: argparse.Namespace) -> int:
    """Find each look's marker in R."""
    from ronnaplan.documents.revision import write_document
    from ronnaplan.documents.rig import read_rig, read_spheres, spheres_document
    from ronnaplan.geometry import rms_mm
    from ronnaplan.robot.recorded import robot_pose
    from ronnaplan.robot.stereo.again import contradiction
    from ronnaplan.robot.stereo.markers import relocate

    rig = read_rig(arguments.rig)
    looks, matrices, notes = read_looks(arguments)
    poses = [robot_pose(matrix, arguments.sigma_robot, arguments.sigma_robot_deg) for matrix in matrices]
    found = relocate(
        looks,
        poses,
        rig.rig,
        diameter_mm=arguments.diameter,
        scatter_mm=rig.scatter,
        largest_mm=arguments.largest_error,
        lamp_sd_deg=arguments.lamp_offset,
    )
    if contradicted := contradiction(found):
        notes = (*notes, contradicted)
    warn(*notes)
    write_document(arguments.output, spheres_document(found, arguments.diameter, notes), read_spheres)
    points = found.points
    for label, (x, y, z), covariance in zip(
        points.labels, points.positions_mm, points.covariances_mm2, strict=True
    ):
        tell(f"{label:<6} {x:10.3f} {y:10.3f} {z:10.3f}  {rms_mm(covariance):.4f} mm RMS")
    return 0
