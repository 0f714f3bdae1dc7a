"""A shaded sphere that was found, fitted again: in its own shadow, in any light, and before the ground near it.

Each goes on from where the sphere was found, at the same pixels or a part of them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ronnaplan.robot.stereo.shading import AGAIN, ShadedSphere, fit_sphere, result_of
from ronnaplan.robot.stereo.shading_compiled import ASIDE, COMMON, FALLING, LIGHT, OWN_LIGHT
from ronnaplan.robot.stereo.shading_pixels import OUTWARD_PX, beyond, within
from ronnaplan.robot.stereo.shading_steps import State

NEAR_PX, NEAR_BLURS = 2.0, 4.0
"""What is near a ball's edge is so far from it at most, and so many blurs more. Outside, the ground is level and slope
there, if not farther out; inside, any light is level and falls off to the limb."""


def in_own_shadow(found: ShadedSphere) -> ShadedSphere | None:
    """Return the sphere ``found`` as one that is partly in its own shadow, or None where it is none.

    What darkens as the cosine and light from aside are of one lamp, which lights nothing that faces away from it. Goes
    on from where the sphere was found, at the same pixels: what the limb shows on the dark side is taken to be there
    all around, and what it shows more on the bright side to be the lamp's.
    """
    pixels, before = found.fitted
    uneven = before.light[0] * found.light[:2] + found.light[2:4] * before.level
    light = np.zeros(COMMON - LIGHT)
    light[0] = before.light[0] - np.linalg.norm(uneven)
    light[1] = before.level - light[0]
    light[ASIDE - LIGHT : FALLING - LIGHT] = 2 * uneven
    state = replace(before, light=light, last=np.zeros(COMMON))
    fitted = fit_sphere(pixels, state, AGAIN, shadows=True)
    return None if fitted is None else result_of(pixels, state, fitted, found.expected, found.across, shadows=True)


def in_own_lights(found: ShadedSphere) -> ShadedSphere | None:
    """Return the sphere ``found`` by what is near its edge, in a light of each sector's own, or None where it is none.

    Of lamps that light parts of it each, and of what the room returns, no few constants tell. Near the edge their light
    is a level and what falls off to the limb; where along it shadows begin does not matter then.
    """
    pixels, before = found.fitted
    state = replace(before, owns=np.pad(before.owns, ((0, 0), (0, OWN_LIGHT))), last=np.zeros(COMMON))
    limb = beyond(pixels, before.geometry[:2], before.geometry[2] - _reach(before))
    fitted = fit_sphere(limb, state, AGAIN)
    return None if fitted is None else result_of(limb, state, fitted, found.expected, found.across, shadows=False)


def before_near_ground(found: ShadedSphere) -> ShadedSphere | None:
    """Return the sphere ``found`` by the ground near its edge only, or None: a shadow, or a pattern, is no slope."""
    pixels, before = found.fitted
    reach = _reach(before)
    if reach > OUTWARD_PX:
        return None
    near, state = (
        within(pixels, before.geometry[:2], before.geometry[2] + reach),
        replace(before, last=np.zeros(COMMON)),
    )
    fitted = fit_sphere(near, state, AGAIN)
    told = None if fitted is None else result_of(near, state, fitted, found.expected, found.across, shadows=False)
    return None if told is None else replace(told, by_ground=found.place - told.place)


def _reach(state: State) -> float:
    """Return how far from the edge of a sphere (px) is near it."""
    return NEAR_PX + NEAR_BLURS * float(state.geometry[4])
