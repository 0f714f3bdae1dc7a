"""The chain as it is now: whether head and robot still stand as they were registered, told apart, and R from CT.

The tracker sees the head's markers and the tool. The head's are held against those of the registration (`check_drift`).
The tool is held against where the robot, by its joints, must have brought it: what is left is a movement of the robot's
base before the tracker (or of the tool in its flange). A movement that both share is the tracker's own.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from ronnaplan.errors import InputError, RefusedError
from ronnaplan.geometry import Points
from ronnaplan.pose import Pose
from ronnaplan.registration import Drift, DriftStatus, check_drift, register_points
from ronnaplan.registration.drift import DRIFT_PROBABILITY
from ronnaplan.robot.chain import OTS, Capture, robot_from_ct
from ronnaplan.robot.recorded import resting_matrix, robot_pose, seen_tool, tool_poses
from ronnaplan.robot.twists import twist
from ronnaplan.sigmas import SIGMA_OTS_MM, SIGMA_ROBOT_DEG, SIGMA_ROBOT_MM
from ronnaplan.text import listed
from ronnaplan.tracking import PointReading, Recording, ToolReading
from ronnaplan.tracking.frames import LARGEST_STEP_MM, are_read_twice, labelled_frames
from ronnaplan.tracking.recording import OK
from ronnaplan.transforms import adjoint, carried, invert


class LiveStatus(StrEnum):
    """What a moment's readings say; only the first has a pose."""

    VALID = "nothing moved"
    HEAD_MOVED = "the head moved; register again"
    MARKER_MOVED = "a marker of the head is loose; do not trust the registration"
    ROBOT_MOVED = "the robot's base, or the tool in its flange, moved; take the chain again"
    BOTH_MOVED = "head and robot moved, each by itself; register again and take the chain again"
    TRACKER_MOVED = "head and robot moved as one before the tracker: the tracker moved; register again"
    UNSEEN = "head or tool is not seen, so that nothing is known"
    MOVING = "the arm is moving, so that its base cannot be judged"


@dataclass(frozen=True, eq=False)
class Movement:
    """Of the robot's base, in the tracker's frame, since the chain was taken."""

    pose: Pose
    """OTS from OTS: what the base did."""
    probability: float
    """At most so likely does a resting base look as if it had moved so far."""
    shift_mm: float
    """Of the tool."""
    rotation_deg: float

    @property
    def moved(self) -> bool:
        """Whether chance does not explain it."""
        return self.probability < DRIFT_PROBABILITY


@dataclass(frozen=True, eq=False)
class Moment:
    """What one moment's readings tell; ``robot_from_ct`` only where nothing moved."""

    status: LiveStatus
    head: Drift | None
    robot: Movement | None
    robot_from_ct: Pose | None
    why: str = ""
    """What was missing."""


def _unseen(why: str) -> Moment:
    return Moment(LiveStatus.UNSEEN, None, None, None, why)


@dataclass(eq=False)
class LiveChain:
    """A chain that was taken once, and is held against each moment's readings.

    ``head`` are the markers (OTS) and ``ots_from_ct`` the pose of the registration, ``capture`` is the moment of the
    chain, ``tool`` its spheres in M. ``tool_device`` names the tool's poses in the stream (None: the only ones),
    ``robot_device`` those of R from TCP (None: the robot rests as it did), ``head_device`` what sends the head's
    markers (None: the only one that shows them).
    """

    head: Points
    ots_from_ct: Pose
    capture: Capture
    tool: Points
    tool_device: str | None = None
    robot_device: str | None = None
    sigma_mm: float = SIGMA_OTS_MM
    sigma_robot_mm: float = SIGMA_ROBOT_MM
    sigma_robot_deg: float = SIGMA_ROBOT_DEG
    head_device: str | None = None

    def __post_init__(self) -> None:
        OTS.require(self.head.frame)
        self._followed = self.head
        self._showing: set[str] = set()

    def judge(self, recording: Recording) -> Moment:
        """Return what the readings of one moment tell of head and robot.

        Where they are a stream's last nothing is known, whatever was said before; what is joined again may have devices
        of other names.
        """
        if recording.end is not None:
            self._showing.clear()
            return _unseen(recording.notes[-1])
        try:
            frames = self._seen_head(recording)
        except InputError as error:  # more readings than a tracker makes, or more devices than one
            return _unseen(str(error))
        head, seen = self._drift(frames) if frames else (None, None)
        try:
            capture = self._capture(recording)
        except RefusedError as error:
            return Moment(LiveStatus.MOVING, head, None, None, str(error))
        except InputError as error:
            return Moment(LiveStatus.UNSEEN, head, None, None, str(error))
        robot = self._movement(capture)
        if seen is None or head is None or head.status is DriftStatus.TOO_FEW:
            return Moment(LiveStatus.UNSEEN, head, robot, None, _too_few(recording, self._followed))
        status = self._status(head, robot, seen)
        valid = status is LiveStatus.VALID
        return Moment(status, head, robot, robot_from_ct(self.ots_from_ct, capture) if valid else None)

    def _drift(self, frames: Sequence[Points]) -> tuple[Drift, Points]:
        """Return what the last of ``frames`` tells of the head, or an earlier one in which it had moved, and that one.

        Where some frames of a moment show it moved and others not, former places may be sent along.
        """
        *earlier, last = frames
        drift = check_drift(self.head, last)
        if drift.status is DriftStatus.STILL:
            for one in earlier:
                if (before := check_drift(self.head, one)).status is DriftStatus.PATIENT_MOVED:
                    return before, one
        return drift, last

    def _seen_head(self, recording: Recording) -> list[Points]:
        """Return the head's markers in each frame that shows three or more, followed from moment to moment.

        Raises `InputError` where several devices have shown them: one may lag behind, or repeat what is over.
        """
        devices = {one.frame: one.device for one in recording.points}
        if self.head_device is not None:
            recording = self._of_head_device(recording)
        frames = labelled_frames(recording, self._followed, sigma_mm=self.sigma_mm)
        enough = [points for _, points in frames if len(points) >= 3]
        if not enough:
            return []
        self._showing |= {devices[number] for number, points in frames if len(points) >= 3}
        if len(self._showing) > 1:
            raise InputError(
                f"several devices show the head's markers ({listed(sorted(self._showing))}), and may contradict each "
                "other; name the one that counts (--head-device)"
            )
        places = dict(zip(self._followed.labels, self._followed.positions_mm, strict=True))
        places.update(zip(enough[-1].labels, enough[-1].positions_mm, strict=True))
        self._followed = replace(
            self._followed, positions_mm=np.array([places[one] for one in self._followed.labels])
        )
        return enough

    def _of_head_device(self, recording: Recording) -> Recording:
        """Return the recording without other devices' points; raises `InputError` where there are none but theirs."""
        own = tuple(one for one in recording.points if one.device == self.head_device)
        if recording.points and not own:
            others = listed(sorted({one.device for one in recording.points}))
            raise InputError(f"no points come from the device {self.head_device}, but from {others}")
        return replace(recording, points=own)

    def _capture(self, recording: Recording) -> Capture:
        """Return the moment's chain from tracker to robot; raises where the tool is not seen or the arm moves."""
        others = tuple(one for one in recording.tools if one.tool != self.robot_device)
        _require_seen(others, self.tool_device, "the tool")
        sight = seen_tool(
            replace(recording, tools=others), self.tool, tool=self.tool_device, sigma_mm=self.sigma_mm
        )
        if self.robot_device is None:
            return replace(self.capture, ots_from_m=sight)
        _require_seen(recording.tools, self.robot_device, "the robot's pose")
        driven = resting_matrix(tool_poses(recording, self.robot_device), "the robot")
        told = robot_pose(driven, self.sigma_robot_mm, self.sigma_robot_deg)
        return replace(self.capture, ots_from_m=sight, robot_from_tcp=told)

    def _movement(self, now: Capture) -> Movement:
        """Return what the base did since the chain was taken.

        Both looks at the tool err, and both of the robot's poses; the tool's calibration is the same in both, so its
        error cancels as far as the TCP has the same pose.
        """
        then = self.capture
        matrix = now.ots_from_tcp.matrix @ invert(now.robot_from_tcp.matrix)
        matrix = matrix @ then.robot_from_tcp.matrix @ invert(then.ots_from_tcp.matrix)
        covariance = now.ots_from_m.covariance + carried(matrix, then.ots_from_m.covariance)
        tool = adjoint(now.ots_from_m.matrix) - adjoint(matrix @ then.ots_from_m.matrix)
        covariance = covariance + tool @ now.m_from_tcp.covariance @ tool.T
        if self.robot_device is not None:
            driven = now.robot_from_tcp.covariance + then.robot_from_tcp.covariance
            covariance = covariance + carried(now.ots_from_tcp.matrix @ invert(now.robot_from_tcp.matrix), driven)
        pose = Pose(matrix, covariance, OTS, OTS)
        place = then.ots_from_m.translation_mm
        shift = float(np.linalg.norm(pose.apply(place[None])[0] - place))
        return Movement(pose, _chance_of_rest(pose), shift, float(np.degrees(np.linalg.norm(twist(matrix)[:3]))))

    def _status(self, head: Drift, robot: Movement, seen: Points) -> LiveStatus:
        if head.status is DriftStatus.MARKER_MOVED:
            return LiveStatus.MARKER_MOVED
        if head.status is DriftStatus.STILL:
            return LiveStatus.ROBOT_MOVED if robot.moved else LiveStatus.VALID
        if not robot.moved:
            return LiveStatus.HEAD_MOVED
        then = self.head.positions_mm[[self.head.labels.index(label) for label in seen.labels]]
        errors = self.head.covariances_mm2[[self.head.labels.index(label) for label in seen.labels]]
        motion = register_points(then, seen.positions_mm, (errors, seen.covariances_mm2)).pose
        of_head = Pose(motion.matrix, motion.covariance, OTS, OTS)
        as_one = _chance_of_rest(robot.pose @ of_head.inverse()) >= DRIFT_PROBABILITY
        return LiveStatus.TRACKER_MOVED if as_one else LiveStatus.BOTH_MOVED


def _too_few(recording: Recording, followed: Points) -> str:
    """Say that the head's markers, which were last at ``followed``, are not seen, and why."""
    told = f"no three of the head's markers off one line are seen{_mostly_said(recording.points)}"
    usable = [one for one in recording.points if one.usable]
    last = max((one.frame for one in usable), default=0)
    here = np.array([one.position_mm for one in usable if one.frame == last]).reshape(-1, 3)
    if are_read_twice(here, followed.positions_mm):
        return (
            f"{told}; markers are read at two places of one frame, of which one may be of before a movement: let the "
            "tracker send each once"
        )
    places = np.array([one.position_mm for one in usable]).reshape(-1, 1, 3)
    away_mm = np.linalg.norm(places - followed.positions_mm, axis=2).min(axis=1)
    if not len(away_mm) or float(np.median(away_mm)) <= LARGEST_STEP_MM:
        return told
    return (
        f"{told}; most points are {np.median(away_mm):.0f} mm and more from where markers were last: if these are the "
        "head's, it was moved; register again"
    )


def _require_seen(readings: Sequence[ToolReading], device: str | None, what: str) -> None:
    """Raise `InputError` where none of the poses of ``what``, by its ``device`` or the only ones, counts.

    Where others come, but none of that name, what does come is told when it is looked for.
    """
    own = [one for one in readings if device in (None, one.tool)]
    if not readings or (own and not any(one.usable for one in own)):
        raise InputError(f"{what} is not seen{_mostly_said(own)}")


def _mostly_said(readings: Sequence[PointReading | ToolReading]) -> str:
    """Say what most readings say that do not count."""
    said = Counter(one.status for one in readings if one.status != OK).most_common(1)
    return f"; {said[0][1]} readings say '{said[0][0]}'" if said else ""


def _chance_of_rest(motion: Pose) -> float:
    """Return how likely errors as stated make rest look like ``motion``, to first order: chi-square of six."""
    from scipy.special import gammaincc

    vector = twist(motion.matrix)
    return float(gammaincc(3.0, vector @ np.linalg.solve(motion.covariance, vector) / 2))
