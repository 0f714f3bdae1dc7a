"""A robot and a head before a tracker, streamed over OpenIGTLink (messages packed by pyigtl), with movements told.

``python -m phantoms.live_room CASE PORT`` serves the session that `phantoms.robot_session` recorded about CASE: 10 s at
rest, 5 s with the head moved, 5 s with it back, 5 s with the robot's base moved. The tracker sends the head's markers
(POINT), the tool's pose (TRANSFORM ``tool``), the robot its own (TRANSFORM ``robot``), 20 times a second.
"""

from __future__ import annotations

import socket
import sys
import time
from argparse import ArgumentParser
from collections.abc import Iterable, Iterator
from contextlib import suppress
from copy import copy
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pyigtl

from phantoms.robot_session import READING_SD_MM, READINGS_TRUTH, Session, case_argument
from phantoms.solids import FloatArray

RATE_HZ = 20.0


@dataclass
class LiveRoom:
    """A session whose head, base and tracker can be moved, and whose arm stands at ``robot_from_tcp`` (4, 4)."""

    session: Session
    robot_from_tcp: FloatArray
    head_moved: FloatArray = field(default_factory=lambda: np.eye(4))
    """Of the head, in the tracker's coordinates at the registration (4, 4)."""
    base_moved: FloatArray = field(default_factory=lambda: np.eye(4))
    """Of the robot's base, likewise."""
    tracker_moved: FloatArray = field(default_factory=lambda: np.eye(4))
    """Of the tracker itself, likewise."""
    loose: int | None = None
    """A marker that is 4 mm beside its place."""

    @classmethod
    def of_case(cls, case: Path, seed: int = 11) -> LiveRoom:
        """Return the room of the phantom in ``case``, the arm beside the head."""
        session = Session.of_case(case, seed)
        return cls(session, session.about(session.beside_mm, 10))

    def head_mm(self) -> FloatArray:
        """Return one noisy reading (N, 3) of the head's markers."""
        places = self.session.markers_ots_mm.copy()
        if self.loose is not None:
            places[self.loose] += (0.0, 4.0, 0.0)
        seen = _mapped(np.linalg.inv(self.tracker_moved) @ self.head_moved, places)
        return seen + self.session.rng.normal(0, READING_SD_MM, seen.shape)

    def tool(self) -> FloatArray:
        """Return one noisy pose (4, 4) of the tool before the tracker."""
        ots_from_base = (
            np.linalg.inv(self.tracker_moved) @ self.base_moved @ np.linalg.inv(self.session.robot_from_ots)
        )
        moved = copy(self.session)  # with the same noise
        moved.robot_from_ots = np.linalg.inv(ots_from_base)
        return moved.tracked(self.robot_from_tcp)

    def messages(self, time_s: float) -> Iterator[bytes]:
        """Yield what tracker and robot send at one time."""
        yield pyigtl.PointMessage(positions=self.head_mm(), device_name="head", timestamp=time_s).pack()
        yield pyigtl.TransformMessage(self.tool(), device_name="tool", timestamp=time_s).pack()
        driven = self.session.told(self.robot_from_tcp)
        yield pyigtl.TransformMessage(driven, device_name="robot", timestamp=time_s).pack()


def serve(listener: socket.socket, rooms: Iterable[tuple[LiveRoom, float]], *, in_real_time: bool) -> None:
    """Send each room's messages for so many seconds to the first who connects and stays, by the clock or at once."""
    connection, _ = listener.accept()
    start_s, frame = time.time(), 0
    with connection, suppress(ConnectionError):
        for room, lasting_s in rooms:
            for _ in range(round(lasting_s * RATE_HZ)):
                if in_real_time:
                    time.sleep(max(start_s + frame / RATE_HZ - time.time(), 0.0))
                for message in room.messages(start_s + frame / RATE_HZ):
                    connection.sendall(message)
                frame += 1


def _mapped(matrix: FloatArray, places_mm: FloatArray) -> FloatArray:
    return np.asarray(places_mm @ matrix[:3, :3].T + matrix[:3, 3])


def _shifted(*by_mm: float) -> FloatArray:
    matrix = np.eye(4)
    matrix[:3, 3] = by_mm
    return matrix


def main(arguments: list[str]) -> None:
    """Serve the room as told on the command line."""
    parser = ArgumentParser("python -m phantoms.live_room", description="Serve a session live, over OpenIGTLink.")
    parser.add_argument(
        "case", metavar="CASE", type=case_argument, help=f"a phantom's folder with its {READINGS_TRUTH}"
    )
    parser.add_argument("port", metavar="PORT", type=int, help="where the first program that connects is served")
    told = parser.parse_args(arguments)
    room = LiveRoom.of_case(told.case)
    nodding, rolling = replace(room, head_moved=_shifted(2.0, 0, 0)), replace(room, base_moved=_shifted(0, 3.0, 0))
    with socket.create_server(("127.0.0.1", told.port)) as listener:
        serve(listener, [(room, 10.0), (nodding, 5.0), (room, 5.0), (rolling, 5.0)], in_real_time=True)


if __name__ == "__main__":
    main(sys.argv[1:])
