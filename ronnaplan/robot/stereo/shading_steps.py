"""One step of the fit of a shaded sphere: which sectors are believed, and how far its unknowns are moved."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ronnaplan.geometry import SD_PER_DEVIATION, FloatArray
from ronnaplan.robot.stereo.profiles_compiled import PROFILE
from ronnaplan.robot.stereo.shading_compiled import (
    ASIDE,
    BLUR,
    COMMON,
    FALLING,
    LIGHT,
    OVAL,
    OWN_GROUND,
    TILT,
    Flags,
)

FEWEST_PIXELS = 20
"""Sectors with fewer pixels, as beyond the image's border, know no edge."""
FIRST_EVERY = 3
FIRST_BLUR_PX, BLUR_SD_PX, BLUR_PX = 1.3, 0.5, (0.5, 4.0)
"""Standard deviation of the blur that is expected, how far it may be from that, and its bounds."""
LARGEST_STEP_PX = 1.5
"""One step changes nothing of the outline, but for its blur, by more."""
EARLY = 4
"""In the first steps the light is held simple, and spoilt sectors are told by large misfits only."""
SETTLED_SDS, SETTLED_PX = 0.05, 0.002
"""The outline is settled when it moves by less than this share of its standard deviation, or this."""
LARGEST_MISFITS = (2.5, 1.5)
"""Sectors that the model fits worse than the typical one by this factor are left out, first and later."""
OUTLIER_SDS = 4.0
"""Later, sectors whose edge is shifted by more standard deviations are left out, too."""
FLOOR_PX = 0.01
"""What the model of the sphere errs in a sector at best."""
CURVED_SD, ASIDE_SD, FALLING_SD, TILT_SD, WAVE_SD = 0.2, 0.3, 0.2, 0.5, 0.3
"""What is expected of the light, as shares of the brightness: the profile's curvature, light from aside, what of it
falls off to the limb, its tilt and its waves."""
HELD = 0.001
"""The same of what is held at none."""


@dataclass(eq=False)
class State:
    """What is known while fitting."""

    geometry: FloatArray
    """Place (2), radius, focal length and blur, px."""
    light: FloatArray
    """Unknowns (COMMON - LIGHT) of the whole sphere's light, in grey values but for its tilt."""
    owns: FloatArray
    """Each sector's own ground (level and slope), and its own light from aside (even, and falling off) or none: (S, 2)
    or (S, 4)."""
    kept: Flags
    """Sectors (S) that are believed."""
    noise: float
    """What the model leaves of a pixel, one standard deviation, in grey values."""
    level: float
    """How bright the middle of the sphere is, in grey values."""
    last: FloatArray
    """The step that was taken last."""


def judge(
    state: State, reduced: FloatArray, told: FloatArray, clipped: Flags, step: int, decided: int
) -> tuple[FloatArray, FloatArray]:
    """Return each sector's own shift of the edge (S) and its standard deviation, and choose which are kept.

    ``told`` (S, 3) is of the pixels that tell something, which of sectors that are ``clipped`` (S) are not all.
    """
    sharp, pixels = np.maximum(reduced[:, 2, 2], 1e-9), told[:, 0]
    shifts = reduced[:, 2, -1] / sharp
    misfits = np.sqrt(np.maximum(reduced[:, -1, -1], 0) / np.maximum(pixels - 2, 1))
    if step >= 2:
        typical = _typical(misfits, clipped, state.kept)
        state.noise = max(float(typical[state.kept].max()), 1e-3 * state.level)
        blinded = clipped & state.kept
        if blinded.any():
            edge, left = told[blinded, 1:].sum(axis=0)
            state.noise = max(state.noise, float(np.sqrt(left / max(edge, 1e-9))))
        good = misfits < LARGEST_MISFITS[step >= EARLY] * typical
        if step >= EARLY:
            deviations = np.abs(shifts) / np.hypot(state.noise / np.sqrt(sharp), FLOOR_PX)
            good &= deviations < OUTLIER_SDS * max(SD_PER_DEVIATION * _middle(deviations[state.kept]), 1.0)
        good &= pixels * (FIRST_EVERY if step < EARLY else 1) > FEWEST_PIXELS
        good = good & np.roll(good, 1) & np.roll(good, -1)  # what spoils a sector reaches into the next
        state.kept = good if step < decided else good & state.kept
    return shifts, state.noise / np.sqrt(sharp)


def _typical(misfits: FloatArray, clipped: Flags, kept: Flags) -> FloatArray:
    """Return the usual one of ``misfits`` (S) for each sector: of those that are ``clipped``, and of the others."""
    typical = np.empty(len(misfits))
    for part in (clipped, ~clipped):
        if part.any():
            of = part & kept
            typical[part] = _middle(misfits[of if of.any() else part])
    return typical


def advance(
    state: State, reduced: FloatArray, answers: FloatArray, step: int, shadows: bool, *, blunt: bool
) -> tuple[float, FloatArray]:
    """Take a step of Gauss-Newton; return how far the outline moved, 1 being settled, and the normal matrix.

    A ``blunt`` step leaves the blur as it is.
    """
    weights = state.noise**2 / _expected_sds(state, step, shadows) ** 2
    known = np.array([0.0, 0.0, 0.0, state.geometry[4] - FIRST_BLUR_PX, *state.light])
    together = (state.kept @ reduced.reshape(len(reduced), -1)).reshape(reduced.shape[1:])
    normal = together[:-1, :-1] + np.diag(weights)
    goal = together[:-1, -1] - weights * known
    inverse = np.linalg.inv(normal)
    if blunt:
        free = (np.arange(LIGHT, TILT), np.r_[0:BLUR, LIGHT:ASIDE])[min(step, 1)]
        change = np.zeros(COMMON)
        change[free] = np.linalg.solve(normal[np.ix_(free, free)], goal[free])
    else:
        change = inverse @ goal
        if change @ normal @ state.last < 0:
            change /= 2  # a dark limb's edge bends so much that whole steps may go to and fro for ever
    change[:BLUR] = np.minimum(np.maximum(change[:BLUR], -LARGEST_STEP_PX), LARGEST_STEP_PX)
    blur = float(state.geometry[4])
    change[BLUR] = min(max(change[BLUR], -blur / 4, BLUR_PX[0] - blur), blur / 2, BLUR_PX[1] - blur)
    state.owns = state.owns + answers[:, :, -1] - answers[:, :, :-1] @ change
    state.geometry = state.geometry + np.array([*change[:3], 0, change[BLUR]])
    state.light, state.last = state.light + change[LIGHT:], change
    state.level = max(abs(float(state.light[:PROFILE].sum())), 0.1 * state.level)
    sds = state.noise * np.sqrt(np.diag(inverse)[:BLUR])
    return float((np.abs(change[:BLUR]) / np.maximum(SETTLED_SDS * sds, SETTLED_PX)).max()), normal


def held(state: State) -> FloatArray:
    """Return by what weights (P) a sector's own unknowns are held at nothing: its light as light from aside is."""
    weights = np.full(state.owns.shape[1], (state.noise / (ASIDE_SD * state.level)) ** 2)
    weights[:OWN_GROUND] = 0.0
    return weights


def _middle(values: FloatArray) -> float:
    """Return the median of ``values`` (N), which for few is quicker than numpy's."""
    ordered = np.sort(values)
    return float(ordered[(len(ordered) - 1) // 2] + ordered[len(ordered) // 2]) / 2


def _expected_sds(state: State, step: int, shadows: bool) -> FloatArray:
    """Return how far each common unknown may be from zero, and the blur from that expected."""
    sds = np.full(COMMON, 10.0)
    early = step <= EARLY
    sds[BLUR] = 0.6 * BLUR_SD_PX if early else BLUR_SD_PX
    sds[LIGHT : LIGHT + 2] = 3 * state.level
    sds[LIGHT + 2 : TILT] = (0.05 if early else CURVED_SD) * state.level
    sds[TILT:ASIDE] = TILT_SD
    sds[ASIDE:FALLING] = (0.01 if step <= 2 and not shadows else ASIDE_SD) * state.level
    sds[FALLING:OVAL] = (HELD if early or shadows else FALLING_SD) * state.level
    sds[OVAL:] = WAVE_SD * state.level
    return sds
