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
from numpy.typing import NDArray

from ronnaplan.geometry import FloatArray

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
TABLE_STEP_PX = 0.1
INTERIOR_PX, FEWEST_INTERIOR, MOST_INTERIOR = 4.0, 50, 3000
"""The light is told from pixels so far within the limb, thinned out to so many."""
LIGHT_STEPS = 10
SHADE_SD = 0.01
"""What the light told from within errs at the limb at best, as a share of the brightness."""
SHADES = 5
"""Unknown brightnesses of a sector: the ground, its slope, and the sphere's three."""


@dataclass(frozen=True, eq=False)
class Limb:
    """The edge in each sector (N)."""

    points_px: FloatArray
    """(N, 2)."""
    sds_px: FloatArray
    """Standard deviation of each across the edge; infinite where there is none to see."""
    misfits: FloatArray
    """RMS grey values that the model leaves in each sector."""
    blur_px: float


@dataclass(frozen=True, eq=False)
class _Reference:
    """A closed outline in polar coordinates about its ``center`` (2,)."""

    center: FloatArray
    angle: FloatArray
    radius: FloatArray
    upright: FloatArray
    """Cosine between the outline's normal and the radius."""

    def at(self, angle: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return radius and ``upright`` at angles of any shape."""
        radius, upright = (
            np.interp(angle, self.angle, values, period=2 * np.pi) for values in (self.radius, self.upright)
        )
        return radius, upright


@dataclass(frozen=True, eq=False)
class _Sectors:
    """Pixels by sector: brightness and depth (S, P) within the outline, where ``kept``."""

    grey: FloatArray
    depth: FloatArray
    kept: NDArray[np.bool_]
    angle: FloatArray
    """Of each sector's middle (S)."""
    light: FloatArray
    """Brightness (L) further inside, where the outline is known to show."""
    share: FloatArray
    """Distance of those pixels from the center, as a share of the radius."""
    turn: FloatArray
    """Their direction from the center."""
    of_light: NDArray[np.int64]
    """Their sectors."""


def find_limb(
    grey: FloatArray, outline_px: FloatArray, seen_px: FloatArray, *, steps: int, blur_px: float = FIRST_BLUR_PX
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
    radius = float(reference.radius.mean())
    shift = np.zeros(len(sectors.grey))
    values = _profiles(sectors.depth, blur_px, radius)[0]
    shades = np.linalg.solve(*_normal(values, sectors, trust[:, :SHADES], expected))[..., 0]
    for _ in range(steps):
        values, first, second = _profiles(sectors.depth + shift[:, None], blur_px, radius)
        design = np.concatenate([values, first @ shades[..., None], blur_px * second @ shades[..., None]], axis=2)
        normal, goal = _normal(design, sectors, trust, expected)
        own, share, wider = _eliminated(normal, goal)
        wider = float(
            np.clip(wider, max(-blur_px / 4, BLUR_PX[0] - blur_px), min(blur_px / 2, BLUR_PX[1] - blur_px))
        )
        own = own - share * wider
        blur_px += wider
        shades = own[:, :SHADES]
        shift = shift + np.clip(own[:, SHADES], -LARGEST_STEP_PX, LARGEST_STEP_PX)
    left = (sectors.grey - (design[..., :-1] @ own[..., None])[..., 0] - design[..., -1] * wider) * sectors.kept
    pixels = sectors.kept.sum(axis=1)
    misfit = np.sqrt((left**2).sum(axis=1) / np.maximum(pixels - SHADES - 1, 1))
    sd = misfit * np.sqrt(np.linalg.inv(normal[:, :-1, :-1])[:, SHADES, SHADES])
    return Limb(
        _places(reference, sectors.angle, shift), np.where(pixels < FEWEST_PIXELS, np.inf, sd), misfit, blur_px
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
    design = _harmonics(sectors.share, sectors.turn)
    weights = np.ones(len(design))
    for _ in range(LIGHT_STEPS):  # towards least absolute deviations: part of the ball may be hidden or glare
        turned = design.T * weights
        light = np.linalg.solve(turned @ design + 1e-6 * np.eye(9), turned @ sectors.light)
        left = np.abs(sectors.light - design @ light)
        noise = 1.4826 * float(np.median(left)) + 1e-3
        weights = 1 / np.maximum(left, noise)
    within = np.linspace(0, INWARD, 12)
    profile = _harmonics(1 - within, sectors.angle[:, None]) @ light
    basis = np.stack([np.ones_like(within), within, np.sqrt(within * (2 - within))], axis=1)
    expected = profile @ np.linalg.pinv(basis).T
    beside = sectors.share > 1 - INWARD
    each = np.bincount(sectors.of_light[beside], minlength=len(expected))
    square = np.bincount(sectors.of_light[beside], left[beside] ** 2, len(expected)) / np.maximum(each, 1)
    level = float(np.median(np.abs(sectors.light)))
    variance = np.where(each > 0, np.maximum(square - noise**2, (SHADE_SD * level) ** 2), level**2)
    trust = np.zeros((len(expected), SHADES + 2))
    trust[:, 2:SHADES] = noise**2 / variance[:, None]
    return expected, trust


def _harmonics(share: FloatArray, turn: FloatArray) -> FloatArray:
    """Return the nine harmonics (..., 9) of the normals at a ``share`` of the radius in the direction ``turn``."""
    x, y = share * np.cos(turn), share * np.sin(turn)
    z = np.sqrt(np.maximum(1 - share**2, 0)) + 0 * turn
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
    return _Reference(center, angle, radius, 1 / np.hypot(1, slope))


def _sectors(grey: FloatArray, reference: _Reference, seen_px: FloatArray) -> _Sectors:
    mean = float(reference.radius.mean())
    reach = float(reference.radius.max()) + OUTWARD_PX
    low = np.maximum(np.floor(reference.center - reach), 0).astype(int)
    high = np.maximum(np.minimum(np.ceil(reference.center + reach).astype(int) + 1, grey.shape[::-1]), low)
    rows, columns = np.mgrid[low[1] : high[1], low[0] : high[0]]
    x, y = columns - reference.center[0], rows - reference.center[1]
    distance = np.hypot(x, y)
    near = distance < reach
    values, distance, angle = grey[rows[near], columns[near]], distance[near], np.arctan2(y[near], x[near])
    radius, upright = reference.at(angle)
    depth = (radius - distance) * upright
    count = int(np.clip(2 * np.pi * mean / ARC_PX, FEWEST_SECTORS, MOST_SECTORS))
    sector = _sector(angle, count)
    beside = seen_px - reference.center
    seen = np.zeros(count, dtype=bool)
    seen[_sector(np.arctan2(beside[:, 1], beside[:, 0]), count)] = True
    inside = np.flatnonzero((depth > INTERIOR_PX) & seen[sector])
    inside = inside[:: len(inside) // MOST_INTERIOR + 1]
    annulus = np.flatnonzero((depth > -OUTWARD_PX) & (depth < np.clip(INWARD * mean, *INWARD_PX)))
    pixel, kept = _by_sector(annulus, sector[annulus], count)
    middles = ((np.arange(count) + 0.5) / count - 0.5) * 2 * np.pi
    share = distance[inside] / radius[inside]
    return _Sectors(
        values[pixel], depth[pixel], kept, middles, values[inside], share, angle[inside], sector[inside]
    )


def _sector(angle: FloatArray, count: int) -> NDArray[np.int64]:
    return ((angle / (2 * np.pi) + 0.5) * count).astype(np.int64) % count


def _by_sector(
    pixels: NDArray[np.int64], sector: NDArray[np.int64], count: int
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Return ``pixels`` (N) in a row for each sector (S, P), and which of these are not there for padding."""
    order = pixels[np.argsort(sector, kind="stable")]
    sizes = np.bincount(sector, minlength=count)
    column = np.arange(sizes.max())
    place = column + (np.cumsum(sizes) - sizes)[:, None]
    return order[np.minimum(place, max(len(order) - 1, 0))], column < sizes[:, None]


def _profiles(depth: FloatArray, blur_px: float, radius: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return what the shades (S, P, 5) look like blurred at depths (S, P), and two derivatives with depth."""
    from scipy.ndimage import gaussian_filter1d

    reach = 4 * BLUR_PX[1]
    least, most = -OUTWARD_PX - reach, INWARD_PX[1] + reach
    at = np.arange(least, most, TABLE_STEP_PX)
    within = np.clip(at / radius, 0, 1)
    ball = (at > 0).astype(np.float64)
    sharp = np.stack([1 - ball, np.minimum(at / radius, 0), ball, within, np.sqrt(within * (2 - within))])
    blurred = gaussian_filter1d(sharp, blur_px / TABLE_STEP_PX, axis=1)
    first = np.gradient(blurred, TABLE_STEP_PX, axis=1)
    table = np.concatenate([blurred, first, np.gradient(first, TABLE_STEP_PX, axis=1)]).T.copy()
    where = np.clip((depth - least) / TABLE_STEP_PX, 0, len(at) - 2)
    below = where.astype(int)
    share = (where - below)[..., None]
    shown = table[below]
    shown += share * np.diff(table, axis=0, append=0)[below]
    return shown[..., :5], shown[..., 5:10], shown[..., 10:]


def _normal(
    design: FloatArray, sectors: _Sectors, weights: FloatArray, expected: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return each sector's normal matrix (S, K, K) and right side (S, K, 1)."""
    seen = design * sectors.kept[..., None]
    turned = seen.transpose(0, 2, 1)
    normal = turned @ seen
    scale = np.einsum("skk->sk", normal)
    normal += 1e-9 * (scale[:, :, None] + 1e-9) * np.eye(design.shape[2])
    normal += weights[:, :, None] * np.eye(weights.shape[1])
    goal = turned @ sectors.grey[..., None]
    goal[:, 2:SHADES, 0] += weights[:, 2:SHADES] * expected
    return normal, goal


def _places(reference: _Reference, angle: FloatArray, shift: FloatArray) -> FloatArray:
    """Return the edges' points (S, 2)."""
    radius, upright = reference.at(angle)
    distance = radius + shift / upright
    points: FloatArray = reference.center + distance[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    return points
