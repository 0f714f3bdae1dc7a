"""placement.json: where the robot shall stand, how each task is served from there, or what stands in the way."""

from __future__ import annotations

import os
from collections.abc import Iterable
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
from pydantic import Field, FiniteFloat, SerializerFunctionWrapHandler, model_serializer, model_validator

from ronnaplan.ct.identity import ScanIdentity
from ronnaplan.documents.agreement import SAME_CENTER_MM
from ronnaplan.documents.fiducials import FiducialEntry, Source
from ronnaplan.documents.fields import (
    Direction,
    DocumentModel,
    Label,
    LengthMm,
    Line,
    Matrix4,
    PositiveMm,
    Probability,
    Revision,
    Row6,
    Software,
    Vector,
    require_different_names,
    told_by_reader,
)
from ronnaplan.documents.reading import read_document
from ronnaplan.documents.room import MOST_THINGS, BoxEntry, CapsuleEntry
from ronnaplan.geometry import FloatArray, Frame
from ronnaplan.planning import Trajectory
from ronnaplan.pose import as_pose
from ronnaplan.robot.placement.room import base_place
from ronnaplan.text import listed

ACROSS = 1e-6
"""Largest cosine between a trajectory and a direction across it: round-off of what is written."""
MOST_HELD = 100
"""No arm has so many joints to hold."""
Degrees = Annotated[float, Field(ge=-720, le=720)]


class _Grown(DocumentModel):
    """What has fields, the ``newer`` ones, that older readers do not know: where empty they are not written."""

    newer: ClassVar[tuple[str, ...]]

    @model_serializer(mode="wrap")
    def _written(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        content: dict[str, Any] = write(self)
        return {key: value for key, value in content.items() if value or key not in self.newer}


class ServedEntry(_Grown):
    """One task: the joints all along its way (degrees) and the least margins on it."""

    newer = ("x_axis",)

    name: Label
    kind: Literal["trajectory", "marker"]
    joints_deg: tuple[Row6, ...] = Field(min_length=1, max_length=10_000)
    joint_margin_deg: Degrees
    singularity_deg: Degrees
    clearance_mm: FiniteFloat
    tracker_deg: Degrees | None = None
    x_axis: Direction | None = None
    """Of a trajectory: where the tool's x axis points in R all along it, if the room told which axis that is."""


class RouteEntry(DocumentModel):
    """The order in which the arm moves least, from and to its reference posture."""

    order: tuple[Label, ...]
    travel_deg: Annotated[float, Field(ge=0, le=1e6)]
    reference_deg: Row6
    by_reference: tuple[Label, ...] = ()
    stuck: tuple[Label, ...] = ()


class RoomEntry(DocumentModel):
    """What stands in the room, in its coordinates; for the eye."""

    boxes: tuple[BoxEntry, ...] = Field(default=(), max_length=MOST_THINGS)
    capsules: tuple[CapsuleEntry, ...] = Field(default=(), max_length=MOST_THINGS)
    tracker: Vector | None = None


class RobotEntry(DocumentModel):
    """The robot in its reference posture and its trolley, in the room's coordinates; for the eye."""

    bodies: tuple[CapsuleEntry, ...] = Field(default=(), max_length=MOST_THINGS)
    trolley: tuple[BoxEntry, ...] = Field(default=(), max_length=MOST_THINGS)
    shoulder: Vector
    reach: LengthMm
    """Of the arm stretched, from its first axis to where an instrument leaves its holder."""


class PathEntry(DocumentModel):
    """A trajectory as it was served, LPS mm; the instrument is what goes along it."""

    name: Label
    entry: Vector
    target: Vector
    diameter_mm: PositiveMm
    length_mm: PositiveMm

    @classmethod
    def of(cls, one: Trajectory) -> Self:
        """Return the entry of a trajectory."""
        return cls(
            name=one.name,
            entry=tuple(one.entry_mm.tolist()),
            target=tuple(one.target_mm.tolist()),
            diameter_mm=one.instrument.diameter_mm,
            length_mm=one.instrument.length_mm,
        )


class MarkerEntry(DocumentModel):
    """A marker as it was served, LPS mm."""

    label: Label
    center: Vector

    @classmethod
    def of(cls, one: FiducialEntry) -> Self:
        """Return the entry of a marker."""
        return cls(label=one.label, center=one.center)

    def is_at(self, center: Vector) -> bool:
        """Whether the marker was there, but for the round-off of a written center."""
        return bool(np.allclose(self.center, center, rtol=0.0, atol=SAME_CENTER_MM))


class PlaceEntry(_Grown):
    """One base: R from CT and room from R, mm, and all it does."""

    newer = ("near", "at_reference")

    r_from_ct: Matrix4
    room_from_r: Matrix4
    worst_margin_deg: Degrees
    probability: Probability | None = None
    tasks: tuple[ServedEntry, ...]
    route: RouteEntry
    robot: RobotEntry | None = None
    near: tuple[Line, ...] = ()
    """What of the tool comes near the wrist on the way."""
    at_reference: Line | None = None
    """What the arm meets in its reference posture, from which no way leads then."""

    @property
    def position(self) -> FloatArray:
        """Where the base stands in the room: x, y, z (mm) and turn (degrees) (4,)."""
        return base_place(np.array(self.room_from_r))

    @property
    def no_way(self) -> str | None:
        """Say to what of the tasks no free way leads; None where one leads to each of them."""
        if self.at_reference is not None:
            return f"no free way to any task: {self.at_reference}"
        stuck = self.route.stuck
        return f"no free way from the reference posture to {listed(stuck)}" if stuck else None

    @property
    def surely(self) -> float | None:
        """How likely all is served after parking; None where the base was measured, and where a way is missing."""
        return self.probability if self.no_way is None else None

    @model_validator(mode="after")
    def _check(self) -> Self:
        for name, matrix in (("r_from_ct", self.r_from_ct), ("room_from_r", self.room_from_r)):
            with told_by_reader():
                as_pose(matrix, name)
        least = min((one.joint_margin_deg for one in self.tasks), default=0.0)
        if not np.isclose(least, self.worst_margin_deg, atol=1e-6):
            raise ValueError(f"worst_margin_deg is {self.worst_margin_deg:g}, but the tasks say {least:g}")
        return self


class ParkingEntry(DocumentModel):
    """What the probabilities rest on: one standard deviation each."""

    sigma_mm: LengthMm
    sigma_deg: LengthMm


class HeldEntry(DocumentModel):
    """A joint that does not turn, and the angle at which the robot has to hold it."""

    joint: Label
    angle_deg: Degrees


class LinksEntry(DocumentModel):
    """Of what links the poses are, by their names in the arm's description: R is the ``base``."""

    base: Label
    flange: Label


class PlacementDocument(_Grown):
    """The whole of placement.json, version 1.

    ``trajectories`` and ``markers`` are those that were to be served, as they were then; versions up to 0.2 do not tell
    them, nor the arm's ``links``. Where joints are held, angles are those of the six ``joints`` that turn, and each of
    ``held`` stays at its own. Otherwise neither is written, and the angles are those of all joints in their order.
    """

    newer = ("links", "joints", "held", "trajectories", "markers", "standoff_mm", "notes")

    format: Literal["ronnaplan.placement"]
    version: Literal[1]
    unit: Literal["mm"]
    revision: Revision = 0
    status: Literal["placed", "parked", "blocked"]
    source: Source = Source()
    trajectories: tuple[PathEntry, ...] = ()
    """What was to be served."""
    markers: tuple[MarkerEntry, ...] = ()
    """Those that were to be served, too."""
    standoff_mm: LengthMm = 0.0
    """Trajectories were looked at from so far before their entries."""
    arm: Label
    links: LinksEntry | None = None
    joints: tuple[Label, Label, Label, Label, Label, Label] | None = None
    held: tuple[HeldEntry, ...] = Field(default=(), max_length=MOST_HELD)
    parking: ParkingEntry
    robot_from_ct: tuple[PlaceEntry, ...] = ()
    """The best place first, then alternatives apart from it."""
    blocked: tuple[Line, ...] = ()
    room: RoomEntry | None = None
    notes: tuple[Line, ...] = ()
    """What was not looked at, and what makes the rest doubtful."""
    software: Software

    @model_validator(mode="after")
    def _check(self) -> Self:
        if (self.status == "blocked") == bool(self.robot_from_ct) or bool(self.robot_from_ct) == bool(
            self.blocked
        ):
            raise ValueError(f"the status is {self.status}, with {len(self.robot_from_ct)} places")
        if (self.joints is None) == bool(self.held):
            raise ValueError("joints that turn and joints that are held do not stand together")
        require_different_names("joints", [*(self.joints or ()), *(one.joint for one in self.held)])
        for place in self.robot_from_ct:
            self._check_x_axes(place)
        return self

    def _check_x_axes(self, place: PlaceEntry) -> None:
        along = {one.name: np.subtract(one.target, one.entry) for one in self.trajectories}
        for task in place.tasks:
            if task.x_axis is None:
                continue
            if task.kind != "trajectory" or task.name not in along:
                raise ValueError(f"the {task.kind} {task.name} has an x_axis, but is none of the trajectories")
            in_r = np.array(place.r_from_ct)[:3, :3] @ along[task.name]
            if abs(in_r @ task.x_axis) > ACROSS * np.linalg.norm(in_r):
                raise ValueError(f"the x_axis of {task.name} is not perpendicular to its trajectory")

    @property
    def arm_text(self) -> str:
        """The arm, what of it is held, and which of its links R and the flange are."""
        held = " and ".join(f"{one.joint} held at {one.angle_deg:g} degrees" for one in self.held)
        told = f"{self.arm}, {held}" if held else self.arm
        if self.links is None:
            return told
        return f"{told}; R is its link {self.links.base}, its flange the link {self.links.flange}"

    def not_known(self, trajectories: Iterable[Trajectory]) -> list[str]:
        """Return the names of those of ``trajectories`` that were not served, or not as they are now."""
        known = {one.name: one for one in self.trajectories}
        return [one.name for one in trajectories if known.get(one.name) != PathEntry.of(one)]

    @property
    def ct_frame(self) -> Frame:
        """The scan's frame of reference."""
        return self.source.frame

    @property
    def identity(self) -> ScanIdentity:
        """The scan that it belongs to."""
        return self.source.identity("the placement", self.ct_frame)


def read_placement(path: str | os.PathLike[str]) -> PlacementDocument:
    """Read and check placement.json; raises `InputError` naming the first field that is wrong."""
    return read_document(
        path, PlacementDocument, kind="placement document", remedy="write it anew with robot place"
    )


def placement_text(document: PlacementDocument) -> str:
    """Return what a person should know of a placement, some lines."""
    lines = [document.arm_text]
    for number, place in enumerate(document.robot_from_ct, 1):
        x, y, z, turn = place.position
        what = "here" if document.status == "parked" else f"place {number}"
        sure = "" if place.surely is None else f"; serves all after parking with probability {place.surely:.3f}"
        lines.append(
            f"{what}: x {x:.0f}, y {y:.0f}, z {z:.0f} mm, turn {turn:.0f} degrees; "
            f"joints keep {place.worst_margin_deg:.1f} degrees{sure}"
        )
        if place.route.order:
            lines.append(f"  order: {', '.join(place.route.order)} ({place.route.travel_deg:.0f} degrees)")
        if place.no_way is not None:
            lines.append(f"  {place.no_way}")
        lines += [f"  {sentence}" for sentence in place.near]
    return "\n".join([*lines, *document.blocked])
