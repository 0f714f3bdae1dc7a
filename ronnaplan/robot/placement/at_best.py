"""What a way keeps at best, from whatever base: clearance and view of what the flange carries, wherever the arm is.

With the flange, tool and instrument are where the way says, and so is the marker that the tracker sees. About half of
all rolls are ruled out by that alone, and none of their postures need be sought from any base.
"""

from __future__ import annotations

import numpy as np

from kernelcache import njit
from ronnaplan.geometry import FloatArray
from ronnaplan.robot.placement.clearances import clearance, seen
from ronnaplan.robot.placement.machine import Machine, place_bodies
from ronnaplan.robot.placement.tasks import Ways
from ronnaplan.robot.placement.world import CLEARANCE_NEED, VIEW_NEED, World
from ronnaplan.transforms import invert

ROUNDING = 1e-6
"""By so much (mm, rad) more is told, as the joints bring the flange to where it shall be but for less."""


def kept_at_best(machine: Machine, world: World, ways: Ways, flange: FloatArray) -> FloatArray:
    """Return the clearance (mm) and the tracker's margin (rad) of each of ``ways`` (N, 2), which no posture exceeds.

    ``flange`` (4, 4) is that in the last link. A way that cannot be gone has any value below what is asked for.
    """
    first = machine.tool_from
    carried = machine._replace(
        links=machine.links[first:],
        bodies=machine.bodies[first:],
        tool_from=0,
        kept=np.ascontiguousarray(machine.kept[first:, first:]),
        trolley=machine.trolley[:0],
    )
    kept = np.full((len(ways.flanges), 2), np.inf)
    _keep(carried, world, ways, invert(flange), kept)
    return kept + ROUNDING


@njit(cache=True, nogil=True, error_model="numpy")
def _keep(machine: Machine, world: World, ways: Ways, last_from_flange: FloatArray, kept: FloatArray) -> None:
    """Lessen ``kept`` (N, 2) to what is kept where no arm stands, up to the first pose that keeps too little."""
    frames, bodies = np.zeros((len(machine.axes) + 1, 4, 4)), np.empty((len(machine.links) + 1, 7))
    clear, view, pair = world.needs[CLEARANCE_NEED], world.needs[VIEW_NEED], np.empty(2, dtype=np.int64)
    for task in range(len(ways.steps)):
        for n in range(ways.firsts[task], ways.firsts[task + 1]):
            for p in range(ways.steps[task]):
                frames[-1] = ways.flanges[n, p] @ last_from_flange
                place_bodies(machine, ways.instruments[task], frames, bodies)
                kept[n, 1] = min(kept[n, 1], seen(machine, world, machine.trolley, frames[-1], bodies))
                if kept[n, 1] < view:
                    break
                away = clearance(machine, world, machine.trolley, bodies, clear, world.plenty[0], pair)
                kept[n, 0] = min(kept[n, 0], away)
                if away < clear:
                    break
