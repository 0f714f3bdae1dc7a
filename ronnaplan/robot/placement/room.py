"""What stands in the room, what the robot carries, and what margins are asked for.

The room's frame: mm, z up, origin on the floor. Boxes stand upright: they turn about z only.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ronnaplan.errors import InputError
from ronnaplan.geometry import FloatArray, unit
from ronnaplan.transforms import rigid

UNDERGROUND_MM = 100.0
"""A trolley whose boxes end deeper beneath the floor was told to stand otherwise, as in metres."""
SQUARE = 1e-3
"""Largest cosine between two directions that were stated as perpendicular."""


@dataclass(frozen=True)
class Box:
    """An upright box: its middle, its sides, and its turn about z."""

    name: str
    center_mm: tuple[float, float, float]
    size_mm: tuple[float, float, float]
    turn_deg: float = 0.0


@dataclass(frozen=True)
class Capsule:
    """All that is within ``radius_mm`` of a line from ``start_mm`` to ``end_mm``."""

    name: str
    start_mm: tuple[float, float, float]
    end_mm: tuple[float, float, float]
    radius_mm: float


@dataclass(frozen=True)
class HeadPose:
    """Where the middle of the head lies in the room, and where nose and crown point, at right angles."""

    center_mm: tuple[float, float, float]
    anterior: tuple[float, float, float]
    superior: tuple[float, float, float]

    def __post_init__(self) -> None:
        if abs(unit(self.anterior) @ unit(self.superior)) > SQUARE:
            raise InputError(
                f"the head's anterior {self.anterior} and superior {self.superior} are not perpendicular; "
                "expected two directions at right angles"
            )

    def room_from_ct(self, center_ct_mm: FloatArray) -> FloatArray:
        """Return the room from CT (4, 4), given the head's middle (3,) in LPS."""
        nose, crown = unit(self.anterior), unit(self.superior)
        crown = unit(crown - nose * (nose @ crown))
        rotation = np.column_stack([np.cross(-nose, crown), -nose, crown])
        return rigid(rotation, np.array(self.center_mm) - rotation @ center_ct_mm)


@dataclass(frozen=True)
class ToolMarker:
    """The tracker's marker on the tool, on the flange: its place, where it faces, and how obliquely it is seen."""

    at_mm: tuple[float, float, float]
    normal: tuple[float, float, float]
    seen_deg: float = 70.0


@dataclass(frozen=True)
class Tool:
    """The instrument holder on the flange (its z points out of it): instruments leave it at ``start_mm``.

    An instrument is as long as it is usable, counted from ``start_mm``, along ``direction``. It begins
    ``standoff_mm`` before the entry. ``bodies`` are capsules in the flange's frame.

    ``x_axis`` is the direction, across ``direction``, that the robot's controller calls x of the tool; None where
    nobody told, as nothing here depends on it but what is exported to that controller.
    """

    start_mm: tuple[float, float, float] = (0.0, 0.0, 100.0)
    direction: tuple[float, float, float] = (0.0, 0.0, 1.0)
    standoff_mm: float = 30.0
    bodies: tuple[Capsule, ...] = ()
    marker: ToolMarker | None = None
    x_axis: tuple[float, float, float] | None = None

    def __post_init__(self) -> None:
        if self.x_axis is not None and abs(unit(self.x_axis) @ unit(self.direction)) > SQUARE:
            raise InputError(
                f"the tool's x_axis {self.x_axis} and direction {self.direction} are not perpendicular; expected two "
                "directions at right angles"
            )


@dataclass(frozen=True)
class Camera:
    """The stereo cameras' center point and viewing direction, on the flange.

    A marker is viewed along the way from it to the head's middle, tilted by up to ``tilt_deg``; the arm comes to it
    from ``standoff_mm`` further away.
    """

    tcp_mm: tuple[float, float, float] = (0.0, 0.0, 300.0)
    direction: tuple[float, float, float] = (0.0, 0.0, 1.0)
    tilt_deg: float = 30.0
    standoff_mm: float = 50.0


@dataclass(frozen=True)
class Tracker:
    """The optical tracker and how far it sees; the last ``body_mm`` of a line of sight are its own body."""

    position_mm: tuple[float, float, float]
    nearest_mm: float = 950.0
    farthest_mm: float = 2400.0
    body_mm: float = 250.0
    beam_mm: float = 30.0
    """Radius about a line of sight that must be free."""


@dataclass(frozen=True)
class Floor:
    """Where the robot's base may stand: least and greatest, and what stands under it (boxes in the base's frame)."""

    x_mm: tuple[float, float]
    y_mm: tuple[float, float]
    z_mm: tuple[float, float]
    turn_deg: tuple[float, float] = (-180.0, 180.0)
    trolley: tuple[Box, ...] = ()

    def require_above(self, z_mm: float) -> None:
        """Raise `InputError` for a base so low that a box of the trolley would be in the floor."""
        for one in self.trolley:
            if (deep_mm := one.size_mm[2] / 2 - one.center_mm[2] - z_mm) > UNDERGROUND_MM:
                raise InputError(
                    f"{one.name} would end {deep_mm:.0f} mm beneath the floor with the base at z = {z_mm:g}; expected "
                    "z as high as what stands under the base: is that in metres, or does the head lie elsewhere?"
                )


@dataclass(frozen=True)
class Parking:
    """How far from the place that was chosen the robot comes to stand: one standard deviation each."""

    sigma_mm: float = 20.0
    sigma_deg: float = 3.0


@dataclass(frozen=True)
class Margins:
    """The least margins that count as served."""

    joint_deg: float = 5.0
    singularity_deg: float = 8.0
    clearance_mm: float = 20.0
    tracker_deg: float = 5.0


@dataclass(frozen=True)
class Room:
    """All of it."""

    head: HeadPose
    floor: Floor
    tracker: Tracker | None = None
    tool: Tool = field(default_factory=Tool)
    camera: Camera = field(default_factory=Camera)
    boxes: tuple[Box, ...] = ()
    capsules: tuple[Capsule, ...] = ()
    arm_bodies: tuple[tuple[int, Capsule], ...] = ()
    """Capsules about links of the arm, with the link's number, that replace the arm's own.

    Links count as before any joint was held.
    """
    margins: Margins = field(default_factory=Margins)
    parking: Parking = field(default_factory=Parking)
    reference_deg: tuple[float, ...] = (0.0, -120.0, 120.0, 0.0, 60.0, 0.0)
    """The posture to start from, to end in, and to go by where no straight way is free; joint 1 from the head."""


def base_pose(place: FloatArray) -> FloatArray:
    """Return room from base (4, 4) for x, y, z (mm) and turn (degrees) (4,)."""
    turn = np.radians(place[3])
    c, s = np.cos(turn), np.sin(turn)
    return rigid(np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]), place[:3].copy())


def base_place(room_from_base: FloatArray) -> FloatArray:
    """Return x, y, z (mm) and turn (degrees) (4,) of an upright base (4, 4)."""
    return np.array([*room_from_base[:3, 3], np.degrees(np.arctan2(room_from_base[1, 0], room_from_base[0, 0]))])
