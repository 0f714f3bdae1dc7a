"""A room with a head, its holder, a table and a tracker, and trajectories and markers on the head."""

from __future__ import annotations

import numpy as np

from ronnaplan.geometry import FloatArray
from ronnaplan.robot.arm.kuka import kr6_r900
from ronnaplan.robot.placement.job import Job
from ronnaplan.robot.placement.room import Box, Capsule, Floor, HeadPose, Room, Tool, ToolMarker, Tracker
from ronnaplan.robot.placement.tasks import drill_task, view_task
from ronnaplan.robot.placement.world import world_of

CENTER_MM = np.array([0.0, 0.0, 1050.0])
HEAD_MM = np.array([105.0, 78.0, 95.0])
"""Half axes: crown to chin, ear to ear, nose to nape."""


def room(**changes: object) -> Room:
    """Return the room, with the patient on the back and the crown towards -x."""
    tool = Tool(
        (0.0, 0.0, 120.0),
        bodies=(
            Capsule("holder", (0.0, 0.0, 20.0), (0.0, 0.0, 95.0), 25.0),
            Capsule("cameras", (0.0, -70.0, 20.0), (0.0, 70.0, 20.0), 35.0),
        ),
        marker=ToolMarker((0.0, 110.0, 10.0), (0.0, 1.0, -1.0), 75.0),
    )
    given: dict[str, object] = {
        "head": HeadPose((0.0, 0.0, 1050.0), (0.0, 0.0, 1.0), (-1.0, 0.0, 0.0)),
        "floor": Floor(
            (-1000.0, -500.0),
            (-800.0, 0.0),
            (850.0, 1000.0),
            trolley=(Box("trolley", (0.0, 0.0, -400.0), (500.0, 500.0, 800.0)),),
        ),
        "tracker": Tracker((-1800.0, 600.0, 1900.0)),
        "tool": tool,
        "boxes": (
            Box("table", (900.0, 0.0, 900.0), (1700.0, 500.0, 120.0)),
            Box("patient", (850.0, 0.0, 1030.0), (1400.0, 450.0, 220.0)),
        ),
        "capsules": (Capsule("head holder", (60.0, -90.0, 960.0), (60.0, 90.0, 960.0), 20.0),),
    }
    return Room(**{**given, **changes})  # type: ignore[arg-type]


def surface(rng: np.random.Generator) -> FloatArray:
    """Return places on the head."""
    out = rng.normal(size=(4000, 3))
    found: FloatArray = CENTER_MM + out / np.linalg.norm(out, axis=1, keepdims=True) * HEAD_MM
    return found


def direction(rng: np.random.Generator) -> FloatArray:
    """Return a direction towards forehead or crown."""
    while True:
        out = rng.normal(size=3)
        out /= np.linalg.norm(out)
        if out[2] > 0.15 and out[0] < -0.1:
            return out


def job(seed: int, trajectories: int, markers: int, **changes: object) -> Job:
    """Return a random job."""
    rng, place = np.random.default_rng(seed), room(**changes)
    head = surface(rng)
    tasks = []
    for n in range(trajectories):
        entry, target = CENTER_MM + direction(rng) * HEAD_MM, CENTER_MM + rng.uniform(-30, 30, 3)
        tasks.append(drill_task(f"T{n}", entry, target, place.tool, 180.0, 2.4))
    for n in range(markers):
        at = CENTER_MM + direction(rng) * (HEAD_MM + 12.0)
        tasks.append(view_task(f"M{n}", at, CENTER_MM, place.camera))
    tracker = None if place.tracker is None else np.array(place.tracker.position_mm)
    return Job(kr6_r900(), place, np.eye(4), tuple(tasks), world_of(place, head, tracker))
