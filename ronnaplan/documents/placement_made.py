"""What placement.json says of a placement that was found."""

from __future__ import annotations

from typing import Any

import numpy as np

from ronnaplan.documents.fiducials import Source
from ronnaplan.documents.placement import PathEntry, PlacementDocument
from ronnaplan.documents.reading import made
from ronnaplan.geometry import FloatArray, Points, unit
from ronnaplan.planning import Plan
from ronnaplan.robot.arm.arm import SerialArm
from ronnaplan.robot.arm.forward import forward, link_frames
from ronnaplan.robot.arm.wrist import center_mm, reach_mm, shoulder_mm, wrist_of
from ronnaplan.robot.placement.machine import bodies_of
from ronnaplan.robot.placement.placement import Place, Placement
from ronnaplan.robot.placement.room import Box, Room, Tool, base_place
from ronnaplan.robot.placement.serving import Served
from ronnaplan.robot.placement.world import moved_row
from ronnaplan.transforms import transform_points


def placement_document(
    found: Placement,
    room: Room,
    arm: SerialArm,
    source: Source,
    plan: Plan | None = None,
    *,
    markers: Points | None = None,
    parked: bool = False,
    notes: tuple[str, ...] = (),
) -> PlacementDocument:
    """Turn a placement for a ``plan`` and ``markers`` into its document; ``parked``: the base was measured."""
    content: dict[str, Any] = {
        "status": ("parked" if parked else "placed") if found.places else "blocked",
        "source": source.model_dump(),
        "trajectories": [PathEntry.of(one).model_dump() for one in plan or ()],
        "markers": [
            {"label": label, "center": center.tolist()}
            for label, center in (zip(markers.labels, markers.positions_mm, strict=True) if markers else ())
        ],
        "standoff_mm": room.tool.standoff_mm,
        "arm": arm.name,
        "links": {"base": arm.base_link, "flange": arm.flange_link},
        "joints": arm.joints if arm.held else None,
        "held": [
            {"joint": one.joint, "angle_deg": round(float(np.degrees(one.angle_rad)), 9)} for one in arm.held
        ],
        "parking": {"sigma_mm": room.parking.sigma_mm, "sigma_deg": room.parking.sigma_deg},
        "robot_from_ct": [_place(found, place, arm, room) for place in found.places],
        "room": {
            "boxes": [_box(one) for one in room.boxes],
            "capsules": [
                _capsule(one.name, np.array([*one.start_mm, *one.end_mm, one.radius_mm])) for one in room.capsules
            ],
            "tracker": None if room.tracker is None else room.tracker.position_mm,
        },
        "blocked": list(found.blocked),
        "notes": notes,
    }
    return made(PlacementDocument, content)


def _place(found: Placement, place: Place, arm: SerialArm, room: Room) -> dict[str, Any]:
    route = place.route
    return {
        "r_from_ct": found.r_from_ct(place).tolist(),
        "room_from_r": place.room_from_r.tolist(),
        "worst_margin_deg": place.worst_joint_deg,
        "probability": place.probability,
        "tasks": [_served(one, arm, room.tool) for one in place.served],
        "robot": _robot(arm, room, place),
        "route": {
            "order": route.order,
            "travel_deg": route.travel_deg,
            "reference_deg": tuple(route.reference_deg.tolist()),
            "by_reference": route.by_reference,
            "stuck": route.stuck,
        },
        "near": place.near,
        "at_reference": place.at_reference,
    }


def _robot(arm: SerialArm, room: Room, place: Place) -> dict[str, Any]:
    """Return the robot at ``place`` as capsules and boxes of the room."""
    wrist = wrist_of(arm)
    frames = place.room_from_r @ link_frames(arm, np.radians(place.route.reference_deg)[None])[0]
    tool_mm = float(np.linalg.norm(np.array(room.tool.start_mm) - center_mm(wrist)))
    links, bodies, _ = bodies_of(arm, room)
    rows = [moved_row(frames[link], row) for link, row in zip(links, bodies, strict=True)]
    turn = base_place(place.room_from_r)[3]
    return {
        "bodies": [_capsule(f"body {n}", row) for n, row in enumerate(rows, 1)],
        "trolley": [
            {
                **_box(one),
                "center": tuple(transform_points(place.room_from_r, np.array([one.center_mm]))[0].tolist()),
                "turn_deg": float((one.turn_deg + turn + 180.0) % 360.0 - 180.0),
            }
            for one in room.floor.trolley
        ],
        "shoulder": tuple(transform_points(place.room_from_r, shoulder_mm(wrist)[None])[0].tolist()),
        "reach": float(np.hypot(reach_mm(wrist), wrist.beside)) + tool_mm,
    }


def _capsule(name: str, row: FloatArray) -> dict[str, Any]:
    start, end, radius = row[:3].tolist(), row[3:6].tolist(), float(row[6])
    return {"name": name, "start": tuple(start), "end": tuple(end), "radius": radius}


def _box(one: Box) -> dict[str, Any]:
    return {"name": one.name, "center": one.center_mm, "size": one.size_mm, "turn_deg": one.turn_deg}


def _served(one: Served, arm: SerialArm, tool: Tool) -> dict[str, Any]:
    return {
        "name": one.name,
        "kind": one.kind,
        "joints_deg": [tuple(row) for row in one.angles_deg.tolist()],
        "joint_margin_deg": one.joint_deg,
        "singularity_deg": one.singularity_deg,
        "clearance_mm": one.clearance_mm,
        "tracker_deg": one.tracker_deg if np.isfinite(one.tracker_deg) else None,
        "x_axis": _x_axis(one, arm, tool) if one.kind == "trajectory" else None,
    }


def _x_axis(one: Served, arm: SerialArm, tool: Tool) -> tuple[float, ...] | None:
    """Return where the tool's x axis points in R (3,) along a trajectory, by the angles that are told with it."""
    if tool.x_axis is None:
        return None
    z = unit(tool.direction)
    x = unit(tool.x_axis)
    turned = forward(arm, np.radians(one.angles_deg[-1]))[:3, :3] @ unit(x - z * (x @ z))
    return tuple(turned.tolist())
