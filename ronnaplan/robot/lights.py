"""The lights that may fall on a sphere, and where each of them puts it.

Moved, lit a little from aside, and a little uneven, a limb as dark as the ground looks almost the same. So a sphere is
not measured in one light but in each of a family: lamps about the lens, as far off it as is said or farther, on a ball
that is as even as balls are, or less. All are weighed by their evidence, and what they differ by counts as error.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ronnaplan.geometry import FloatArray
from ronnaplan.robot.shading import ASIDE_SD, TILT_SD, ShadedSphere

MISPLACED, LAMP_SCALES = 0.5, 13
"""Probability, before looking, that the lamp is farther from the lens than is said, and how many lamps are looked at:
from where it is said up to `ASIDE_SD`, evenly spaced in the logarithm."""
EVEN_SD = 0.003
"""Tilt of the light on a ball that is even: the lens alone makes one side darker by as much (fourth power of the
cosine, 0.025 rad of a ball at 0.04 rad off the axis)."""
UNEVEN, TILT_SCALES = 0.5, 6
"""Probability, before looking, that it is less even, and how many tilts are looked at, up to `TILT_SD`."""
SHADOW_PX, MODELED_SHADOW_PX = 1.0, 0.1
"""A lamp beside the lens leaves a part of the limb in its own shadow, which no harmonic shows: the center errs by this,
times the share of light from aside and how much darker the limb is than the middle; by the second where the shadow is
in the model."""
COMMON_PX = 0.003
"""What the model of the sphere errs in the center at best."""


@dataclass(frozen=True, eq=False)
class Lights:
    """A sphere's place in one image in each light (H)."""

    expected: FloatArray
    """Unit direction (3,) in which it was expected."""
    across: FloatArray
    """Two unit vectors (3, 2) square to that."""
    places: FloatArray
    """Its center (H, 2) along ``across`` where its direction meets the plane at 1, and half the angle under which it is
    seen, rad."""
    covariances: FloatArray
    """(H, 3, 3) of the same, rad^2."""
    prior: FloatArray
    """Logarithm (H) of each light's probability before looking."""
    evidence: FloatArray
    """Logarithm (H) of how well each explains the image, but for a constant."""

    def seen(self, point: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return where a ``point`` (3,) of the camera's frame is seen (2,), and the derivatives (2, 3) of that."""
        away = float(point @ self.expected)
        place = point @ self.across / away
        return place, (self.across.T - place[:, None] * self.expected) / away


def in_each_light(found: ShadedSphere, excess: float, focal_px: float, lamp_sd_deg: float) -> Lights:
    """Return the places of a sphere whose covariance is that ``found``, times ``excess``."""
    lamps = np.geomspace(np.radians(lamp_sd_deg), ASIDE_SD, LAMP_SCALES)
    tilts = np.geomspace(EVEN_SD, TILT_SD, TILT_SCALES)
    sds = np.stack(np.meshgrid(tilts, lamps), axis=-1).reshape(-1, 2)
    prior = np.outer(_one_or_more(MISPLACED, LAMP_SCALES), _one_or_more(UNEVEN, TILT_SCALES)).ravel()

    covariance = excess * found.covariance
    spreads = covariance[3:, 3:] + np.repeat(sds, 2, axis=1)[:, None] ** 2 * np.eye(4)
    gains = covariance[:3, 3:] @ np.linalg.inv(spreads)
    known = covariance[:3, :3] - gains @ covariance[3:, :3]
    shadow = (
        (MODELED_SHADOW_PX if found.shadows else SHADOW_PX) * found.dark * float(np.linalg.norm(found.light[2:]))
    )
    known[:, :2, :2] += (COMMON_PX / focal_px) ** 2 * np.eye(2)
    known[TILT_SCALES:, :2, :2] += (shadow / focal_px) ** 2 * np.eye(2)  # all but the lamp at the lens
    return Lights(
        found.expected,
        found.across,
        found.place - gains @ found.light,
        known,
        np.log(prior),
        fit(found.light, spreads),
    )


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
