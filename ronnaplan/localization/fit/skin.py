"""The skin that a ball lies on: whether there is any, and where a fit of it begins."""

from __future__ import annotations

import math

import numpy as np

from kernelcache import njit
from ronnaplan.geometry import FloatArray
from ronnaplan.localization.fit.algebra import quantile
from ronnaplan.localization.fit.cells import CELL_COUNT, cell_directions
from ronnaplan.localization.fit.depth import SURFACE_BLURS, reach_mm
from ronnaplan.localization.fit.descent import Prior
from ronnaplan.localization.fit.directions import (
    ATTACHED_SHARE,
    DARK_QUANTILE,
    MOST_HELD,
    NEIGHBOUR_SHARE,
    Verdict,
)
from ronnaplan.localization.fit.disc import share_below
from ronnaplan.localization.fit.model import has_layer, has_streaks
from ronnaplan.localization.fit.neighbourhood import Neighbourhood
from ronnaplan.localization.fit.parameters import (
    BACKGROUND,
    BLUR,
    CONTRAST,
    LEAST_SPREAD_MM2,
    PARAMETERS,
    RADIUS,
    SKIN_LEVEL_AT,
    SKIN_PLACE,
    WIDTH,
)

SKIN_PRIOR_HU = 2000.0
SKIN_PRIOR_PLACE = 0.3
"""Standard deviations of the skin's level, and of its distance and direction as a share of the distance."""

METAL_SKIN_HOLD = 2.0
"""Between metal and skin the image is dark, so that only touching tells where the skin is: a distance that is off by
this fraction of itself (a half) weighs as much as one voxel that is off by the contrast."""

SKIN_SHARES = (0.08, 0.65)
"""A ball that lies on skin has neighbours in a share of its directions between these."""

ONE_SIDED = 0.1
"""Directions whose mean is shorter than this are those of things around a ball, not of one that it lies on: skin fills
two thirds of all at most, whose mean is 0.35 long."""

SKIN_LEVEL = 0.35
"""What a ball lies on is no brighter than this share of the ball's own contrast."""

SKIN_QUANTILE = 0.8
"""The skin's level is read off the brighter of the neighbouring directions."""

AIR_QUANTILE = 0.05
"""Where a ball lies on skin, the background is what this share of the voxels about it do not exceed."""

MIN_SKIN_HU = 250.0
"""What a ball lies on is brighter than its background by this at least: skin was fitted with 290 HU and more beside
metal's streaks and 700 and more elsewhere, the haze to one side of a ball in cone beams and helices as skin of -130 to
190, which displaced balls by up to 0.1 mm."""

CURVATURE_SPREAD_PER_MM = 1.0 / 140.0
"""Standard deviation of how the skin is curved about `SKIN_CURVATURE_PER_MM`: heads are flat at the temples, and round
as a ball of 55 mm elsewhere. Taken for round, flat skin displaces balls by 2 to 8 um, away from it."""

FACE_QUANTILE = 0.75
"""In this share of the directions in which it is met, what a ball touches is no brighter than its face: a screw's end
in it, which is met in few, does not count."""

FACE_AT_END, STEEL_HU = 0.9, 20_000.0
"""A face that reads so much of what the scale shows is at its end, where it may be as bright as steel: balls of plastic
flush on steel, of a 12-bit scan, had 0.02 to 0.05 more of their surface attached than by what was read."""

PLANE_DEPTHS, PLANE_HALVINGS = 9, 12
"""How far a plane that a ball touches is seen beside it is told by so many places outward, to 1 in 2 to the second."""

MIN_SKIN_DEPTH = 0.7
"""What a ball lies on is no nearer to its center than this share of its radius; a cone standing there looks sunk."""


def lies_on_something(theta: FloatArray, verdict: Verdict) -> bool:
    """Whether the ball has neighbours as skin would be, which is not to all sides alike."""
    share = float(verdict.beside.mean())
    if not SKIN_SHARES[0] <= share <= SKIN_SHARES[1] or np.linalg.norm(_toward(verdict)) < ONE_SIDED:
        return False
    return bool(_level_beside(verdict) < SKIN_LEVEL * theta[CONTRAST])


def is_skin(theta: FloatArray) -> bool:
    """Whether what was fitted as skin is dense enough for it, and lies beneath the ball instead of cutting through.

    What is wrapped around a ball may lie on one side as faint skin would.
    """
    depth_mm = 1.0 / max(float(np.linalg.norm(theta[SKIN_PLACE])), 1e-9)
    is_dense = has_layer(theta) or float(theta[SKIN_LEVEL_AT]) >= MIN_SKIN_HU
    return is_dense and depth_mm >= MIN_SKIN_DEPTH * float(theta[RADIUS])


def is_mount(on_skin: Verdict, plain: Verdict, seen_hu: float) -> bool:
    """Whether it is no skin that was fitted beside a ball of which ``seen_hu`` are shown, but what it is mounted on.

    That touches few of the directions, as a fit without skin told, and it is darker than skin would be beside it.
    """
    is_dark = quantile(on_skin.excess_hu, DARK_QUANTILE) < -NEIGHBOUR_SHARE * seen_hu
    return is_dark and float(plain.beside.mean()) <= MOST_HELD


def bent(along_mm: FloatArray, theta: FloatArray, jacobian: FloatArray) -> FloatArray:
    """How the model changes (N,) with the skin's curvature, HU mm, at places ``along_mm`` (N, 3) from the center.

    By its derivatives (N, P) there: along the vector to the skin they are those by its height, times its distance.
    """
    place = theta[SKIN_PLACE]
    depth_mm = along_mm @ place / np.linalg.norm(place)
    beside_mm2 = np.sum(along_mm**2, axis=1) - depth_mm**2
    changed: FloatArray = -np.linalg.norm(place) * (jacobian[:, SKIN_PLACE] @ place) * beside_mm2 / 2.0
    return changed


def face_hu(excess_hu: FloatArray, contrast_hu: float, end_hu: float = math.inf) -> float:
    """Return how bright the face may be that a ball of ``contrast_hu`` touches, by what is just outside it (C,).

    The scale ends ``end_hu`` above the background.
    """
    attached_hu = excess_hu[excess_hu > ATTACHED_SHARE * contrast_hu]
    if not len(attached_hu):
        return 0.0
    read_hu = quantile(attached_hu, FACE_QUANTILE)
    return max(read_hu, STEEL_HU) if read_hu >= FACE_AT_END * end_hu else read_hu


def share_on_skin(theta: FloatArray, attached_hu: float) -> float:
    """Share of a ball's directions in which what it touches, as flat as a plane, counts as attached to it (`Verdict`).

    That is where a plane of ``attached_hu`` over the background, blurred as the ball is, exceeds this by
    `ATTACHED_SHARE` of the contrast on the average of what lies just outside the ball's blur. The brighter it is beside
    the ball, the farther aside its blur does so.
    """
    blur_mm = float(np.sqrt((2.0 * theta[BLUR] ** 2 + theta[WIDTH] ** 2 / 12.0) / 3.0 + LEAST_SPREAD_MM2))
    outside_mm = float(theta[RADIUS]) + np.linspace(SURFACE_BLURS * blur_mm, reach_mm(blur_mm), PLANE_DEPTHS)
    least = ATTACHED_SHARE * min(float(theta[CONTRAST]) / max(attached_hu, 1.0), 1.0)
    return (1.0 - _cosine_in_plane(outside_mm, float(theta[RADIUS]), blur_mm, least)) / 2.0


@njit(cache=True)
def _cosine_in_plane(outside_mm: FloatArray, plane_mm: float, blur_mm: float, least: float) -> float:
    """Cosine to the normal of a plane ``plane_mm`` away, at which the places (N,) are in it to the share ``least``.

    A direction's cell is as wide as `CELL_COUNT` of them leave it, which blurs the plane's edge further.
    """
    low, high = 0.0, 1.0
    for _ in range(PLANE_HALVINGS):
        middle, inside = (low + high) / 2.0, 0.0
        across2 = (1.0 - middle**2) / CELL_COUNT
        for place_mm in outside_mm:
            spread_mm = math.sqrt(blur_mm**2 + place_mm**2 * across2)
            inside += share_below((middle * place_mm - plane_mm) / spread_mm) / len(outside_mm)
        low, high = (low, middle) if inside > least else (middle, high)
    return high


def with_skin(
    theta: FloatArray, prior: Prior, verdict: Verdict, around: Neighbourhood
) -> tuple[FloatArray, Prior]:
    """Add skin that the ball touches, on the side where the neighbours are."""
    toward = _toward(verdict)
    place = toward / np.linalg.norm(toward) / theta[RADIUS]
    spread = np.array([SKIN_PRIOR_HU, *[SKIN_PRIOR_PLACE / theta[RADIUS]] * 3])
    skin = np.array([_level_beside(verdict), *place])
    added = Prior.of(skin, spread, prior.layer_mm)
    if has_streaks(theta):
        added.weight[1:] = (METAL_SKIN_HOLD * theta[CONTRAST] * theta[RADIUS]) ** 2
    lowest = quantile(around.values_hu, AIR_QUANTILE)
    start = np.concatenate([theta[:BACKGROUND], [lowest, 0.0, 0.0, 0.0], theta[len(PARAMETERS) :], skin])
    return start, prior.extended(added)


def _toward(verdict: Verdict) -> FloatArray:
    """Return the mean (3,) of the directions in which the neighbours are."""
    toward: FloatArray = cell_directions()[verdict.beside].mean(axis=0)
    return toward


def _level_beside(verdict: Verdict) -> float:
    """How bright the neighbours are, in HU over the background; partial voxels make some look fainter."""
    return quantile(verdict.excess_hu[verdict.beside], SKIN_QUANTILE)
