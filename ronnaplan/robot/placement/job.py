"""What the robot has to do in a room, for a plan and the markers of its scan."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from ronnaplan.errors import InputError
from ronnaplan.geometry import FloatArray, Frame, Points
from ronnaplan.planning import Plan
from ronnaplan.pose import Pose
from ronnaplan.robot.arm.arm import SerialArm
from ronnaplan.robot.chain import R
from ronnaplan.robot.placement.at_best import kept_at_best
from ronnaplan.robot.placement.machine import body_names, machine_of
from ronnaplan.robot.placement.room import Room
from ronnaplan.robot.placement.search import Problem
from ronnaplan.robot.placement.tasks import Fineness, Task, drill_task, view_task, ways_of
from ronnaplan.robot.placement.world import NO_BALLS, World, world_of
from ronnaplan.transforms import invert, transform_points

TRACKER_APART_MM = 300.0
"""A tracker that was measured with a tape is nearer than this to where the registration puts it."""
LARGEST_TILT_DEG = 10.0
"""Of a measured base: a trolley stands upright, and a head in its holder lies as told to within this."""
LEAST_APART_MM = 5.0
"""A scan's origin lies farther from its robot's base; as near it would look in m."""
SURE_SDS = 2.0
"""Clearances hold where the measured base errs by less than they are, in so many standard deviations."""
MARKER_RADIUS_MM = 6.0
"""Of a marker whose size nobody told."""


@dataclass(frozen=True, eq=False)
class Job:
    """What the robot has to do, in the room: tasks, the head's surface and the tracker."""

    arm: SerialArm
    room: Room
    room_from_ct: FloatArray
    tasks: tuple[Task, ...]
    world: World
    frame: Frame = field(default_factory=lambda: Frame("CT"))
    """The plan's."""

    @classmethod
    def of_plan(
        cls,
        arm: SerialArm,
        room: Room,
        plan: Plan,
        markers: Points | None,
        surface_ct_mm: FloatArray,
        head_center_ct_mm: FloatArray,
        ots_from_ct: FloatArray | None = None,
        *,
        radii_mm: FloatArray | None = None,
        beside_ct_mm: FloatArray = NO_BALLS,
    ) -> Job:
        """Return the job of a plan and its scan's ``markers`` with the head's ``surface_ct_mm`` (N, 3), all in LPS mm.

        With ``ots_from_ct`` (4, 4) the tracker stands where it was registered, otherwise where the room says.
        ``radii_mm`` (M,) are those of the markers, which else have `MARKER_RADIUS_MM`; balls ``beside_ct_mm`` (B, 4),
        middles and radii, cover what stands out of the head. Raises `InputError` for a plan
        without trajectories and `FrameMismatchError` for markers of another scan.
        """
        if not plan.trajectories:
            raise InputError("the plan holds no trajectories; add those that the robot shall serve")
        room_from_ct = room.head.room_from_ct(head_center_ct_mm)
        center = transform_points(room_from_ct, head_center_ct_mm[None])[0]
        tasks = []
        for one in plan.trajectories:
            ends = transform_points(room_from_ct, np.array([one.entry_mm, one.target_mm]))
            told = one.instrument
            tasks.append(drill_task(one.name, ends[0], ends[1], room.tool, told.length_mm, told.diameter_mm))
        surface, balls = transform_points(room_from_ct, surface_ct_mm), NO_BALLS
        beside = np.column_stack([transform_points(room_from_ct, beside_ct_mm[:, :3]), beside_ct_mm[:, 3]])
        if markers is not None:
            plan.frame.require(markers.frame)
            places = transform_points(room_from_ct, markers.positions_mm)
            radii = np.full(len(places), MARKER_RADIUS_MM) if radii_mm is None else radii_mm
            balls = np.column_stack([places, radii])
            tasks += [
                view_task(name, at, center, room.camera) for name, at in zip(markers.labels, places, strict=True)
            ]
        tracker = None if room.tracker is None else np.array(room.tracker.position_mm)
        if ots_from_ct is not None and room.tracker is not None:
            tracker = (room_from_ct @ invert(ots_from_ct))[:3, 3]
        world = world_of(room, surface, tracker, balls, beside)
        return cls(arm, room, room_from_ct, tuple(tasks), world, plan.frame)

    def problem(self, fineness: Fineness, tasks: Sequence[Task] | None = None) -> Problem:
        """Return what bases are judged by, for all tasks or some."""
        ways = ways_of(self.tasks if tasks is None else tasks, self.arm, fineness)
        machine = machine_of(self.arm, self.room, ways.instruments)
        kept = kept_at_best(machine, self.world, ways, self.arm.flange)
        return Problem(machine, self.world, ways._replace(kept=kept), self.room.floor)

    def base_of(self, robot_from_ct: Pose) -> FloatArray:
        """Return room from R (4, 4) of a robot that was measured after parking.

        Raises `FrameMismatchError` for a pose of another scan than the plan's, `InputError` for a base that lies.
        """
        R.require(robot_from_ct.to_frame)
        self.frame.require(robot_from_ct.from_frame)
        base = self.room_from_ct @ invert(robot_from_ct.matrix)
        tilt_deg = float(np.degrees(np.arccos(np.clip(base[2, 2], -1.0, 1.0))))
        if tilt_deg > LARGEST_TILT_DEG:
            raise InputError(
                f"the robot's base is tilted by {tilt_deg:.0f} degrees in the room; expected {LARGEST_TILT_DEG:g} or "
                "less: check the head's anterior and superior in the room, and that R's z axis points up"
            )
        if (apart_mm := float(np.linalg.norm(robot_from_ct.translation_mm))) < LEAST_APART_MM:
            raise InputError(
                f"the chain puts the scan's origin {apart_mm:.3f} mm from the robot's, as if it were in m; expected "
                "mm: make it anew from recordings in mm"
            )
        return base

    def doubts_of(self, robot_from_ct: Pose) -> tuple[str, ...]:
        """Return why margins from where a robot was measured may not hold: two standard deviations are beyond them.

        They are those of the head's middle in R, and of the base's in the scan, along the axis of the larger error.
        """
        head_mm = transform_points(invert(self.room_from_ct), np.array([self.room.head.center_mm]))
        places = (
            robot_from_ct.point_covariances(head_mm),
            robot_from_ct.inverse().point_covariances(np.zeros((1, 3))),
        )
        off_mm = float(np.sqrt(max(np.linalg.eigvalsh(one[0])[-1] for one in places)))
        asked_mm = self.room.margins.clearance_mm
        if SURE_SDS * off_mm <= asked_mm:
            return ()
        return (
            f"head and base were measured against each other with a standard error of {off_mm:.1f} mm along the worst "
            f"axis, of which {SURE_SDS:g} are more than the {asked_mm:g} mm of clearance that are kept: what is told "
            "from here may not hold; take the chain anew, and look at what each link adds",
        )

    @property
    def doubts(self) -> tuple[str, ...]:
        """What makes the head look as if it lay otherwise than the room says."""
        if self.room.tracker is None:
            return ()
        stated, placed = np.array(self.room.tracker.position_mm), self.world.tracker
        apart_mm = float(np.linalg.norm(placed - stated))
        if apart_mm <= TRACKER_APART_MM:
            return ()
        told = ", ".join(f"{value:.0f}" for value in placed)
        return (
            f"by the registration the tracker stands at ({told}) in the room, {apart_mm:.0f} mm from where [tracker] "
            "has it; the former counts: check the head's center, anterior and superior, and the tracker's place",
        )

    @property
    def body_names(self) -> tuple[str, ...]:
        """The names of the machine's bodies."""
        return body_names(self.arm, self.room)

    @property
    def thing_names(self) -> tuple[str, ...]:
        """The names of what stands in the room, and under the robot."""
        boxes, capsules, under = self.room.boxes, self.room.capsules, self.room.floor.trolley
        return (
            *(one.name for one in boxes),
            *(one.name for one in capsules),
            *(one.name for one in under),
            "the floor",
        )
