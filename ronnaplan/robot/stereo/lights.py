"""The lights that may fall on a sphere, and where each of them puts it.

Moved, lit a little from aside, and a little uneven, a limb as dark as the ground looks almost the same. So a sphere is
not measured in one light but in each of a family: lamps about the lens, as far off it as is said or farther, on a ball
that is as even as balls are, or less. All are weighed by their evidence, and what they differ by counts as error. How
light from aside is spread over the ball follows from how it darkens to its limb, as far as laws of nature tell.

Two images of one sphere are weighed together: their lamps are mounted alike, and the ball is the same. Where it is
uneven, either image shows that from its own side, so that what one tells of the unevenness goes for the other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ronnaplan.geometry import FloatArray
from ronnaplan.robot.stereo.shading_steps import ASIDE_SD, TILT_SD

MISPLACED, LAMP_SCALES = 0.5, 13
"""Probability, before looking, that the lamp is farther from the lens than is said, and how many lamps are looked at:
from where it is said up to `ASIDE_SD`, evenly spaced in the logarithm."""
LOWERED = np.array([[7.3, 1.0, 0.0, -0.22], [-8.6, 0.0, 1.0, 1.04]])
"""Powers of the cosine, each by one less than those of the profile, as sums of what is even and what falls off as the
cosine: least squares over a sphere lit from aside."""
ANY_SD = 12**-0.5
"""Standard deviation of a share that may be anything from none to all."""
EVEN_SD = 0.001
"""Tilt of the light on a ball that is even, beside what the lens makes of it."""
UNEVEN, TILT_SCALES = 0.5, 6
"""Probability, before looking, that it is less even, and how many tilts are looked at: none, and up to `TILT_SD`."""
ONE_BALL = 0.5
"""Probability, before looking, that both images show one unevenness, to `EVEN_SD`: the ball's, not its lamps'."""
SHADOW_PX, MODELED_SHADOW_PX = 1.0, 0.03
"""A lamp beside the lens leaves a part of the limb in its own shadow, which no harmonic shows: the center errs by this,
times the tangent of the lamp's angle and how much darker the limb is than the middle; by the second where the shadow is
in the model."""
COMMON_PX = 0.003
"""What the model of the sphere errs in the center at best."""


@dataclass(frozen=True, eq=False)
class Sight:
    """A sphere as one image shows it in any light. Directions are in the rig's frame."""

    expected: FloatArray
    """Unit direction (3,) from the camera in which it was expected."""
    across: FloatArray
    """Two unit vectors (3, 2) square to that."""
    place: FloatArray
    """Its center (2,) along ``across`` where its direction meets the plane at 1, and half the angle under which it is
    seen, rad."""
    light: FloatArray
    """Its light's tilt (2,), light from aside (2,), and such as falls off to the limb (2,): shares of brightness."""
    covariance: FloatArray
    """(9, 9) of place and light."""
    turned: FloatArray
    """(2, 2): what the two lights from aside are, squared, of a lamp whose angle to the lens has tangent 1."""
    lens: FloatArray
    """How much darker the lens makes the side away from its axis, as a tilt (2,): RMS of what it may be."""
    shadow_px: float
    """Error of the center by the ball's own shadow, of a lamp whose angle to the lens has tangent 1."""
    focal_px: float

    def seen(self, away_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return where what is ``away_mm`` (3,) from the camera is seen (2,), and the derivatives (2, 3) of that."""
        along = float(away_mm @ self.expected)
        place = away_mm @ self.across / along
        return place, (self.across.T - place[:, None] * self.expected) / along


@dataclass(frozen=True, eq=False)
class Lights:
    """A sphere's places in K images in each light (H)."""

    places: FloatArray
    """(H, 3 K), image by image as those of a `Sight`."""
    covariances: FloatArray
    """(H, 3 K, 3 K) of the same."""
    logarithms: FloatArray
    """Of each light's probability (H), but for a constant: before looking, and by how well it explains the images."""


def in_each_light(sights: Sequence[Sight], lamp_sd_deg: float) -> Lights:
    """Return the places of one sphere in each light that may fall on it."""
    lit, logarithms = _family(sights, lamp_sd_deg)
    count = len(sights)
    known, gains = np.zeros((count, 3, count, 3)), np.zeros((count, 3, count, 6))
    told = np.zeros((count, 6, count, 6))
    for k, sight in enumerate(sights):
        known[k, :, k], gains[k, :, k] = sight.covariance[:3, :3], sight.covariance[:3, 3:]
        told[k, :, k] = sight.covariance[3:, 3:]
    places = np.concatenate([sight.place for sight in sights])
    light = np.concatenate([sight.light for sight in sights])
    spreads = lit + told.reshape(6 * count, 6 * count)
    both = gains.reshape(3 * count, 6 * count)
    known_light = np.linalg.inv(spreads)
    turned, lamps = both @ known_light, _lamps(sights, light, lit, lit @ known_light)
    covariances = known.reshape(3 * count, 3 * count) - turned @ both.T
    for k, sight in enumerate(sights):
        for axis in (3 * k, 3 * k + 1):
            covariances[:, axis, axis] += (COMMON_PX**2 + sight.shadow_px**2 * lamps[:, k]) / sight.focal_px**2
    return Lights(places - turned @ light, covariances, logarithms + fit(light, spreads))


def _lamps(sights: Sequence[Sight], light: FloatArray, lit: FloatArray, shrunk: FloatArray) -> FloatArray:
    """Return how far the lamp is from the lens in each light (H, K): the tangent's expected square.

    It is what light from aside is in that light once the images are seen, at the limb or as a lamp spreads it: of
    ``lit`` (H, 6 K, 6 K) beforehand, they tell the part ``shrunk``. What they alone tell may be little but their noise.
    """
    seen = (shrunk @ light) ** 2 + np.einsum("hii->hi", lit - shrunk @ lit)
    at_limb, falling = np.moveaxis(seen.reshape(len(lit), len(sights), 3, 2).sum(axis=3)[:, :, 1:], 2, 0)
    spread = (at_limb + falling) / np.array([np.trace(sight.turned) for sight in sights])
    return np.asarray(np.maximum(at_limb, spread))


def by_turning(profile: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the light from aside (2) of a lamp whose angle to the lens has tangent 1, and its covariance (2, 2).

    It follows from how a sphere lit from the lens darkens to its limb, its ``profile`` (K). Surfaces return as much
    light when lamp and lens change places: so it is the mean of the profile's derivative and of the profile over the
    cosine. What is drawn otherwise may be anywhere between these, and light at the limb the lamp's or the room's.
    """
    power = np.arange(len(profile))
    halves = np.array([np.clip(profile[0], 0, 1), *profile[1:]]) / 2
    limb, drawn = LOWERED[:, 0] * halves[0], LOWERED[:, 1:] @ (2 * (power - 1) * halves)[1:]
    told = limb / 2 + LOWERED[:, 1:] @ ((1 + power) * halves)[1:]
    return told, ANY_SD**2 * (np.outer(limb, limb) + np.outer(drawn, drawn))


def _family(sights: Sequence[Sight], lamp_sd_deg: float) -> tuple[FloatArray, FloatArray]:
    """Return each light's covariance (H, 6 K, 6 K), and the logarithm (H) of its probability before looking."""
    lamps = np.geomspace(np.radians(lamp_sd_deg), ASIDE_SD, LAMP_SCALES)
    tilts = np.array([0.0, *np.geomspace(EVEN_SD, TILT_SD, TILT_SCALES)[1:]])
    tilt, lamp = (one.ravel()[:, None, None] ** 2 for one in np.meshgrid(tilts, lamps))
    prior = np.outer(_one_or_more(MISPLACED, LAMP_SCALES), _one_or_more(UNEVEN, TILT_SCALES)).ravel()
    count = len(sights)
    apart, one_ball = np.zeros((2, len(prior), count, 6, count, 6))
    for k, of in enumerate(sights):
        even = EVEN_SD**2 * np.eye(2) + np.outer(of.lens, of.lens)
        for m, other in enumerate(sights):
            one_ball[:, k, :2, m, :2] = tilt * (of.across.T @ other.across)
        apart[:, k, :2, k, :2] = tilt * np.eye(2) + even
        apart[:, k, 2:, k, 2:] = one_ball[:, k, 2:, k, 2:] = lamp * np.kron(of.turned, np.eye(2))
        one_ball[:, k, :2, k, :2] += even
    families = [(1 - ONE_BALL, apart), (ONE_BALL, one_ball)] if count > 1 else [(1.0, apart)]
    spreads = np.concatenate([spread for _, spread in families]).reshape(-1, 6 * count, 6 * count)
    logarithms = np.concatenate([np.log(share * prior) for share, _ in families])
    return spreads, logarithms


def fit(misfits: FloatArray, covariances: FloatArray) -> FloatArray:
    """Return how well ``covariances`` (H, K, K) explain ``misfits`` (K,) or (H, K): logarithms (H) but one term."""
    misfits = np.broadcast_to(misfits, covariances.shape[:2])
    squares = np.einsum("hk,hk->h", misfits, np.linalg.solve(covariances, misfits[:, :, None])[:, :, 0])
    return np.asarray(-0.5 * (squares + np.linalg.slogdet(covariances)[1]))


def weighed(logarithms: FloatArray, means: FloatArray, covariances: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return mean (K,) and covariance (K, K) of one of ``means`` (H, K), by ``logarithms`` of probability (H)."""
    share = np.exp(logarithms - logarithms.max())
    share /= share.sum()
    mean = share @ means
    apart = means - mean
    return mean, np.einsum("h,hij->ij", share, covariances + apart[:, :, None] * apart[:, None, :])


def _one_or_more(more: float, count: int) -> FloatArray:
    """Return the probabilities of the first of ``count``, and of the others, which have ``more`` together."""
    return np.array([1 - more, *[more / (count - 1)] * (count - 1)])
