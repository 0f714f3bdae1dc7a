"""The arm with what its flange carries as a tuple of arrays, which the compiled kernels take; mm and rad."""

from __future__ import annotations

from collections.abc import Sequence
from math import floor
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from kernelcache import njit
from ronnaplan.errors import InputError
from ronnaplan.geometry import FloatArray, unit
from ronnaplan.robot.arm.arm import Body, SerialArm
from ronnaplan.robot.arm.forward import link_frames
from ronnaplan.robot.arm.links import place_links
from ronnaplan.robot.arm.wrist import Wrist, wrist_of
from ronnaplan.robot.placement.distances import segment_segment
from ronnaplan.robot.placement.room import Capsule, Room
from ronnaplan.robot.placement.world import box_rows, capsule_row, moved_row

CLEAR_LINKS = 3
"""Bodies of links with so many joints between them are kept clear of each other.

Of nearer ones only what the flange carries is, and only from overlapping, as capsules of links that few joints part may
overlap in every posture. Of the arm itself the maker's limits or its controller keep those apart, but neither knows the
tool or its instruments.
"""
SAMPLED = 512
"""In so many postures between the limits of the joints two bodies are apart in one, if ever: two joints part them."""
PARTED_MM = 10.0
"""Two bodies that are nowhere so far apart are drawn so, and not kept apart."""

NO_INSTRUMENTS = np.empty((0, 7))
FREE, CLEAR, APART = range(3)
"""How two bodies are kept from each other: not at all, by the clearance that is asked for, or from overlapping."""


class Machine(NamedTuple):
    """The arm with what its flange carries. Bodies are in their links' frames; the last ones are the tool's."""

    wrist: Wrist
    origins: FloatArray
    axes: FloatArray
    links: NDArray[np.int64]
    bodies: FloatArray
    """Capsules (K, 7)."""
    tool_from: int
    """Bodies from this one on belong to the tool."""
    kept: NDArray[np.int8]
    """How each body, and the instrument as the last one, is kept from those before it (K + 1, K)."""
    trolley: FloatArray
    """Boxes (V, 8) in the base's frame."""
    marker: FloatArray
    """Place and normal (2, 3) of the tool's marker, in the last link."""


def machine_of(arm: SerialArm, room: Room, instruments: FloatArray = NO_INSTRUMENTS) -> Machine:
    """Return the robot with the room's tool, for ``instruments`` (T, 7) in the last link's frame.

    An instrument of no radius is none. A link that any of them is drawn into is kept from none of them. Raises
    `InputError` for an arm that has no closed form, no bodies, or cannot stand in the room's reference posture.
    """
    wrist = wrist_of(arm)
    _require_posture(arm, room.reference_deg)
    machine = unchecked_machine(arm, room, wrist, instruments)
    _require_apart(machine, arm, room)
    return machine


def unchecked_machine(
    arm: SerialArm, room: Room, wrist: Wrist, instruments: FloatArray = NO_INSTRUMENTS
) -> Machine:
    """Return what `machine_of` does of the arm's ``wrist`` and instruments (T, 7), whatever posture it starts from."""
    links, bodies, tool_from = bodies_of(arm, room)
    carriers = np.append(links, len(arm))  # the instrument goes with the last link
    marker = np.zeros((2, 3))
    if room.tool.marker is not None:
        marker[0] = arm.flange[:3, :3] @ np.array(room.tool.marker.at_mm) + arm.flange[:3, 3]
        marker[1] = arm.flange[:3, :3] @ unit(room.tool.marker.normal)
    machine = Machine(
        wrist,
        np.ascontiguousarray(arm.origins),
        np.ascontiguousarray(arm.axes),
        links,
        bodies,
        tool_from,
        np.where(carriers[:, None] - links >= CLEAR_LINKS, CLEAR, FREE).astype(np.int8),
        box_rows(room.floor.trolley),
        marker,
    )
    low, high = wrist.limits.T
    postures = np.random.default_rng(0).uniform(low, high, (SAMPLED, len(low)))
    of_tool = carried_distances(machine, bodies[tool_from:], postures).max(axis=0)
    of_instruments = carried_distances(machine, instruments[instruments[:, 6] > 0.0], postures).max(axis=0)
    parted = np.vstack([of_tool, of_instruments.min(axis=0, initial=np.inf)]) >= PARTED_MM
    kept = machine.kept[tool_from:, :tool_from]
    kept[parted & (kept == FREE)] = APART
    return machine


def bodies_of(arm: SerialArm, room: Room) -> tuple[NDArray[np.int64], FloatArray, int]:
    """Return the links (K,) of all bodies, these in their links' frames (K, 7), and from which on they are the tool's.

    Raises `InputError` for an arm that has none.
    """
    of_links = [
        (body.link, np.array([*body.start_mm, *body.end_mm, body.radius_mm]))
        for body in clad(arm, room.arm_bodies).bodies
    ]
    if not of_links:
        raise InputError(
            f"the links of {arm.name} have no simple shapes; state capsules as [[arm_body]] in the room (`robot place "
            "--example --arm FILE` draws them from joint to joint, to be measured)"
        )
    carried = [(len(arm), moved_row(arm.flange, capsule_row(one))) for one in room.tool.bodies]
    links, rows = zip(*of_links, *carried, strict=True)
    return np.array(links, dtype=np.int64), np.array(rows), len(of_links)


def body_names(arm: SerialArm, room: Room) -> tuple[str, ...]:
    """Return the names of all bodies, in the order of `bodies_of`."""
    return (*(one.name for one in clad(arm, room.arm_bodies).bodies), *(one.name for one in room.tool.bodies))


def how_near(apart_mm: float) -> str:
    """Say how near one body comes to another, rounded down, so that it never looks as if it were enough."""
    return f"comes within {floor(apart_mm)} mm of" if apart_mm >= 0.0 else "would meet"


def clad(arm: SerialArm, told: Sequence[tuple[int, Capsule]]) -> SerialArm:
    """Return the arm with the bodies that a room has ``told`` of, with each link's number, or else with its own."""
    if not told:
        return arm
    return arm.with_bodies(
        [Body(one.name, link, np.array(one.start_mm), np.array(one.end_mm), one.radius_mm) for link, one in told]
    )


def _require_posture(arm: SerialArm, reference_deg: Sequence[float]) -> None:
    """Raise `InputError` for a joint beyond its limits; joint 1 counts from the tasks, and is kept within its own."""
    told = zip(arm.joints, reference_deg, arm.limits_rad.tolist(), strict=True)
    for number, (joint, angle, (least, greatest)) in list(enumerate(told, start=1))[1:]:
        if not least <= np.radians(angle) <= greatest:
            raise InputError(
                f"reference_deg in the room has {angle:g} degrees for joint {number} of {arm.name}, {joint}; expected "
                f"{np.degrees(least):.1f} to {np.degrees(greatest):.1f}"
            )


def _require_apart(machine: Machine, arm: SerialArm, room: Room) -> None:
    """Raise `InputError` where the robot meets itself in the reference posture, from which no way then leads.

    What stands on the base is left out: how joint 1 stands to it is told by the tasks.
    """
    names = body_names(arm, room)
    (here,) = _distances_mm(machine, arm, np.radians([room.reference_deg]))
    for k, j in np.argwhere((machine.kept[:-1] != FREE) & (machine.links > 0)).tolist():
        need = room.margins.clearance_mm if machine.kept[k, j] == CLEAR else 0.0
        if here[k, j] >= need:
            continue
        low, high = machine.wrist.limits.T
        postures = np.random.default_rng(0).uniform(low, high, (SAMPLED, len(arm)))
        greatest = float(_distances_mm(machine, arm, postures)[:, k, j].max())
        if greatest < need:
            raise InputError(
                f"{names[k]} {how_near(greatest)} {names[j]} in {SAMPLED} postures between the joints' limits, as both "
                f"are drawn; {need:g} mm are asked for: draw them more closely, with smaller radii or more capsules"
            )
        asked = f"{need:g} mm apart" if need else "apart"
        raise InputError(
            f"in the posture reference_deg of the room {names[k]} {how_near(here[k, j])} {names[j]}, so that no way "
            f"leads from it; state a posture in which they are {asked}"
        )


def _distances_mm(machine: Machine, arm: SerialArm, postures: FloatArray) -> FloatArray:
    """Return how far each body is from those before it in ``postures`` (P, 6), rad: (P, K, K), of others infinite."""
    frames = link_frames(arm, postures)
    found = np.full((len(postures), len(machine.links), len(machine.links)), np.inf)
    for p, here in enumerate(frames):
        placed = [moved_row(here[link], row) for link, row in zip(machine.links, machine.bodies, strict=True)]
        for k, j in np.argwhere(machine.kept[:-1] != FREE).tolist():
            found[p, k, j] = segment_segment(placed[k], placed[j]) - placed[k][6] - placed[j][6]
    return found


@njit(cache=True, nogil=True, error_model="numpy")
def moved_capsule(pose: FloatArray, capsule: FloatArray, moved: FloatArray) -> None:
    """Fill ``moved`` (7,) with ``capsule`` (7,) brought by ``pose`` (4, 4)."""
    for a in range(3):
        for end in (0, 3):
            moved[end + a] = pose[a, 3]
            for b in range(3):
                moved[end + a] += pose[a, b] * capsule[end + b]
    moved[6] = capsule[6]


@njit(cache=True, nogil=True, error_model="numpy")
def frames_on(machine: Machine, base: FloatArray) -> FloatArray:
    """Return room for the frames (N + 1, 4, 4) of base and links, the first filled with ``base`` (4, 4)."""
    frames = np.empty((len(machine.axes) + 1, 4, 4))
    for a in range(4):
        for b in range(4):
            frames[0, a, b] = base[a, b]
    return frames


@njit(cache=True, nogil=True, error_model="numpy")
def place_bodies(machine: Machine, instrument: FloatArray, frames: FloatArray, bodies: FloatArray) -> None:
    """Fill ``bodies`` (K + 1, 7) with the capsules in the room, the instrument (7,) last; ``frames`` (N + 1, 4, 4)."""
    for k in range(len(machine.links)):
        moved_capsule(frames[machine.links[k]], machine.bodies[k], bodies[k])
    moved_capsule(frames[-1], instrument, bodies[-1])


@njit(cache=True, nogil=True, error_model="numpy")
def carried_distances(machine: Machine, carried: FloatArray, postures: FloatArray) -> FloatArray:
    """Return the distances (P, C, A) of capsules (C, 7) on the last link from the arm's in ``postures`` (P, 6), rad."""
    frames, bodies = np.zeros((len(machine.axes) + 1, 4, 4)), np.empty((len(machine.links) + 1, 7))
    none, one = np.zeros(7), np.empty(7)
    for a in range(4):
        frames[0, a, a] = 1.0
    apart = np.empty((len(postures), len(carried), machine.tool_from))
    for p in range(len(postures)):
        place_links(machine.origins, machine.axes, postures[p], frames)
        place_bodies(machine, none, frames, bodies)
        for k in range(len(carried)):
            moved_capsule(frames[-1], carried[k], one)
            for j in range(machine.tool_from):
                apart[p, k, j] = segment_segment(one, bodies[j]) - one[6] - bodies[j, 6]
    return apart
