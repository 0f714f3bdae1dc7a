"""What several actions of ``ronnaplan robot`` share: options, the looks of the cameras, and what is told of errors."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from ronnaplan.cli.case_options import Declares
from ronnaplan.cli.values import number, sigma_mm
from ronnaplan.sigmas import (
    LARGEST_STATED_MM,
    LARGEST_TO_STATE_MM,
    SIGMA_GEOMETRY_MM,
    SIGMA_ROBOT_DEG,
    SIGMA_ROBOT_MM,
)

if TYPE_CHECKING:
    from ronnaplan.geometry import FloatArray
    from ronnaplan.robot.stereo.images import ImagePair
    from ronnaplan.tracking import Recording

UNNAMED = "tool"
"""The tool of a recording that names none, as rows of matrices or quaternions."""
RECORDED = "a recording of poses (rows of 4 x 4 matrices, CSV with quaternions, NDI CSV, PLUS sequence)"


def with_tool(parser: Declares) -> None:
    """Declare which tool of a recording is meant."""
    parser.add_argument("--tool", metavar="NAME", help="the tool, where the tracker's recording has several")


def with_robot_sigmas(parser: Declares) -> None:
    """Declare the robot's own error."""
    parser.add_argument(
        "--sigma-robot",
        type=sigma_mm,
        default=SIGMA_ROBOT_MM,
        metavar="MM",
        help="error of the robot's position per axis (default %(default)s)",
    )
    parser.add_argument(
        "--sigma-robot-deg",
        type=sigma_deg,
        default=SIGMA_ROBOT_DEG,
        metavar="DEG",
        help="error of the robot's rotation per axis (default %(default)s)",
    )


def with_sigma_geometry(parser: Declares) -> None:
    """Declare the error of a tracked tool's spheres."""
    parser.add_argument(
        "--sigma-geometry",
        type=sigma_mm,
        default=SIGMA_GEOMETRY_MM,
        metavar="MM",
        help="error of the spheres' places in M per axis (default %(default)s)",
    )


def with_largest_error(parser: Declares, what: str) -> None:
    """Declare above which stated error ``what`` is refused."""
    parser.add_argument(
        "--largest-error",
        type=stated_mm,
        default=LARGEST_STATED_MM,
        metavar="MM",
        help=f"refuse {what} whose stated error in the rig (RMS) is larger (default: %(default)s)",
    )


def with_output(parser: Declares, what: str) -> None:
    """Declare where ``what`` is written."""
    parser.add_argument("-o", "--output", metavar="FILE", help=f"{what} (default: standard output)")


def sigma_deg(text: str) -> float:
    """Return a standard deviation in degrees."""
    value = number(text)
    if not 0 < value <= 10:
        raise argparse.ArgumentTypeError(f"{text} is no standard deviation in degrees; expected above 0, up to 10")
    return value


def stated_mm(text: str) -> float:
    """Return the largest error in mm that may be stated."""
    value = number(text)
    if not 0 < value <= LARGEST_TO_STATE_MM:
        raise argparse.ArgumentTypeError(
            f"{text} is no largest error in mm; expected above 0, up to {LARGEST_TO_STATE_MM:g}"
        )
    return value


def size_mm(text: str) -> float:
    """Return a length in mm above zero."""
    value = number(text)
    if not 0 < value <= 1000:
        raise argparse.ArgumentTypeError(f"{text} is no size in mm; expected above 0, up to 1000")
    return value


def read_looks(arguments: argparse.Namespace) -> tuple[dict[int, ImagePair], FloatArray, tuple[str, ...]]:
    """Return the looks, the robot's pose (4, 4) at each, and what is to be told of the recording."""
    import numpy as np

    from ronnaplan.errors import InputError
    from ronnaplan.robot.recorded import require_numbered, robots_poses
    from ronnaplan.robot.stereo.images import read_pairs
    from ronnaplan.tracking import read_recording

    looks, robot = read_pairs(arguments.looks), read_recording(arguments.robot)
    driven = robots_poses(robot)
    require_numbered(robot)
    lacking = next((frame for frame in looks if frame not in driven), None)
    if lacking is not None:
        raise InputError(f"{arguments.robot} has no pose of frame {lacking}, which {arguments.looks} shows")
    return looks, np.array([driven[frame] for frame in looks]), robot.notes


def calibrated_tool(recording: Recording, asked: str | None) -> str:
    """Return the name of the tool in the tracker's ``recording``: the one that was asked for, else its only one."""
    return asked or recording.tool_names[0] or UNNAMED


def other_tool(calibrated: str, seen: str | None) -> tuple[str, ...]:
    """Say that the tool that was seen goes by another name than the one that was calibrated."""
    if not seen or seen == calibrated:
        return ()
    return (f"the calibration is of the tool '{calibrated}', the tracker's recording of '{seen}'",)


def error_told(what: str, covariances: FloatArray) -> str:
    """Say the error of the first of ``covariances`` (N, 3, 3)."""
    from ronnaplan.geometry import rms_mm

    return f"{what}: {rms_mm(covariances[0]):.4f} mm RMS"
