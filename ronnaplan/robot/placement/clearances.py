"""What a posture comes near to, and whether the tracker sees its tool; compiled."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from kernelcache import njit
from ronnaplan.geometry import FloatArray
from ronnaplan.robot.arm.links import invert_into, place_links
from ronnaplan.robot.placement.distances import box_box, point_box, segment_box, segment_point, segment_segment
from ronnaplan.robot.placement.machine import APART, FREE, Machine, frames_on, place_bodies
from ronnaplan.robot.placement.world import (
    BEAM,
    CLEARANCE_NEED,
    FARTHEST,
    NEAREST,
    OWN_BODY,
    VIEW_NEED,
    WIDEST,
    World,
)

HEAD, ROOM = -1, -2
"""What a body comes near to, where it is no other body."""


class Standing(NamedTuple):
    """A base on which the machine stands, and what `posture_margins` fills there."""

    from_room: FloatArray
    """The base from the room: the upper rows of (4, 4)."""
    trolley: FloatArray
    """Boxes (V, 8) in the room."""
    frames: FloatArray
    """Room from base and links (N + 1, 4, 4), of which the first is given."""
    bodies: FloatArray
    """Capsules (K + 1, 7) in the room, the instrument last."""
    pair: NDArray[np.int64]
    """The two (2,) that are nearest to each other, by `clearance`."""


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def to_head(world: World, capsule: FloatArray, enough: float) -> float:
    """Return the distance (mm) between a capsule (7,) and the head, or ``enough`` where that is less."""
    radius, least = capsule[6], enough
    if segment_point(capsule, world.head_ball) - world.head_ball[3] - radius >= enough:
        return enough
    for g in range(len(world.gathered)):
        if segment_point(capsule, world.gathered[g]) - world.gathered[g, 3] - radius >= least:
            continue
        for n in range(world.firsts[g], world.firsts[g + 1]):
            least = min(least, segment_point(capsule, world.head[n]) - world.head[n, 3] - radius)
    return least


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def to_things(world: World, capsule: FloatArray, trolley: FloatArray, enough: float) -> float:
    """Return the distance (mm) between a capsule (7,) and the nearest thing of room and trolley, or ``enough``."""
    radius, least = capsule[6], enough
    for n in range(len(world.boxes)):
        least = min(least, segment_box(capsule, world.boxes[n], least + radius) - radius)
    for n in range(len(trolley)):
        least = min(least, segment_box(capsule, trolley[n], least + radius) - radius)
    for n in range(len(world.capsules)):
        least = min(least, segment_segment(capsule, world.capsules[n]) - world.capsules[n, 6] - radius)
    return least


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def to_room(world: World, capsule: FloatArray, trolley: FloatArray, high: bool, enough: float) -> float:
    """Return the distance (mm) to what stands in the room; of what is ``high`` on the arm, to trolley and floor too.

    Distances above ``enough`` are not told apart.
    """
    if not high:
        return to_things(world, capsule, trolley[:0], enough)
    least: float = min(min(capsule[2], capsule[5]) - capsule[6], to_things(world, capsule, trolley, enough))
    return least


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def is_high(machine: Machine, body: int) -> bool:
    """Whether a body is kept from trolley and floor: all are but those of the two lowest links, which stand there."""
    high: bool = body >= machine.tool_from or machine.links[body] >= 2
    return high


@njit(cache=True, nogil=True, error_model="numpy")
def clearance(
    machine: Machine,
    world: World,
    trolley: FloatArray,
    bodies: FloatArray,
    need: float,
    enough: float,
    pair: NDArray[np.int64],
) -> float:
    """Return the least distance (mm) that counts; below ``need`` the search ends and ``pair`` (2,) names the two.

    Distances above ``enough`` are not told apart. The instrument is kept from everything but the head.
    """
    count = len(machine.links)
    least = enough
    for back in range(count + 1):
        k = count - back
        if k == count and bodies[k, 6] <= 0.0:
            continue
        near = to_room(world, bodies[k], trolley, is_high(machine, k), least)
        if near < least:
            least, pair[0], pair[1] = near, k, ROOM
        if k < count:
            near = to_head(world, bodies[k], least)
            if near < least:
                least, pair[0], pair[1] = near, k, HEAD
        for j in range(k):
            if machine.kept[k, j] == FREE:
                continue
            near = segment_segment(bodies[k], bodies[j]) - bodies[k, 6] - bodies[j, 6]
            if near < least and (near < 0.0 or machine.kept[k, j] != APART):
                least, pair[0], pair[1] = near, k, j
        if least < need:
            break
    return least


@njit(cache=True, nogil=True, error_model="numpy")
def seen(machine: Machine, world: World, trolley: FloatArray, frame: FloatArray, bodies: FloatArray) -> float:
    """Return by how much (rad) the tool's marker, on the last link at ``frame``, is seen; negative: hidden or far."""
    if world.sight[FARTHEST] == 0.0:
        return np.inf
    line = np.zeros(7)
    cosine = away = 0.0
    for a in range(3):
        line[a] = frame[a, 3]
        for b in range(3):
            line[a] += frame[a, b] * machine.marker[0, b]
        line[3 + a] = world.tracker[a]
        away += (line[3 + a] - line[a]) ** 2
    away = np.sqrt(away)
    if not world.sight[NEAREST] <= away <= world.sight[FARTHEST]:
        return -1.0
    for a in range(3):
        for b in range(3):
            cosine += frame[a, b] * machine.marker[1, b] * (line[3 + a] - line[a]) / away
    margin: float = world.sight[WIDEST] - np.arccos(min(max(cosine, -1.0), 1.0))
    if margin < world.needs[VIEW_NEED]:
        return margin
    for a in range(3):
        line[3 + a] -= (line[3 + a] - line[a]) * min(world.sight[OWN_BODY] / away, 1.0)
    line[6] = world.sight[BEAM]
    return -1.0 if _is_crossed(machine, world, trolley, line, bodies) else margin


@njit(cache=True, nogil=True, error_model="numpy")
def _is_crossed(machine: Machine, world: World, trolley: FloatArray, line: FloatArray, bodies: FloatArray) -> bool:
    """Whether anything stands in a line of sight (7,) from the tool's marker.

    Tool and wrist are always near it: they are kept out of the line alone, not out of what is free about it, and
    such as are drawn around the marker itself do not count.
    """
    if to_things(world, line, trolley, 0.0) < 0.0 or to_head(world, line, 0.0) < 0.0:
        return True
    for k in range(len(machine.links)):
        apart = segment_segment(line, bodies[k]) - bodies[k, 6]
        if machine.links[k] < len(machine.axes) - 1:
            if apart < line[6]:
                return True
        elif apart < 0.0 <= segment_point(bodies[k], line) - bodies[k, 6]:
            return True
    return False


@njit(cache=True, nogil=True, error_model="numpy")
def posture_margins(
    machine: Machine,
    world: World,
    standing: Standing,
    instrument: FloatArray,
    angles: FloatArray,
    enough: float,
    tracked: bool,
) -> tuple[float, float]:
    """Return clearance (mm) and the tracker's margin (rad) of ``angles`` (6,), with an ``instrument`` (7,).

    Clearances above ``enough`` are not told apart; where nothing is ``tracked``, the margin is infinite.
    """
    trolley, bodies = standing.trolley, standing.bodies
    place_links(machine.origins, machine.axes, angles, standing.frames)
    place_bodies(machine, instrument, standing.frames, bodies)
    view = seen(machine, world, trolley, standing.frames[-1], bodies) if tracked else np.inf
    if view < world.needs[VIEW_NEED]:
        return np.inf, view
    return clearance(machine, world, trolley, bodies, world.needs[CLEARANCE_NEED], enough, standing.pair), view


@njit(cache=True, nogil=True, error_model="numpy")
def parked(world: World, trolley: FloatArray) -> bool:
    """Whether the trolley's boxes (V, 8), in the room, keep clear of what stands there."""
    need = world.needs[CLEARANCE_NEED]
    for v in range(len(trolley)):
        for n in range(len(world.boxes)):
            if box_box(trolley[v], world.boxes[n]) < need:
                return False
        for n in range(len(world.capsules)):
            if segment_box(world.capsules[n], trolley[v], np.inf) - world.capsules[n, 6] < need:
                return False
        for g in range(len(world.gathered)):
            if point_box(world.gathered[g], trolley[v]) - world.gathered[g, 3] >= need:
                continue
            for n in range(world.firsts[g], world.firsts[g + 1]):
                if point_box(world.head[n], trolley[v]) - world.head[n, 3] < need:
                    return False
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def place_trolley(machine: Machine, base: FloatArray) -> FloatArray:
    """Return the trolley's boxes (V, 8) in the room, for an upright ``base`` (4, 4), room from base."""
    placed = machine.trolley.copy()
    c, s = base[0, 0], base[1, 0]
    for v in range(len(placed)):
        box = machine.trolley[v]
        placed[v, 0] = base[0, 3] + c * box[0] - s * box[1]
        placed[v, 1] = base[1, 3] + s * box[0] + c * box[1]
        placed[v, 2] = base[2, 3] + box[2]
        placed[v, 6], placed[v, 7] = c * box[6] - s * box[7], s * box[6] + c * box[7]
    return placed


@njit(cache=True, nogil=True, error_model="numpy")
def standing_on(machine: Machine, base: FloatArray) -> Standing:
    """Return the machine's standing on an upright ``base`` (4, 4), room from base."""
    from_room = np.zeros((4, 4))
    invert_into(from_room, base)
    bodies, pair = np.empty((len(machine.links) + 1, 7)), np.zeros(2, dtype=np.int64)
    return Standing(from_room, place_trolley(machine, base), frames_on(machine, base), bodies, pair)
