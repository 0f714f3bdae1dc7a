"""``ronnaplan robot stereo-calibrate``: the cameras on the robot."""

from __future__ import annotations

import argparse

from ronnaplan.cli.output import tell, warn
from ronnaplan.cli.robot_options import error_told, read_looks, size_mm, with_largest_error, with_output
from ronnaplan.cli.values import number
from ronnaplan.sigmas import SIGMA_SQUARE

HELP = "Calibrate the stereo cameras and their place on the robot from images."


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``robot stereo-calibrate``."""
    folders = "folders 'left' and 'right' of images named by their number (007.png)"
    parser.add_argument("boards", metavar="BOARDS", help=f"images of a chessboard: {folders}")
    parser.add_argument(
        "looks", metavar="LOOKS", help="images of one resting sphere from many robot poses, likewise"
    )
    parser.add_argument("robot", metavar="ROBOT", help="the robot's poses of its TCP, whose frames are the looks")
    parser.add_argument("--corners", type=corners, required=True, metavar="CxR", help="inner corners of the board")
    parser.add_argument("--square", type=size_mm, required=True, metavar="MM", help="side of its squares")
    parser.add_argument(
        "--sigma-square",
        type=percent,
        default=100 * SIGMA_SQUARE,
        metavar="PERCENT",
        help="standard error of that side (default %(default)s; printed boards: 0.1 and more)",
    )
    parser.add_argument("--diameter", type=size_mm, required=True, metavar="MM", help="of the resting sphere")
    with_largest_error(parser, "a look at it")
    with_output(parser, "rig.json")


def run(arguments: argparse.Namespace) -> int:
    """Calibrate the cameras, then their place on the robot."""
    import numpy as np

    from ronnaplan.documents.revision import write_document
    from ronnaplan.documents.rig import read_rig, rig_document
    from ronnaplan.pose import Pose
    from ronnaplan.robot.chain import TCP
    from ronnaplan.robot.stereo.calibration import calibrate_on_board, calibrate_tcp, require_size
    from ronnaplan.robot.stereo.camera import RIG
    from ronnaplan.robot.stereo.images import read_pairs
    from ronnaplan.robot.stereo.markers import in_rig

    boards = read_pairs(arguments.boards)
    looks, poses, notes = read_looks(arguments)
    cameras = calibrate_on_board(
        [left for left, _ in boards.values()],
        [right for _, right in boards.values()],
        corners=arguments.corners,
        square_mm=arguments.square,
        sigma_square=arguments.sigma_square / 100,
    )
    unplaced = cameras.rig(Pose.exact(np.eye(4), TCP, RIG))
    spheres = in_rig(looks, unplaced, diameter_mm=arguments.diameter, largest_mm=arguments.largest_error)
    require_size(spheres, unplaced, arguments.diameter)
    tcp = calibrate_tcp(poses, [sphere.position_mm for sphere in spheres])
    notes = (*notes, *cameras.doubts(arguments.largest_error))
    warn(*notes)
    write_document(arguments.output, rig_document(cameras, tcp, len(looks), arguments.diameter, notes), read_rig)
    tell(
        f"cameras of {cameras.boards_used} boards, off by {cameras.rms_px:.3f} pixels RMS",
        f"the resting sphere's {len(looks)} places scatter by {tcp.sd_mm:.4f} mm per axis",
        error_told(
            "error of a sphere there by tcp_from_rig", tcp.tcp_from_rig.point_covariances([spheres[0].position_mm])
        ),
    )
    return 0


def percent(text: str) -> float:
    """Return a standard error in percent."""
    value = number(text)
    if not 0 <= value <= 10:
        raise argparse.ArgumentTypeError(f"{text} is no standard error in percent; expected 0 to 10")
    return value


def corners(text: str) -> tuple[int, int]:
    """Return the inner corners of a chessboard (columns, rows) as in ``9x7``."""
    from ronnaplan.robot.stereo.board import FEWEST_CORNERS, MOST_CORNERS
    from ronnaplan.text import whole_number

    counts = [whole_number(part) for part in text.lower().split("x")]
    if len(counts) != 2 or any(count is None or not FEWEST_CORNERS <= count <= MOST_CORNERS for count in counts):
        raise argparse.ArgumentTypeError(
            f"'{text}' are no corners of a board; expected columns and rows as in 9x7"
        )
    return counts[0] or 0, counts[1] or 0
