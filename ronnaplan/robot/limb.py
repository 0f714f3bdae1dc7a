"""The edge of a smoothly shaded sphere in one image, to hundredths of a pixel, part by part.

Whatever light falls on a dull sphere, its brightness near the limb is a sum of a constant, of the depth within the limb
and of the cosine between its normal and the line of sight, which rises as the root of the depth. Behind it lies a
ground with its own brightness and slope. In each sector of the outline these five and the place of the edge are fitted
to the pixels themselves, with one blur for all, so that neither a dark limb, nor uneven light, nor an uneven ground
shifts the edge. What the light is, is told from further inside: a limb as dark as the ground has else no clear place.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ronnaplan.geometry import FloatArray
from ronnaplan.robot.circles import Image
from ronnaplan.robot.limb_compiled import (
    SHADES,
    Flags,
    Integers,
    lay_out,
    least_deviations,
    normal_equations,
    squares_left,
    with_derivatives,
)

ARC_PX = 8.0
FEWEST_SECTORS, MOST_SECTORS = 36, 72
FEWEST_PIXELS = 20
"""Sectors with fewer pixels, as beyond the image's border, know no edge."""
OUTWARD_PX = 6.0
"""How far outside the expected edge pixels are taken."""
INWARD, INWARD_PX = 0.25, (8.0, 15.0)
"""And inside: as a share of the radius, within bounds."""
FIRST_BLUR_PX, BLUR_PX = 2.0, (0.5, 4.0)
"""Standard deviation of the blur at the start, and its bounds."""
LARGEST_STEP_PX = 1.0
TABLE_PX = (-OUTWARD_PX - 4 * BLUR_PX[1], INWARD_PX[1] + 4 * BLUR_PX[1])
TABLE_STEP_PX = 0.1
INTERIOR_PX, FEWEST_INTERIOR, MOST_INTERIOR = 4.0, 50, 3000
"""The light is told from pixels so far within the limb, thinned out to so many."""
LIGHT_STEPS = 10
SHADE_SD = 0.01
"""What the light told from within errs at the limb at best, as a share of the brightness."""


@dataclass(frozen=True, eq=False)
class Limb:
    """The edge in each sector (N)."""

    points_px: FloatArray
    """(N, 2)."""
    sds_px: FloatArray
    """Standard deviation of each across the edge; infinite where there is none to see."""
    light_sds_px: FloatArray
    """What of it comes from the light told from within: this part all sectors may have in common."""
    misfits: FloatArray
    """RMS grey values that the model leaves in each sector."""
    blur_px: float


@dataclass(frozen=True, eq=False)
class _Reference:
    """A closed outline in polar coordinates about its ``center`` (2,)."""

    center: FloatArray
    outline: FloatArray
    """(3, N): angles, rising, once around and one more at either end; radii; cosines between normal and radius."""

    def at(self, angle: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return radius and that cosine at angles (K)."""
        radius, upright = (np.interp(angle, self.outline[0], values) for values in self.outline[1:])
        return radius, upright


@dataclass(frozen=True, eq=False)
class _Sectors:
    """Pixels beside the edge, sector by sector, and those further inside where the outline is known to show."""

    grey: FloatArray
    """Brightness (B)."""
    depth: FloatArray
    """Within the outline (B), px."""
    starts: Integers
    """Where each sector's begin, and where all end (S + 1)."""
    angle: FloatArray
    """Of each sector's middle (S)."""
    light: FloatArray
    """Brightness (L) further inside."""
    offset: FloatArray
    """Of those from the center (L, 2), in radii."""
    of_light: Integers
    """Their sectors."""

    @property
    def pixels(self) -> Integers:
        """How many each sector has beside the edge (S)."""
        return np.diff(self.starts)


def find_limb(
    grey: Image, outline_px: FloatArray, seen_px: FloatArray, *, steps: int, blur_px: float = FIRST_BLUR_PX
) -> Limb | None:
    """Return the edge in ``grey`` (rows, columns) near the closed ``outline_px`` (N, 2), in ``steps`` of Gauss-Newton.

    The light is taken from the directions of ``seen_px`` (N, 2), where the outline is known to show; None if too little
    of the inside is in the image.
    """
    reference = _polar(outline_px)
    sectors = _sectors(grey, reference, seen_px)
    if len(sectors.light) < FEWEST_INTERIOR:
        return None
    expected, trust = _expected(sectors)
    radius = float(reference.outline[1, 1:-1].mean())
    count = len(sectors.angle)
    shift, shades = np.zeros(count), np.zeros((count, SHADES))
    for step in range(steps + 1):
        fit = sectors.grey, _steps(sectors, shift), sectors.starts, _profiles(blur_px, radius), shades, blur_px
        normal, goal = _held(*normal_equations(*fit), trust, expected)
        if step == 0:  # without shades the edge does not show
            shades[:] = np.linalg.solve(normal[:, :SHADES, :SHADES], goal[:, :SHADES])[..., 0]
            continue
        own, share, wider = _eliminated(normal, goal)
        wider = float(
            np.clip(wider, max(-blur_px / 4, BLUR_PX[0] - blur_px), min(blur_px / 2, BLUR_PX[1] - blur_px))
        )
        own = own - share * wider
        blur_px += wider
        shades = own[:, :SHADES].copy()
        shift = shift + np.clip(own[:, SHADES], -LARGEST_STEP_PX, LARGEST_STEP_PX)
    squares = squares_left(*fit, np.column_stack([own, np.full(count, wider)]))
    misfit = np.sqrt(squares / np.maximum(sectors.pixels - SHADES - 1, 1))
    spread = np.linalg.inv(normal[:, :-1, :-1])[:, SHADES]
    sd = misfit * np.sqrt(spread[:, SHADES])
    by_light = misfit * np.sqrt((spread[:, :SHADES] ** 2 * trust[:, :SHADES]).sum(axis=1))
    return Limb(
        _places(reference, sectors.angle, shift),
        np.where(sectors.pixels < FEWEST_PIXELS, np.inf, sd),
        by_light,
        misfit,
        blur_px,
    )


def _eliminated(normal: FloatArray, goal: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """Solve normal equations (S, K, K) and (S, K, 1) whose last unknown, the blur, is common to all sectors.

    Returns each sector's own unknowns (S, K - 1) without a change of the blur, what one of it takes off them, and the
    change: the middle of those that the sectors ask for, so that spoilt ones do not pull it.
    """
    solved = np.linalg.solve(normal[:, :-1, :-1], np.concatenate([goal[:, :-1], normal[:, :-1, -1:]], axis=2))
    own, share = solved[..., 0], solved[..., 1]
    information = normal[:, -1, -1] - (normal[:, -1, :-1] * share).sum(axis=1)
    pull = goal[:, -1, 0] - (normal[:, -1, :-1] * own).sum(axis=1)
    wider = pull / information
    order = np.argsort(wider)
    total = np.cumsum(information[order])
    return own, share, float(wider[order][np.searchsorted(total, total[-1] / 2)])


def _expected(sectors: _Sectors) -> tuple[FloatArray, FloatArray]:
    """Return the shades (S, 3) at the limb that the light within makes expect, and the weights (S, 7) they have.

    The light is that of the nine lowest spherical harmonics, which show all but a hundredth of what any lamps do to a
    dull ball; a sector trusts it as far as it holds beside the limb.
    """
    design = _harmonics(*sectors.offset.T)
    light, left, noise = least_deviations(design, sectors.light, LIGHT_STEPS)
    within = np.linspace(0, INWARD, 12)
    x, y = ((1 - within) * wave(sectors.angle)[:, None] for wave in (np.cos, np.sin))
    profile = _harmonics(x, y) @ light
    basis = np.stack([np.ones_like(within), within, np.sqrt(within * (2 - within))], axis=1)
    expected = profile @ np.linalg.pinv(basis).T
    beside = np.hypot(*sectors.offset.T) > 1 - INWARD
    each = np.bincount(sectors.of_light[beside], minlength=len(expected))
    square = np.bincount(sectors.of_light[beside], left[beside] ** 2, len(expected)) / np.maximum(each, 1)
    level = float(np.median(np.abs(sectors.light)))
    variance = np.where(each > 0, np.maximum(square - noise**2, (SHADE_SD * level) ** 2), level**2)
    trust = np.zeros((len(expected), SHADES + 2))
    trust[:, 2:SHADES] = noise**2 / variance[:, None]
    return expected, trust


def _harmonics(x: FloatArray, y: FloatArray) -> FloatArray:
    """Return the nine harmonics (..., 9) of the normals at offsets from the center in radii."""
    z = np.sqrt(np.maximum(1 - x * x - y * y, 0))
    return np.stack([np.ones_like(x), x, y, z, x * y, x * z, y * z, x * x - y * y, z * z], axis=-1)


def _polar(outline_px: FloatArray) -> _Reference:
    center = outline_px.mean(axis=0)
    x, y = (outline_px - center).T
    angle = np.arctan2(y, x)
    order = np.argsort(angle)
    angle, radius = angle[order], np.hypot(x, y)[order]
    ahead, behind = np.roll(radius, -1), np.roll(radius, 1)
    turn = (np.roll(angle, -1) - np.roll(angle, 1)) % (2 * np.pi)
    slope = (ahead - behind) / turn / radius
    around = np.stack([angle, radius, 1 / np.hypot(1, slope)])
    before, after = around[:, -1:].copy(), around[:, :1].copy()
    before[0] -= 2 * np.pi
    after[0] += 2 * np.pi
    return _Reference(center, np.concatenate([before, around, after], axis=1))


def _sectors(grey: Image, reference: _Reference, seen_px: FloatArray) -> _Sectors:
    radius = reference.outline[1, 1:-1]
    reach, mean = radius.max() + OUTWARD_PX, float(radius.mean())
    low = np.maximum(np.floor(reference.center - reach), 0)
    high = np.maximum(np.minimum(np.ceil(reference.center + reach) + 1, grey.shape[::-1]), low)
    count = int(np.clip(2 * np.pi * mean / ARC_PX, FEWEST_SECTORS, MOST_SECTORS))
    beside = seen_px - reference.center
    share = np.arctan2(beside[:, 1], beside[:, 0]) / (2 * np.pi) + 0.5
    seen: Flags = np.zeros(count, dtype=bool)
    seen[(share * count).astype(np.int64) % count] = True
    bounds = -OUTWARD_PX, float(np.clip(INWARD * mean, *INWARD_PX)), INTERIOR_PX
    (left, top), (right, bottom) = np.stack([low, high]).astype(np.int64)
    window = np.ascontiguousarray(grey[top:bottom, left:right], dtype=np.float64)
    values, depth, starts, *within = lay_out(
        window, reference.center - (left, top), reference.outline, bounds, seen
    )
    middles = ((np.arange(count) + 0.5) / count - 0.5) * 2 * np.pi
    every = len(within[0]) // MOST_INTERIOR + 1
    light, offset = (np.ascontiguousarray(one[::every], dtype=np.float64) for one in within[:2])
    return _Sectors(values, depth, starts, middles, light, offset, np.asarray(within[2][::every], dtype=np.int64))


def _profiles(blur_px: float, radius: float) -> FloatArray:
    """Return what the shades look like blurred, and two derivatives with depth (N, 15), at the table's depths."""
    from scipy.ndimage import gaussian_filter1d

    at = np.arange(*TABLE_PX, TABLE_STEP_PX)
    within = np.clip(at / radius, 0, 1)
    ball = (at > 0).astype(np.float64)
    sharp = np.stack([1 - ball, np.minimum(at / radius, 0), ball, within, np.sqrt(within * (2 - within))])
    return with_derivatives(gaussian_filter1d(sharp, blur_px / TABLE_STEP_PX, axis=1), TABLE_STEP_PX)


def _steps(sectors: _Sectors, shift: FloatArray) -> FloatArray:
    """Return the pixels' depth (B) in steps of the table, the edges being shifted outwards."""
    return (sectors.depth + np.repeat(shift, sectors.pixels) - TABLE_PX[0]) / TABLE_STEP_PX


def _held(
    normal: FloatArray, goal: FloatArray, weights: FloatArray, expected: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return normal matrices (S, K, K) and right sides (S, K, 1) with the sphere's shades held near those expected."""
    unit = np.eye(normal.shape[1])
    scale = np.einsum("skk->sk", normal)
    normal = normal + (1e-9 * (scale[:, :, None] + 1e-9) + weights[:, :, None]) * unit
    goal = goal[..., None].copy()
    goal[:, 2:SHADES, 0] += weights[:, 2:SHADES] * expected
    return normal, goal


def _places(reference: _Reference, angle: FloatArray, shift: FloatArray) -> FloatArray:
    """Return the edges' points (S, 2)."""
    radius, upright = reference.at(angle)
    distance = radius + shift / upright
    points: FloatArray = reference.center + distance[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    return points
