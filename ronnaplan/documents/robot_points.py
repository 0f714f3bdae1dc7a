"""Planned trajectories in the robot's coordinates, as files: JSON, CSV, YAML for ROS, and points for a KUKA."""

from __future__ import annotations

import csv
import io
import json
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Final, Literal

import numpy as np

from ronnaplan.documents.chain import ChainDocument
from ronnaplan.documents.fiducials import Source
from ronnaplan.documents.fields import DocumentModel, Label, LengthMm, Line, Matrix4, Software, Vector
from ronnaplan.documents.poses import PoseEntry
from ronnaplan.documents.reading import made, to_json
from ronnaplan.documents.robot_formats import RobotFormat
from ronnaplan.documents.ros import yaml_number
from ronnaplan.errors import InputError
from ronnaplan.geometry import FloatArray
from ronnaplan.pose import Pose, about, as_pose
from ronnaplan.robot.chain import TCP, R
from ronnaplan.robot.trajectories import RobotTrajectory

NOTICE = "Research use only, not a medical device. Check every point before the robot moves."
CSV_HEADER = (
    *("trajectory", "point", "x_mm", "y_mm", "z_mm", "q0", "qx", "qy", "qz"),
    *("expected_error_mm", "sd_x_mm", "sd_y_mm", "sd_z_mm", "notice"),
)
LOCKED = 1e-7
"""Tool x axes nearer than this to the vertical leave A and C of a KUKA one free angle."""
LONGEST_KRL_NAME = 24
"""Characters of a name in KRL at most."""
KRL_LIST = "ronnaplan_points"
KRL_WORDS: Final = re.compile(
    "AND|ANIN|ANOUT|AXIS|BOOL|BRAKE|B_AND|B_EXOR|B_NOT|B_OR|CASE|CCLOSE|CHANNEL|CHAR|CIRC|"
    "CIRC_REL|CONFIRM|CONST|CONTINUE|COPEN|CREAD|CWRITE|C_DIS|C_ORI|C_PTP|C_SPL|C_VEL|DECL|DEF|"
    "DEFAULT|DEFDAT|DEFFCT|DELAY|DIGIN|DISTANCE|DO|E6AXIS|E6POS|ELSE|END|ENDDAT|ENDFCT|ENDFOR|"
    "ENDIF|ENDLOOP|ENDSPLINE|ENDSTRUC|ENDSWITCH|ENDWHILE|ENUM|EXIT|EXOR|EXT|EXTFCT|FALSE|FOR|FRAME|"
    "GLOBAL|GOTO|HALT|IF|IMPORT|INT|INTERRUPT|IS|LIN|LIN_REL|LOOP|MAXIMUM|MINIMUM|NOT|OFF|ON|OR|"
    "POS|PRIO|PTP|PTP_REL|PUBLIC|PULSE|REAL|REPEAT|RESUME|RETURN|SCIRC|SEC|SIGNAL|SLIN|SPLINE|"
    "SPTP|SREAD|STEP|STRUC|SWITCH|SWRITE|SYNC|THEN|TO|TRIGGER|TRUE|UNTIL|WAIT|WHEN|WHILE|WITH"
)
"""What means something in the language, and names nothing else."""


class PointEntry(DocumentModel):
    """One point of a trajectory: the tool's pose in R (tip at its origin, advancing along +z) and its error."""

    robot_from_tool: PoseEntry
    expected_error: LengthMm
    """Root-mean-square error of the tip's place, mm."""


class TrajectoryEntry(DocumentModel):
    """One trajectory in R."""

    name: Label
    approach: Matrix4
    """R from tool outside the entry, on the trajectory's line."""
    entry: PointEntry
    target: PointEntry
    depth: LengthMm
    direction: Vector


class RobotPointsDocument(DocumentModel):
    """The whole of the exported JSON, version 1."""

    format: Literal["ronnaplan.robot-points"]
    version: Literal[1]
    unit: Literal["mm"]
    frame: Literal["R"]
    notice: Line
    way: Literal["tracker", "stereo"]
    source: Source
    trajectories: tuple[TrajectoryEntry, ...]
    software: Software


def export_points(
    trajectories: Sequence[RobotTrajectory],
    chain: ChainDocument,
    to: RobotFormat,
    approach_mm: float,
    name: str,
) -> str:
    """Return ``trajectories`` in a format, each with a point ``approach_mm`` before its entry.

    ``name`` is the file's, which a KUKA's controller takes for that of the data list.
    """
    if not trajectories:
        raise InputError("the plan has no trajectory; add one first")
    document = _document(trajectories, chain, approach_mm)
    return WRITERS[to](document, name)


def _document(
    trajectories: Sequence[RobotTrajectory], chain: ChainDocument, approach_mm: float
) -> RobotPointsDocument:
    return made(
        RobotPointsDocument,
        {
            "notice": NOTICE,
            "way": chain.way,
            "source": chain.source.model_dump(),
            "trajectories": [
                {
                    "name": one.name,
                    "approach": one.before_entry(approach_mm).tolist(),
                    "entry": _point(one, 0),
                    "target": _point(one, 1),
                    "depth": one.depth_mm,
                    "direction": one.direction.tolist(),
                }
                for one in trajectories
            ],
        },
    )


def _point(one: RobotTrajectory, end: int) -> dict[str, object]:
    pose = (one.at_entry, one.at_target)[end]
    about_origin = about(-pose[:3, 3])
    covariance = about_origin @ one.tip_covariances[end] @ about_origin.T
    return {
        "robot_from_tool": {
            "matrix": pose.tolist(),
            "covariance": ((covariance + covariance.T) / 2).tolist(),
        },
        "expected_error": float(one.expected_errors_mm[end]),
    }


def _points(document: RobotPointsDocument) -> list[tuple[str, str, Pose]]:
    """Return (trajectory, approach, entry or target, R from tool) of each point."""
    found = []
    for one in document.trajectories:
        entry, target = (point.robot_from_tool.pose(R, TCP) for point in (one.entry, one.target))
        approach = replace(
            entry, matrix=as_pose(one.approach, "approach")
        )  # errors about R's origin are the chain's
        found += [(one.name, "approach", approach), (one.name, "entry", entry), (one.name, "target", target)]
    return found


def _about_tip(pose: Pose) -> FloatArray:
    """Return the covariance (6, 6), rotation first, of a tool that turns about its tip."""
    carry = about(pose.translation_mm)
    return np.asarray(carry @ pose.covariance @ carry.T)


def _csv(document: RobotPointsDocument) -> str:
    from ronnaplan.tracking.cells import plain_text

    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(CSV_HEADER)
    for name, end, pose in _points(document):
        sds = np.sqrt(np.diag(_about_tip(pose))[3:])
        error = np.linalg.norm(sds)
        numbers = [*pose.translation_mm, *_quaternion(pose)]
        row = [*(f"{each:.12g}" for each in numbers), *(f"{each:.4f}" for each in (error, *sds))]
        writer.writerow([plain_text(name), end, *row, document.notice])
    return stream.getvalue()


def _ros(document: RobotPointsDocument) -> str:
    """Return a YAML list of geometry_msgs/PoseWithCovarianceStamped: metres, radians, axes of the robot's base."""
    lines = [
        f"# {document.notice}",
        "# geometry_msgs/PoseWithCovarianceStamped (m, rad), the tool advances along +z",
    ]
    for name, end, pose in _points(document):
        w, x, y, z = map(yaml_number, _quaternion(pose))
        px, py, pz = map(yaml_number, pose.translation_mm / 1000)
        order = np.array([3, 4, 5, 0, 1, 2])
        scale = np.repeat([1e-3, 1.0], 3)
        covariance = _about_tip(pose)[np.ix_(order, order)] * np.outer(scale, scale)
        cells = ", ".join(f"{each:.9e}" for each in covariance.ravel())
        lines += [
            # as they are: YAML reads what JSON escapes beyond 16 bits as two characters
            f"- name: {json.dumps(f'{name} {end}', ensure_ascii=False)}",
            '  header: {frame_id: "robot_base"}',
            "  pose:",
            "    pose:",
            f"      position: {{x: {px}, y: {py}, z: {pz}}}",
            f"      orientation: {{x: {x}, y: {y}, z: {z}, w: {w}}}",
            f"    covariance: [{cells}]",
        ]
    return "\n".join([*lines, ""])


def _krl(document: RobotPointsDocument, name: str) -> str:
    """Return a KRL data list of FRAMEs (mm, degrees; A about Z, B about Y, C about X) in $ROBROOT; it moves nothing."""
    _require_told_apart([one.name for one in document.trajectories])
    names = krl_names([one.name for one in document.trajectories])
    data_list = krl_names([name])[name]
    lines = [
        "&ACCESS R",
        f"DEFDAT {data_list} PUBLIC",
        f"; {document.notice}",
        f"; For the controller the file's name is {data_list}.dat.",
        "; Frames in $ROBROOT (mm, degrees). The tool's tip is its origin; it advances along +Z.",
    ]
    for one in document.trajectories:
        entry, target = one.entry.expected_error, one.target.expected_error
        told = f"expected error {entry:.3f} mm RMS at the entry, {target:.3f} at the target"
        lines.append(f"; Trajectory {_ascii(one.name)}: {told}")  # FOLD as a comment's first word folds it
        ends = {
            "APP": one.approach,
            "ENT": one.entry.robot_from_tool.matrix,
            "TGT": one.target.robot_from_tool.matrix,
        }
        for label, matrix in ends.items():
            lines.append(f"DECL GLOBAL FRAME {names[one.name]}_{label}={{{_krl_frame(np.array(matrix))}}}")
    return "\n".join([*lines, "ENDDAT", ""])


def _require_told_apart(names: Sequence[str]) -> None:
    """Raise `InputError` for two names that are the same in ASCII, the letters of KRL."""
    alike: dict[str, str] = {}
    for name in names:
        other = alike.setdefault(_ascii(name), name)
        if other != name:
            raise InputError(
                f"the trajectories {other} and {name} look alike in the letters that KRL has (ASCII); rename one"
            )


def krl_names(names: Sequence[str]) -> dict[str, str]:
    """Return the name in KRL of each trajectory: letters, digits and ``_``, no more than the controller takes.

    >>> krl_names(["left STN", "left stn", "3rd", "frame"])
    {'left STN': 'LEFT_STN', 'left stn': 'LEFT_STN_2', '3rd': 'T_3RD', 'frame': 'T_FRAME'}
    """
    taken: dict[str, str] = {}
    for name in names:
        plain = re.sub(r"[^A-Z0-9]+", "_", name.upper()).strip("_") or "T"
        plain = plain if plain[0].isalpha() and not KRL_WORDS.fullmatch(plain) else f"T_{plain}"
        longest = LONGEST_KRL_NAME - len("_APP")
        candidate, number = plain[:longest], 1
        while candidate in taken.values():
            number += 1
            candidate = f"{plain[: longest - len(str(number)) - 1]}_{number}"
        taken[name] = candidate
    return taken


def _krl_frame(matrix: FloatArray) -> str:
    values = dict(zip("XYZABC", (*matrix[:3, 3], *krl_angles(matrix)), strict=True))
    return ",".join(f"{axis} {value:.6f}" for axis, value in values.items())


def krl_angles(matrix: FloatArray) -> tuple[float, float, float]:
    """Return A, B and C (degrees) of a pose: turns about Z, then the new Y, then the newest X.

    Where B is +-90 degrees, A and C turn about one line and C is 0.
    """
    (ux, vx, _), (uy, vy, _), (uz, vz, wz) = matrix[:3, :3].tolist()
    level = math.hypot(ux, uy)
    if level < LOCKED:
        angles = math.atan2(-vx, vy), math.atan2(-uz, level), 0.0
    else:
        angles = math.atan2(uy, ux), math.atan2(-uz, level), math.atan2(vz, wz)
    a, b, c = map(math.degrees, angles)
    return a, b, c


def _quaternion(pose: Pose) -> FloatArray:
    """Return the scalar-first quaternion (4,) of a pose's rotation."""
    from scipy.spatial.transform import Rotation

    quaternion: FloatArray = Rotation.from_matrix(pose.rotation).as_quat(canonical=True, scalar_first=True)
    return quaternion


def _ascii(text: str) -> str:
    return text.encode("ascii", "replace").decode()


WRITERS: Final[Mapping[RobotFormat, Callable[[RobotPointsDocument, str], str]]] = {
    RobotFormat.JSON: lambda document, _: to_json(document),
    RobotFormat.CSV: lambda document, _: _csv(document),
    RobotFormat.ROS: lambda document, _: _ros(document),
    RobotFormat.KRL: _krl,
}
"""Each writes a document into a file of a name."""
