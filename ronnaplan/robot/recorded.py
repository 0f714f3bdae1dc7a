"""Poses out of recordings: which belong together, and where something that rested was, by poses or single spheres."""

from __future__ import annotations

from collections import Counter
from numbers import Real

import numpy as np

from ronnaplan.errors import InputError, RefusedError, check_type
from ronnaplan.geometry import FloatArray, Points, require_sigma
from ronnaplan.pose import Pose, as_pose, require_millimetres_away
from ronnaplan.registration.marker_registration import MarkerRegistration, register_markers
from ronnaplan.rigid import pose_covariance, require_spread
from ronnaplan.robot.chain import OTS, TCP, M, R
from ronnaplan.robot.pivot import LONGEST_TOOL_MM
from ronnaplan.sigmas import SIGMA_OTS_MM, SIGMA_ROBOT_DEG, SIGMA_ROBOT_MM
from ronnaplan.tracking import Recording, find_markers
from ronnaplan.tracking.recording import require_one_system, system_of
from ronnaplan.transforms import about, transform_points

STILL_MM, STILL_DEG = 0.5, 0.5
"""Poses of something that rests scatter less about their mean than this: a tracker's noise, no movement."""


class MovedError(RefusedError):
    """What was to rest moved while it was recorded."""


def tool_poses(recording: Recording, tool: str | None = None) -> dict[int, FloatArray]:
    """Return the usable poses (4, 4) of ``tool`` by the number of their frame, in the order of these.

    ``tool`` may be left out where there is one only. Raises `InputError` where it is not there, has two poses in a
    frame, or is so near to the origin in all of them that they are in metres.
    """
    check_type(recording, Recording, "the recording", "read_recording returns one")
    names = recording.tool_names
    if tool is None and len(names) != 1:
        held = f"the tools {', '.join(names)}; name one" if names else _lacking(recording)
        raise InputError(f"{recording.source} holds {held}")
    name = names[0] if tool is None else tool
    if name not in names:
        raise InputError(f"{recording.source} has no tool '{name}'; it has {', '.join(names) or 'none'}")
    told = name or "the tool"
    found: dict[int, FloatArray] = {}
    for reading in recording.tools:
        if reading.tool != name or not reading.usable or reading.matrix is None:
            continue
        if reading.frame in found:
            raise InputError(
                f"{recording.source} has two poses of {told} in frame {reading.frame}; expected one, so give each "
                "moment a number of its own (a tracker that was started again counts anew), and each pose once"
            )
        found[reading.frame] = reading.matrix
    if not found:
        said = Counter(reading.status for reading in recording.tools if reading.tool == name).most_common(1)[0][0]
        raise InputError(
            f"{recording.source} has no usable pose of {told}, most readings say '{said}'; record it again, or correct "
            "its numbers (a decimal comma needs ';' between the columns)"
        )
    require_millimetres_away(np.array(list(found.values())), f"{recording.source} has {told}")
    return dict(sorted(found.items()))


def uncounted(recording: Recording, tool: str | None = None) -> tuple[str, ...]:
    """Say how many readings of ``tool``, or of all, do not count, and what most of them say."""
    asked = [reading for reading in recording.tools if tool in (None, reading.tool)]
    said = Counter(reading.status for reading in asked if not reading.usable)
    if not said:
        return ()
    most = said.most_common(1)[0][0]
    return (f"{recording.source}: {said.total()} of {len(asked)} poses do not count, most say '{most}'",)


def _lacking(recording: Recording) -> str:
    """Say what a recording without poses holds, and what was expected."""
    if not recording.points:
        return "no poses; expected those of a tool"
    return (
        f"{len(recording.points)} points and no poses; expected rows of 4 x 4 matrices, or x, y, z with a quaternion "
        "(q0, qx, qy, qz): turn angles, as a KUKA's A, B, C or a UR's rx, ry, rz, into one of these"
    )


def require_robots(recording: Recording) -> None:
    """Raise `InputError` where a recording that shall be the robot's is evidently a tracker's."""
    told = [name for name in recording.tool_names if _system(name) == "tracker"]
    if told:
        raise InputError(
            f"{recording.source} holds poses of {told[0]}, as a tracker tells them; expected the robot's poses of its "
            "TCP: give the recordings of both the other way round, or the robot's own"
        )
    if recording.points and recording.tools:
        raise InputError(
            f"{recording.source} holds {len(recording.points)} readings of single spheres, as a tracker tells them; "
            "expected the robot's poses of its TCP: give the recordings of both the other way round, or leave the "
            "spheres out"
        )


def require_trackers(recording: Recording) -> None:
    """Raise `InputError` where a recording that shall be a tracker's is evidently the robot's."""
    told = [name for name in recording.tool_names if _system(name) == "robot"]
    if told or recording.frame == R:
        what = f"poses of {told[0]}" if told else f"poses in the frame {R}"
        raise InputError(
            f"{recording.source} holds {what}, as the robot tells them; expected the tracker's poses of its tool: give "
            "the recordings of both the other way round, or the tracker's own"
        )


def robots_poses(recording: Recording) -> dict[int, FloatArray]:
    """Return the robot's poses (4, 4) as `tool_poses` does; raises `InputError` for a tracker's recording, too."""
    require_robots(recording)
    return tool_poses(recording)


def trackers_poses(recording: Recording, tool: str | None = None) -> dict[int, FloatArray]:
    """Return the tracker's poses (4, 4) of ``tool`` as `tool_poses` does; raises `InputError` for the robot's, too."""
    require_trackers(recording)
    return tool_poses(recording, tool)


def _system(tool: str) -> str:
    """Return whose coordinates a tool's poses are in by its name, ``XToY`` as PLUS has it; empty where it says none."""
    system = system_of(tool).lower()
    if "tracker" in system or system == "ots":
        return "tracker"
    return "robot" if "robot" in system or system in ("base", "r") else ""


def require_numbered(recording: Recording) -> None:
    """Raise `InputError` where the source numbers no frames: their order does not say what belongs together."""
    if not recording.numbered:
        raise InputError(
            f"{recording.source} does not number its poses; expected the number of its moment with each, in a column "
            "'frame', for nothing is paired by its order"
        )


def simultaneous(
    first: dict[int, FloatArray], second: dict[int, FloatArray]
) -> tuple[tuple[int, ...], FloatArray, FloatArray]:
    """Return the numbers (N) of the frames that both have, and the poses (N, 4, 4) of either.

    Raises `InputError` where they share none.
    """
    shared = tuple(number for number in first if number in second)
    if not shared:
        raise InputError(
            "the two recordings share no frame number; number poses of one moment alike, in a column 'frame'"
        )
    return shared, np.array([first[n] for n in shared]), np.array([second[n] for n in shared])


def resting_matrix(poses: dict[int, FloatArray], what: str) -> FloatArray:
    """Return the mean (4, 4) of poses of ``what`` that did not move; raises `MovedError` where it did."""
    from scipy.spatial.transform import Rotation

    matrices = np.array(list(poses.values()))
    mean = np.eye(4)
    turns = Rotation.from_matrix(matrices[:, :3, :3])
    middle = turns.mean()
    mean[:3, :3], mean[:3, 3] = middle.as_matrix(), np.median(matrices[:, :3, 3], axis=0)
    off_mm = float(np.sqrt(((matrices[:, :3, 3] - mean[:3, 3]) ** 2).sum(axis=1).mean()))
    off_deg = float(np.degrees(np.sqrt(((middle.inv() * turns).magnitude() ** 2).mean())))
    if off_mm > STILL_MM or off_deg > STILL_DEG:
        raise MovedError(
            f"{what} moved while it was recorded: its poses scatter by {off_mm:.2f} mm and {off_deg:.2f} degrees RMS, "
            f"expected at most {STILL_MM:g} mm and {STILL_DEG:g} degrees; let it rest"
        )
    return mean


def locate_tool(geometry: Points, readings: Points, *, expected: int | None = None) -> MarkerRegistration:
    """Return where a tool is: its spheres' ``geometry`` (in its own frame) among the tracker's ``readings``.

    The tool is the x-shaped frame M or an NDI-style rigid body. Readings may hold other markers and come in any order.
    The pose, tracker from tool, is ``registration.pose``. Raises `RefusedError` when the spheres are not recognized
    beyond doubt, for example by a symmetric geometry.
    """
    found = register_markers(geometry, readings, expected=expected, sigma_ct_mm=0.0)
    if found.registration is None:
        raise RefusedError(
            f"the tool {geometry.frame} is not recognized among the readings: {found.pairing.reason}"
        )
    return found


def seen_tool(
    recording: Recording, geometry: Points, *, tool: str | None = None, sigma_mm: float = SIGMA_OTS_MM
) -> Pose:
    """Return OTS from M of a tool that rested, with the error that the tracker's reading of its spheres gives it.

    ``geometry`` are the spheres in M. A recording of poses gives their mean; one of single spheres is searched for
    them. ``sigma_mm`` is the tracker's error per axis of one sphere, which averaging does not remove. Raises
    `FrameMismatchError` where the names of the tools say that their poses are in the coordinates of several systems,
    `InputError` where they are the robot's, and where neither spheres nor readings err.
    """
    check_type(recording, Recording, "the recording", "read_recording returns one")
    check_type(
        geometry, Points, "the tool's spheres", "make them with Points.exact(positions_mm, labels, Frame('M'))"
    )
    M.require(geometry.frame)
    require_trackers(recording)
    OTS.require(recording.frame)
    require_sigma(sigma_mm, "the tracker error")
    require_spread(geometry.positions_mm, "spheres of the tool")
    farthest_mm = float(np.linalg.norm(geometry.positions_mm, axis=1).max())
    if farthest_mm > LONGEST_TOOL_MM:
        raise InputError(
            f"a sphere of the tool lies {farthest_mm:.0f} mm from M; expected at most {LONGEST_TOOL_MM:g}: check the "
            "units of its geometry, and that it is told in M"
        )
    require_one_system((one.tool for one in recording.tools if one.usable), recording.source)
    if not recording.tools:
        found = locate_tool(geometry, find_markers(recording, sigma_mm=sigma_mm).points, expected=len(geometry))
        assert found.registration is not None
        return found.registration.pose
    matrix = resting_matrix(tool_poses(recording, tool), "the tool")
    errors_mm2 = matrix[:3, :3] @ geometry.covariances_mm2 @ matrix[:3, :3].T + sigma_mm**2 * np.eye(3)
    if np.linalg.eigvalsh(errors_mm2).min() <= 0:
        raise InputError("neither the tool's spheres nor their readings err as stated; state an error above zero")
    return Pose(matrix, pose_covariance(transform_points(matrix, geometry.positions_mm), errors_mm2), OTS, M)


def robot_pose(matrix: FloatArray, sigma_mm: float = SIGMA_ROBOT_MM, sigma_deg: float = SIGMA_ROBOT_DEG) -> Pose:
    """Return R from TCP of a ``matrix`` (4, 4), mm, with the robot's own error: per axis, about the TCP.

    Raises `InputError` for a matrix that is no pose and for errors that are none.
    """
    require_sigma(sigma_mm, "the robot's error")
    check_type(sigma_deg, Real, "the robot's error of rotation", "give one number, in degrees")
    if not 0 <= sigma_deg < 180:
        raise InputError(f"the robot's error of rotation is {sigma_deg} degrees; expected 0 to 180")
    checked = as_pose(matrix, "robot_from_tcp")
    carry = about(-checked[:3, 3])
    spread = np.diag(np.repeat([np.radians(sigma_deg) ** 2, sigma_mm**2], 3))
    return Pose(checked, carry @ spread @ carry.T, R, TCP)
