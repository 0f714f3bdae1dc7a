"""The robot at its place, what stands in the room, and how far the arm reaches: for the eye."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING, Final

import numpy as np

from ronnaplan.geometry import FloatArray
from ronnaplan.scene.shapes import Body, ball, box, joined, moved, tube
from ronnaplan.scene.things import Thing, rgb
from ronnaplan.transforms import invert

if TYPE_CHECKING:
    from ronnaplan.documents.placement import PlacementDocument
    from ronnaplan.documents.room import BoxEntry, CapsuleEntry
    from ronnaplan.scene.vtk import Workshop

ROBOT_COLOUR: Final = "#f57c00"
ROOM_COLOUR: Final = "#78909c"
REACH_COLOUR: Final = "#4fc3f7"
OTHER_COLOUR: Final = "#ffcc80"
TRACKER_MM: Final = 60.0
"""Radius of the ball that stands for the tracker, or for a base that is an alternative."""
REACH_SIDES: Final = 72
LINE_MM: Final = 6.0
"""The circle that the arm reaches to is drawn with so many sides, as a tube of this radius."""
SHAPE: Final = (600, 1000)
"""Rows and columns of the picture."""
FROM: Final = np.array([-0.55, -0.65, 0.52])
"""From what is shown to the eye, in the room."""


def robot_things(placement: PlacementDocument) -> list[Thing]:
    """Return the robot at the best place, room, reach and the other places' bases, in the scan's coordinates.

    Empty where the placement is blocked, or does not hold them.
    """
    if not placement.robot_from_ct or placement.room is None:
        return []
    best = placement.robot_from_ct[0]
    ct_from_room = invert(np.array(best.room_from_r) @ np.array(best.r_from_ct))
    shown = []
    if best.robot is not None:
        robot = [_capsule(one) for one in best.robot.bodies] + [_box(one) for one in best.robot.trolley]
        reach = _ring(np.array(best.robot.shoulder), best.robot.reach)
        shown = [("robot", robot, ROBOT_COLOUR, 1.0), ("robot reach", [reach], REACH_COLOUR, 0.8)]
    things = [_box(one) for one in placement.room.boxes] + [_capsule(one) for one in placement.room.capsules]
    if placement.room.tracker is not None:
        things.append(ball(placement.room.tracker, TRACKER_MM))
    others = [ball(np.array(one.room_from_r)[:3, 3], TRACKER_MM) for one in placement.robot_from_ct[1:]]
    shown += [("robot room", things, ROOM_COLOUR, 0.5), ("robot other places", others, OTHER_COLOUR, 1.0)]
    return [
        Thing(name, moved(joined(bodies), ct_from_room), rgb(colour), opacity)
        for name, bodies, colour, opacity in shown
        if bodies
    ]


def in_room(placement: PlacementDocument, things: Sequence[Thing]) -> list[Thing]:
    """Return things of the scan's coordinates as they lie in the room, where up is up."""
    best = placement.robot_from_ct[0]
    room_from_ct = np.array(best.room_from_r) @ np.array(best.r_from_ct)
    return [replace(one, body=moved(one.body, room_from_ct)) for one in things]


def still_png(workshop: Workshop, placement: PlacementDocument, things: Sequence[Thing] = ()) -> bytes:
    """Return a picture (PNG) of the robot with things of the scan's coordinates, empty where there is no robot."""
    from ronnaplan.scene import portrait

    robot = robot_things(placement)
    return portrait.still_png(workshop, in_room(placement, [*robot, *things]), SHAPE, FROM) if robot else b""


def _capsule(one: CapsuleEntry) -> Body:
    start, end = np.array(one.start), np.array(one.end)
    caps = [ball(start, one.radius), ball(end, one.radius)]
    long_enough = float(np.linalg.norm(end - start)) > 1.0
    return joined([tube(np.stack([start, end]), one.radius), *caps] if long_enough else caps)


def _box(one: BoxEntry) -> Body:
    return box(one.center, one.size, one.turn_deg)


def _ring(shoulder_mm: FloatArray, reach_mm: float) -> Body:
    """Return the circle about the shoulder that the arm reaches, stretched."""
    angle = 2 * np.pi * np.arange(REACH_SIDES + 1) / REACH_SIDES
    around = reach_mm * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    return joined([tube(np.stack(pair), LINE_MM) for pair in pairwise(shoulder_mm + around)])
