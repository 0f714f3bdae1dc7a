"""Planned trajectories in the robot's coordinates, as files: JSON, CSV, YAML for ROS, and points for a KUKA.

How the tool is rolled about them a placement may tell, by which the arm serves them.
"""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Final, Literal

import numpy as np

from ronnaplan.documents.chain import ChainDocument
from ronnaplan.documents.fiducials import Source
from ronnaplan.documents.fields import DocumentModel, Label, LengthMm, Line, Matrix4, Software, Vector
from ronnaplan.documents.krl import in_ascii, krl_frame, krl_names, require_told_apart
from ronnaplan.documents.poses import SAME_POSE_MM, PoseEntry
from ronnaplan.documents.reading import made, to_json
from ronnaplan.documents.robot_formats import RobotFormat
from ronnaplan.documents.ros import yaml_number
from ronnaplan.errors import InputError
from ronnaplan.geometry import FloatArray
from ronnaplan.planning import Plan
from ronnaplan.pose import Pose, as_pose
from ronnaplan.robot.chain import TCP, R
from ronnaplan.robot.trajectories import RobotTrajectory
from ronnaplan.text import listed
from ronnaplan.transforms import about

if TYPE_CHECKING:
    from ronnaplan.documents.placement import PlacementDocument

POINTS_NOTICE = "Research use only, not a medical device. Check every point before the robot moves."
CSV_HEADER = (
    *("trajectory", "point", "x_mm", "y_mm", "z_mm", "q0", "qx", "qy", "qz"),
    *("expected_error_mm", "sd_x_mm", "sd_y_mm", "sd_z_mm", "notice"),
)
KRL_LIST = "ronnaplan_points"
"""What a data list is called that goes to standard output."""


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


def placed_x_axes(placement: PlacementDocument, plan: Plan, chain: ChainDocument) -> tuple[Vector, ...]:
    """Return where the tool's x axis points in R along each trajectory of ``plan``, as ``placement`` serves it.

    Raises `FrameMismatchError` for a placement of another scan, and `InputError` where its base is not the one that
    ``chain`` measured, where it does not serve a trajectory as it is now, and where it tells no such axes.
    """
    plan.identity.require(placement.identity)
    if placement.status != "parked":
        raise InputError(
            f"the placement is {placement.status}; expected one from where the robot was parked: check this chain with "
            "'robot place --chain', and take what that writes"
        )
    place = placement.robot_from_ct[0]
    apart = np.abs(np.array(place.r_from_ct) - chain.pose.matrix)
    if apart.max() > SAME_POSE_MM:
        raise InputError(
            f"the placement has the scan elsewhere in R than the chain (its pose differs by up to {apart.max():.2g}); "
            "check this chain with 'robot place --chain', and take what that writes"
        )
    if names := placement.not_known(plan.trajectories):
        raise InputError(f"the placement does not serve {listed(names)} as planned now; run 'robot place' again")
    if place.no_way is not None:
        raise InputError(f"the placement has {place.no_way}; export by one that has a way to all")
    served = {one.name: one.x_axis for one in place.tasks if one.kind == "trajectory"}
    x_axes = tuple(axis for one in plan.trajectories if (axis := served.get(one.name)) is not None)
    if len(x_axes) < len(plan.trajectories):
        raise InputError(
            "the placement does not tell where the tool's x axis points; state x_axis in [tool] of the room, and run "
            "'robot place' again"
        )
    return x_axes


def _document(
    trajectories: Sequence[RobotTrajectory], chain: ChainDocument, approach_mm: float
) -> RobotPointsDocument:
    return made(
        RobotPointsDocument,
        {
            "notice": POINTS_NOTICE,
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
    require_told_apart([one.name for one in document.trajectories])
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
        lines.append(f"; Trajectory {in_ascii(one.name)}: {told}")  # FOLD as a comment's first word folds it
        ends = {
            "APP": one.approach,
            "ENT": one.entry.robot_from_tool.matrix,
            "TGT": one.target.robot_from_tool.matrix,
        }
        for label, matrix in ends.items():
            lines.append(f"DECL GLOBAL FRAME {names[one.name]}_{label}={{{krl_frame(np.array(matrix))}}}")
    return "\n".join([*lines, "ENDDAT", ""])


def _quaternion(pose: Pose) -> FloatArray:
    """Return the scalar-first quaternion (4,) of a pose's rotation."""
    from scipy.spatial.transform import Rotation

    quaternion: FloatArray = Rotation.from_matrix(pose.rotation).as_quat(canonical=True, scalar_first=True)
    return quaternion


WRITERS: Final[Mapping[RobotFormat, Callable[[RobotPointsDocument, str], str]]] = {
    RobotFormat.JSON: lambda document, _: to_json(document),
    RobotFormat.CSV: lambda document, _: _csv(document),
    RobotFormat.ROS: lambda document, _: _ros(document),
    RobotFormat.KRL: _krl,
}
"""Each writes a document into a file of a name."""
