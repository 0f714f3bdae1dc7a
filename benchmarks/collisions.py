"""The robot in its room put together from coal's own shapes, to hold clearances against."""

from __future__ import annotations

from typing import Any

import numpy as np

from ronnaplan.geometry import FloatArray
from ronnaplan.robot.placement.job import Job
from ronnaplan.robot.placement.search import Problem
from tests.robot.placement.cases import CENTER_MM, HEAD_MM

TOOL_AND_FOREARM = ((6, 4),)
"""Links with fewer than three joints between them that may not overlap: the wrist, link 5, is drawn into the tool, and
the instrument leaves that."""


class Peer:
    """The same room and robot, put together from coal's own shapes."""

    def __init__(self, given: Job, problem: Problem) -> None:
        import coal

        self.coal: Any = coal
        self.machine = problem.machine
        turned = given.room.boxes
        self.things = [(coal.Box(*one.size_mm), self._at(np.eye(3), np.array(one.center_mm))) for one in turned]
        self.things += [
            self._capsule(np.array([*one.start_mm, *one.end_mm, one.radius_mm])) for one in given.room.capsules
        ]
        self.floor = (coal.Box(1e5, 1e5, 1e3), self._at(np.eye(3), np.array([0.0, 0.0, -500.0])))
        self.head = (coal.Ellipsoid(*HEAD_MM), self._at(np.eye(3), CENTER_MM))
        instrument = problem.ways.instruments[0]
        self.bodies = [*problem.machine.bodies, instrument]
        self.links = [*problem.machine.links, 6]
        self.trolley = given.room.floor.trolley

    def touches(self, frames: FloatArray, base: FloatArray) -> bool:
        """Whether anything touches that counts, with the links at ``frames`` (7, 4, 4) in the room."""
        placed = [
            self._capsule(self._moved(frames[link], row))
            for link, row in zip(self.links, self.bodies, strict=True)
        ]
        under = [
            (self.coal.Box(*one.size_mm), self._at(base[:3, :3], (base @ [*one.center_mm, 1])[:3]))
            for one in self.trolley
        ]
        for k, (body, link) in enumerate(zip(placed, self.links, strict=True)):
            things = (
                self.things
                + ([*under, self.floor] if link >= 2 else [])
                + ([self.head] if k < len(placed) - 1 else [])
            )
            things += [
                placed[j]
                for j in range(k)
                if link - self.links[j] >= 3 or (link, self.links[j]) in TOOL_AND_FOREARM
            ]
            if any(self._meet(body, thing) for thing in things):
                return True
        return False

    def _meet(self, one: tuple[Any, Any], other: tuple[Any, Any]) -> bool:
        return bool(self.coal.collide(*one, *other, self.coal.CollisionRequest(), self.coal.CollisionResult()))

    def _at(self, turn: FloatArray, place: FloatArray) -> Any:
        return self.coal.Transform3s(np.ascontiguousarray(turn), np.asarray(place, dtype=np.float64))

    def _moved(self, frame: FloatArray, row: FloatArray) -> FloatArray:
        return np.array([*(row[:6].reshape(2, 3) @ frame[:3, :3].T + frame[:3, 3]).ravel(), row[6]])

    def _capsule(self, row: FloatArray) -> tuple[Any, Any]:
        axis = row[3:6] - row[:3]
        length = float(np.linalg.norm(axis))
        z = axis / length
        x = np.cross(np.eye(3)[int(np.abs(z).argmin())], z)
        x /= np.linalg.norm(x)
        return self.coal.Capsule(row[6], length), self._at(
            np.column_stack([x, np.cross(z, x), z]), row[:3] + axis / 2
        )
