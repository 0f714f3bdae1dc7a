"""A simulated room's chain, and what tracker and robot read in one moment of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from phantoms.live_room import LiveRoom
from phantoms.robot_session import M_SPHERES_MM, READING_SD_MM
from ronnaplan.geometry import Frame, Points
from ronnaplan.pose import Pose
from ronnaplan.registration import register_points
from ronnaplan.robot.chain import OTS, TCP, Capture, M
from ronnaplan.robot.live import LiveChain
from ronnaplan.robot.recorded import robot_pose, seen_tool
from ronnaplan.tracking import Recording
from ronnaplan.tracking.recording import PointReading, ToolReading

CASE = Path(__file__).resolve().parents[2] / "data" / "synthetic_ct"
FRAMES = 10


def recording(room: LiveRoom, frames: int = FRAMES, robot: bool = True) -> Recording:
    points = [PointReading(k, place) for k in range(frames) for place in room.head_mm()[::-1]]
    tools = [ToolReading(k, "tool", room.tool()) for k in range(frames)]
    driven = [
        ToolReading(k, "robot", room.session.told(room.robot_from_tcp)) for k in range(frames if robot else 0)
    ]
    return Recording("simulated", tuple(points), (*tools, *driven))


def live(room: LiveRoom, **options: object) -> LiveChain:
    session = room.session
    spread = np.tile(READING_SD_MM**2 * np.eye(3), (len(session.labels), 1, 1))
    head = Points(np.mean([room.head_mm() for _ in range(FRAMES)], axis=0), spread, session.labels, OTS)
    ct_from_ots = np.linalg.inv(session.ots_from_ct)
    ct = session.markers_ots_mm @ ct_from_ots[:3, :3].T + ct_from_ots[:3, 3]
    scan = Frame("CT", "1.2.3")
    registered = register_points(
        ct, head.positions_mm, (0.01 * spread, spread), moving_frame=scan, fixed_frame=OTS
    )
    tool = Points(M_SPHERES_MM, np.tile(0.01**2 * np.eye(3), (4, 1, 1)), tuple("ABCD"), M)
    still = recording(room, robot=False)
    calibrated = Pose(session.m_from_tcp, np.diag([3e-4**2] * 3 + [0.1**2] * 3), M, TCP)
    capture = Capture(
        seen_tool(still, tool, sigma_mm=READING_SD_MM), calibrated, robot_pose(session.told(room.robot_from_tcp))
    )
    settings: dict[str, object] = {"robot_device": "robot", "sigma_mm": READING_SD_MM, **options}
    settings = {"tool_device": "tool", **settings}
    return LiveChain(head, registered.pose, capture, tool, **settings)  # type: ignore[arg-type]
