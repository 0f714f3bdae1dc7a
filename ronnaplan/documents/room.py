"""room.toml: what stands in the room, what the robot carries, and what margins are asked for."""

from __future__ import annotations

import math
import os
from typing import Annotated, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from ronnaplan.documents.fields import (
    DocumentModel,
    Label,
    PositiveMm,
    Vector,
    require_different_names,
    told_by_reader,
)
from ronnaplan.documents.reading import read_settings
from ronnaplan.documents.room_fields import (
    LARGEST_STANDOFF_MM,
    AboveFloor,
    Angle,
    Degrees,
    KeptMm,
    OnFlange,
    Pointing,
    Range,
    Sides,
    StandoffMm,
    Turns,
)
from ronnaplan.robot.placement import room as parts

MOST_THINGS = 200
"""More boxes or capsules than this make the search slow; thin a room to what is near."""

MOST_LINKS = 7
"""The last link's number of an arm with a joint that is held; the arm itself says how many it has."""
LEAST_VIEW_MM = 1.0
"""A marker is viewed along the way of the cameras to it, which has no direction if it is no way."""
SMALLEST_THING_MM = 10.0
"""Nothing worth keeping clear of is smaller; a table of 1.7 mm was stated in metres."""
LEAST_RADIUS_MM = 0.25
"""Wires are thicker; a post of a radius of 0.02 mm was stated in metres."""


def _require_size(name: str, longest_mm: float) -> None:
    if longest_mm < SMALLEST_THING_MM:
        raise ValueError(
            f"{name} is {longest_mm:g} mm long; is it in metres? Expected {SMALLEST_THING_MM:g} or more"
        )


class BoxEntry(DocumentModel):
    """An upright box."""

    name: Label
    center: Vector
    size: Sides
    turn_deg: Degrees = 0.0

    @model_validator(mode="after")
    def _check(self) -> Self:
        _require_size(self.name, max(self.size))
        return self

    @property
    def box(self) -> parts.Box:
        """The box."""
        return parts.Box(self.name, self.center, self.size, self.turn_deg)


class CapsuleEntry(DocumentModel):
    """All within ``radius`` of a line."""

    name: Label
    start: Vector
    end: Vector
    radius: PositiveMm

    @model_validator(mode="after")
    def _check(self) -> Self:
        _require_size(self.name, math.dist(self.start, self.end) + 2 * self.radius)
        if self.radius < LEAST_RADIUS_MM:
            raise ValueError(
                f"{self.name} has a radius of {self.radius:g} mm; is it in metres? Expected {LEAST_RADIUS_MM:g} or more"
            )
        return self

    @property
    def capsule(self) -> parts.Capsule:
        """The capsule."""
        return parts.Capsule(self.name, self.start, self.end, self.radius)


class ArmBodyEntry(CapsuleEntry):
    """A capsule about a link of the arm, in the link's frame; links count as before any joint was held."""

    link: Annotated[int, Field(ge=0, le=MOST_LINKS)]


class HeadEntry(DocumentModel):
    """Where the head is."""

    center: AboveFloor
    anterior: Pointing
    superior: Pointing

    @model_validator(mode="after")
    def _check(self) -> Self:
        with told_by_reader():
            self.pose()
        return self

    def pose(self) -> parts.HeadPose:
        """Where the head lies."""
        return parts.HeadPose(self.center, self.anterior, self.superior)


class FloorEntry(DocumentModel):
    """Where the base may stand."""

    x: Range
    y: Range
    z: Range
    turn_deg: Turns = parts.Floor.turn_deg
    trolley: tuple[BoxEntry, ...] = Field(default=(), max_length=MOST_THINGS)

    @model_validator(mode="after")
    def _check(self) -> Self:
        for name, ends in (("x", self.x), ("y", self.y), ("z", self.z), ("turn_deg", self.turn_deg)):
            if ends[0] > ends[1]:
                raise ValueError(f"{name} goes from {ends[0]:g} to {ends[1]:g}; expected the smaller one first")
            small = ends[1] - ends[0] > 0.0 and max(map(abs, ends)) < SMALLEST_THING_MM
            if small and name != "turn_deg":
                raise ValueError(
                    f"{name} goes from {ends[0]:g} to {ends[1]:g} mm; is it in metres? Expected mm, or one number "
                    "where it does not change"
                )
        with told_by_reader():
            self.floor().require_above(self.z[1])
        return self

    def floor(self) -> parts.Floor:
        """The floor."""
        return parts.Floor(self.x, self.y, self.z, self.turn_deg, tuple(one.box for one in self.trolley))


class ToolMarkerEntry(DocumentModel):
    """The tracker's marker on the tool."""

    at: OnFlange
    normal: Pointing
    seen_deg: Angle = parts.ToolMarker.seen_deg


class ToolEntry(DocumentModel):
    """The instrument holder, in the flange's frame."""

    start: OnFlange = parts.Tool.start_mm
    direction: Pointing = parts.Tool.direction
    standoff_mm: StandoffMm = parts.Tool.standoff_mm
    x_axis: Pointing | None = None
    body: tuple[CapsuleEntry, ...] = Field(default=(), max_length=MOST_THINGS)
    marker: ToolMarkerEntry | None = None

    @model_validator(mode="after")
    def _check(self) -> Self:
        with told_by_reader():
            self.tool()
        return self

    def tool(self) -> parts.Tool:
        """The tool."""
        told, bodies = self.marker, tuple(one.capsule for one in self.body)
        marker = None if told is None else parts.ToolMarker(told.at, told.normal, told.seen_deg)
        return parts.Tool(self.start, self.direction, self.standoff_mm, bodies, marker, self.x_axis)


class CameraEntry(DocumentModel):
    """The stereo cameras, in the flange's frame."""

    tcp: OnFlange = parts.Camera.tcp_mm
    direction: Pointing = parts.Camera.direction
    tilt_deg: Angle = parts.Camera.tilt_deg
    standoff_mm: Annotated[float, Field(ge=LEAST_VIEW_MM, le=LARGEST_STANDOFF_MM)] = parts.Camera.standoff_mm


class TrackerEntry(DocumentModel):
    """The tracker."""

    position: AboveFloor
    nearest_mm: KeptMm = parts.Tracker.nearest_mm
    farthest_mm: PositiveMm = parts.Tracker.farthest_mm
    body_mm: KeptMm = parts.Tracker.body_mm
    beam_mm: KeptMm = parts.Tracker.beam_mm

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.farthest_mm < SMALLEST_THING_MM:
            raise ValueError(f"it sees up to {self.farthest_mm:g} mm far; is that in metres? Expected mm")
        if self.nearest_mm >= self.farthest_mm:
            raise ValueError(
                f"it sees from {self.nearest_mm:g} to {self.farthest_mm:g} mm; expected farthest_mm beyond nearest_mm"
            )
        return self


class MarginsEntry(DocumentModel):
    """The least margins that count as served."""

    joint_deg: Angle = parts.Margins.joint_deg
    singularity_deg: Annotated[float, Field(ge=1, le=90)] = parts.Margins.singularity_deg
    clearance_mm: KeptMm = parts.Margins.clearance_mm
    tracker_deg: Angle = parts.Margins.tracker_deg


class ParkingEntry(DocumentModel):
    """One standard deviation of where the robot comes to stand."""

    sigma_mm: KeptMm = parts.Parking.sigma_mm
    sigma_deg: Angle = parts.Parking.sigma_deg


def _whole(version: object) -> object:
    if type(version) is not int:  # to Python `true` and 1.0 are 1, too
        raise ValueError("is no whole number")
    return version


class RoomDocument(DocumentModel):
    """The whole of room.toml, version 1."""

    format: Literal["ronnaplan.room"]
    version: Annotated[Literal[1], BeforeValidator(_whole)]
    unit: Literal["mm"]
    head: HeadEntry
    base: FloorEntry
    tracker: TrackerEntry | None = None
    tool: ToolEntry = ToolEntry()
    camera: CameraEntry = CameraEntry()
    box: tuple[BoxEntry, ...] = Field(default=(), max_length=MOST_THINGS)
    capsule: tuple[CapsuleEntry, ...] = Field(default=(), max_length=MOST_THINGS)
    arm_body: tuple[ArmBodyEntry, ...] = Field(default=(), max_length=MOST_THINGS)
    margins: MarginsEntry = MarginsEntry()
    parking: ParkingEntry = ParkingEntry()
    reference_deg: tuple[Degrees, Degrees, Degrees, Degrees, Degrees, Degrees] = (
        0.0,
        -120.0,
        120.0,
        0.0,
        60.0,
        0.0,
    )

    @model_validator(mode="after")
    def _check(self) -> Self:
        # a sentence says by its name what stands in the way
        boxes = [one.name for one in (*self.box, *self.base.trolley)]
        require_different_names("boxes or capsules", [*boxes, *(one.name for one in self.capsule)])
        return self

    @property
    def room(self) -> parts.Room:
        """The room."""
        camera = self.camera
        return parts.Room(
            head=self.head.pose(),
            floor=self.base.floor(),
            tracker=None if self.tracker is None else _tracker(self.tracker),
            tool=self.tool.tool(),
            camera=parts.Camera(camera.tcp, camera.direction, camera.tilt_deg, camera.standoff_mm),
            boxes=tuple(one.box for one in self.box),
            capsules=tuple(one.capsule for one in self.capsule),
            arm_bodies=tuple((one.link, one.capsule) for one in self.arm_body),
            margins=parts.Margins(**self.margins.model_dump()),
            parking=parts.Parking(**self.parking.model_dump()),
            reference_deg=self.reference_deg,
        )


def _tracker(told: TrackerEntry) -> parts.Tracker:
    return parts.Tracker(told.position, told.nearest_mm, told.farthest_mm, told.body_mm, told.beam_mm)


def read_room(path: str | os.PathLike[str]) -> parts.Room:
    """Read and check room.toml; raises `InputError` naming the first thing that is wrong."""
    remedy = "`robot place --example` writes one"
    return read_settings(path, RoomDocument, expected="a room", otherwise="is no room", remedy=remedy).room
