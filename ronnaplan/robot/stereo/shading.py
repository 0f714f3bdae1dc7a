"""A shaded sphere in one image, as a whole: where it is, how large, and what light falls on it.

Brightness within the outline is that of a few constants which mean something:

- a profile of the angle to the line of sight, in powers of its cosine: even brightness, a limb that darkens as the
  cosine or otherwise;
- the profile's tilt: reflectance, or light, that falls from one side to the other;
- light from aside of the lens: even, and falling off as the cosine;
- two waves around.

All around lies a ground with its own brightness and slope in each sector. One blur makes the image of both. All pixels
are fitted at once, so that light and edge are told apart as well as they can be.

What a limb as dark as the ground shows of its place depends on the light; `lights` judges that.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ronnaplan.geometry import FloatArray
from ronnaplan.robot.stereo.camera import Camera
from ronnaplan.robot.stereo.circles import Image
from ronnaplan.robot.stereo.profiles_compiled import PROFILE, blurred, shadowed, table_of
from ronnaplan.robot.stereo.shading_compiled import (
    BLUR,
    COMMON,
    LIGHT,
    OVAL,
    OWN_GROUND,
    TILT,
    Flags,
    equations,
)
from ronnaplan.robot.stereo.shading_pixels import OUTWARD_PX, Part, Pixels, pixels_near
from ronnaplan.robot.stereo.shading_steps import (
    EARLY,
    FEWEST_PIXELS,
    FIRST_BLUR_PX,
    FIRST_EVERY,
    State,
    advance,
    held,
    judge,
)

TABLE_STEP_PX = 0.1
"""Step of the table of what a sphere's profile is at each distance from its edge."""
REBUILT_PX, FIRST_REBUILT_PX = 0.004, 0.04
"""The table is made anew where radius or blur change by more; in the first steps by more than the second."""
BEYOND_PX = 2.0
"""The table goes on outside for this far."""
STEPS, UNSETTLED = 16, 10.0
"""So many steps are taken at most; an outline that moves by so many times what is settled at the end is none."""
STARTS, STRAYED_PX = 3, 2.5
"""A fit starts anew, so many times together, where the outline is so far from where its pixels were taken."""
AGAIN = 2
"""A fit that goes on from another starts with this step."""
DECIDED = 8
"""From this step on sectors are left out only, so that none comes and goes for ever."""
STEPS_IF_CLIPPED, LARGEST_NOISE_IF_CLIPPED = 12, 0.05
"""So many more steps, before and in all, where the ball is brighter than pixels get: how bright only its edge tells.
What is left there is noise, less than this share of what pixels get; else the fit took the ball for no brighter."""
SMALLEST_COVERAGE = 0.4
"""Share of the sectors that must be fitted."""


@dataclass(frozen=True, eq=False)
class ShadedSphere:
    """A sphere's place in one image."""

    expected: FloatArray
    """Unit direction (3,) in which it was expected."""
    across: FloatArray
    """Two unit vectors (3, 2) square to that; angles count from the first to the second."""
    place: FloatArray
    """Its center (2,) along ``across`` where its direction meets the plane at 1, and half the angle under which it is
    seen (rad), in any light."""
    light: FloatArray
    """Its light's tilt (2,), light from aside (2,), and such as falls off to the limb (2,): shares of brightness."""
    covariance: FloatArray
    """(9, 9) of place and light, with nothing assumed of the light but what is expected of it."""
    profile: FloatArray
    """What of the brightness goes with each power (PROFILE) of the cosine, as shares."""
    dark: float
    """How much darker the limb is than the middle, as a share."""
    limb_sds: float
    """How bright the limb is, in standard deviations: what is below nothing is no light."""
    angles: FloatArray
    """Of the sectors (S), rad."""
    shifts_px: FloatArray
    """How far outside the outline each sector (S) by itself finds the edge."""
    sds_px: FloatArray
    """Standard deviation of that, by the pixels' noise."""
    kept: Flags
    """Sectors that were fitted."""
    shadows: bool
    """Whether its own shadow is in the model of the light."""
    fitted: tuple[Pixels, State]
    """Its pixels, and what is known of it there."""
    by_ground: FloatArray = field(default_factory=lambda: np.zeros(3))
    """By how much its place (3) was another with the ground farther out."""

    @property
    def noise(self) -> float:
        """What the model leaves of its pixels, in the image's grey values."""
        return self.fitted[1].noise

    @property
    def ground(self) -> float:
        """How bright the ground beside it is, as a share of its own brightness."""
        state = self.fitted[1]
        return float(state.owns[state.kept, 0].mean() / state.level)

    @property
    def clipped_share(self) -> float:
        """How much of it is as bright as a pixel gets, and may be brighter."""
        pixels, state = self.fitted
        return float((pixels.grey >= pixels.clipped_at).sum() / (np.pi * state.geometry[2] ** 2))


@dataclass(frozen=True, eq=False)
class Fitted:
    """What a fit tells beside the state that it leaves."""

    shifts_px: FloatArray
    """Each sector's own shift of the edge (S), and its standard deviation."""
    sds_px: FloatArray
    normal: FloatArray
    """Normal matrix of the common unknowns."""
    moved: float
    """How far the outline moved last, 1 being settled."""
    strayed: bool
    """Whether it was left early, as the outline is too far from where its pixels were taken."""


def find_shaded(
    grey: Image,
    camera: Camera,
    axis: FloatArray,
    half_angle: float,
    seen: FloatArray,
    part: Part = Part.WHOLE,
    *,
    starts: int = STARTS,
    strayed: State | None = None,
) -> ShadedSphere | None:
    """Return the sphere near ``axis`` (3,) and ``half_angle`` (rad), or None where there is none.

    ``seen`` (N, 3) are rays to where its outline is known to show. Where the outline turns out to be elsewhere, it is
    looked for anew there, with so many ``starts`` together, in the light of the one that ``strayed``. Only a ``part``
    of it is looked at.
    """
    across = np.linalg.svd(axis[None])[2][1:].T
    pixels = pixels_near(grey, camera, axis, across, half_angle, part)
    state = _start(pixels, half_angle, _sectors_of((seen - axis) @ across, len(pixels.starts) - 1))
    if state is None:
        return None
    if strayed is not None:
        state.geometry[4], state.light, state.level = strayed.geometry[4], strayed.light, strayed.level
    fitted = fit_sphere(pixels, state, 0 if strayed is None else AGAIN, may_stray=starts > 1)
    if fitted is None:
        return None
    if (fitted.strayed or fitted.moved > UNSETTLED) and starts > 1:
        place = state.geometry[:3] / pixels.focal_px
        found = axis + across @ place[:2]
        found /= np.linalg.norm(found)
        strayed = state if fitted.strayed else None
        again = grey, camera, found, float(place[2]), seen, part
        return find_shaded(*again, starts=starts - 1, strayed=strayed)
    return result_of(pixels, state, fitted, axis, across, shadows=False)


def fit_sphere(
    pixels: Pixels, state: State, start: int, *, shadows: bool = False, may_stray: bool = False
) -> Fitted | None:
    """Fit the sphere's ``state`` to the ``pixels``, from step ``start`` on; return what is told of it.

    None where too little agrees.
    """
    first, built, shapes, cast = state.geometry[:3], np.zeros(2), np.empty(0), np.empty((0, 0, 0))
    more = STEPS_IF_CLIPPED if np.isfinite(pixels.clipped_at) else 0
    for step in range(start, STEPS + more):
        size = state.geometry[[2, 4]]
        if np.abs(size - built).max() > (REBUILT_PX if step > EARLY else FIRST_REBUILT_PX):
            shapes = blurred(size[0], size[1], *_table_of(size[0]))
            if shadows:
                cast = shadowed(size[0], size[0] / pixels.focal_px, size[1], *_table_of(size[0]))
            built = size
        fit = state.geometry, table_of(shapes, state.light), -OUTWARD_PX - BEYOND_PX, TABLE_STEP_PX, state.light
        every = FIRST_EVERY if step < EARLY else 1
        of = pixels.places, pixels.grey, pixels.weights, pixels.starts, every, pixels.clipped_at
        reduced, answers, told = equations(*of, *fit, state.owns, held(state), cast)
        before = state.kept
        clipped = told[:, 0] < -(-np.diff(pixels.starts) // every)
        shifts, sds = judge(state, reduced, told, clipped, step, DECIDED + more)
        if state.kept.sum() < SMALLEST_COVERAGE * len(state.kept):
            return None
        blunt = step < 2 or (step <= EARLY and more > 0)  # a clipped edge looks sharper than it is
        moved, normal = advance(state, reduced, answers, step, shadows, blunt=blunt)
        if step > EARLY + 1 and (before == state.kept).all() and moved < 1:
            break
        strayed = step == EARLY and may_stray and bool(np.abs(state.geometry[:3] - first).max() > STRAYED_PX)
        if strayed:
            break
    if state.noise > LARGEST_NOISE_IF_CLIPPED * pixels.clipped_at:
        return None
    return Fitted(shifts, sds, normal, moved, strayed)


def _table_of(radius: float) -> tuple[float, float, int]:
    """Return where the table of a sphere starts (px), its step (px) and its length."""
    first = -OUTWARD_PX - BEYOND_PX
    return first, TABLE_STEP_PX, int((1.15 * radius + 6 - first) / TABLE_STEP_PX)


def _sectors_of(offsets: FloatArray, count: int) -> Flags:
    """Return the sectors (S) in which there are ``offsets`` (N, 2), and their neighbors."""
    share = np.arctan2(offsets[:, 1], offsets[:, 0]) / (2 * np.pi) + 0.5
    there: Flags = np.zeros(count, dtype=bool)
    there[(share * count).astype(np.int64) % count] = True
    return there | np.roll(there, 1) | np.roll(there, -1)


def _start(pixels: Pixels, half_angle: float, seen: Flags) -> State | None:
    radius = half_angle * pixels.focal_px
    inside = np.hypot(*pixels.places.T) < radius - 5.0
    kept = (np.diff(pixels.starts) > FEWEST_PIXELS) & seen
    if kept.sum() < SMALLEST_COVERAGE * len(kept) or not inside.any():
        return None
    level = float(np.median(np.abs(pixels.grey[inside]))) + 1e-9
    geometry = np.array([0.0, 0.0, radius, pixels.focal_px, FIRST_BLUR_PX])
    owns, last = np.zeros((len(kept), OWN_GROUND)), np.zeros(COMMON)
    return State(geometry, np.zeros(COMMON - LIGHT), owns, kept, 0.1 * level, level, last)


def result_of(
    pixels: Pixels, state: State, fitted: Fitted, axis: FloatArray, across: FloatArray, *, shadows: bool
) -> ShadedSphere | None:
    """Return the fitted sphere, or None where the fit did not settle."""
    if fitted.moved > UNSETTLED:
        return None
    count, focal = len(state.kept), state.geometry[3]
    units = np.array([focal] * 3 + [1.0] * 2 + [state.level] * 4)
    chosen = np.r_[0:BLUR, TILT:OVAL]
    covariance = np.asarray(np.linalg.inv(fitted.normal) * state.noise**2, dtype=np.float64)
    sds = np.sqrt(np.diag(covariance))
    return ShadedSphere(
        axis,
        across,
        state.geometry[:3] / focal,
        state.light[TILT - LIGHT : OVAL - LIGHT] / units[3:],
        covariance[np.ix_(chosen, chosen)] / np.outer(units, units),
        state.light[:PROFILE] / state.level,
        float(np.clip(1 - state.light[0] / state.level, 0, 1)),
        float(state.light[0] / sds[LIGHT]),
        ((np.arange(count) + 0.5) / count - 0.5) * 2 * np.pi,
        fitted.shifts_px,
        fitted.sds_px,
        state.kept,
        shadows,
        (pixels, state),
    )
