"""A screw that crosses some of a ball's slices, on one side of its center only, pulls the ball across its post.

Rays that run along a slice through the screw and the ball are weakened far more than in proportion, so that the ball is
fainter there in a streak. Of a post that is tilted out of the slices, that is so at one of the ball's poles, which then
seems to lie farther in: the center is moved away from it, by up to 56 um. The other slices show the ball as it is. What
they say alone tells how far the others pull. The pull is a random effect, believed as far as it stands out from how
well these slices tell the center. Where they are too few to tell it, it is stated as error.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ronnaplan.ct.volume import CTVolume
from ronnaplan.geometry import FloatArray
from ronnaplan.localization.fit.algebra import inverse
from ronnaplan.localization.fit.ball_fit import BallFit
from ronnaplan.localization.fit.model import METAL_CONTRAST_HU, has_layer
from ronnaplan.localization.fit.parameters import CENTER, CONTRAST, RADIUS, WIDTH
from ronnaplan.localization.judge.held import Beyond, is_metal_beyond, what_touches
from ronnaplan.localization.judge.part import HALF_A_BALL, fit_by_part, is_plain
from ronnaplan.localization.judge.uncertainty import ADAPTED_SLICES, WEIGHTS, by_slices

LEAST_KEPT = 0.4
"""Slices that no screw crosses tell a center if they hold so much of the diameter, and `ADAPTED_SLICES` of a profile's
width at least: a single slice is explained by any radius, with a center up to 140 um off."""

CROSSED_PULL_MM = 0.013
"""Standard deviation of a pull along each axis: screws of titanium and steel pull by up to 56 um, 17 um RMS by a soft
kernel and 7 um by a sharp one (113 balls of glass and plastic)."""

FAINTER = 0.08
"""Standard deviation of the share by which a ball is fainter where a screw crosses it: up to 0.22 was seen. Balls of 8
mm in thin slices are pulled by `CROSSED_PULL_MM` by it."""

STILL_CROSSED = 0.4
"""So much of a pull that is made good is stated as error: so much of it is left at the root mean square."""

AROUND = 48
"""Metal beside a ball is looked for in so many directions within its slices."""

PRIOR: Final = CROSSED_PULL_MM**2 * np.eye(3)
"""Covariance (3, 3) of a pull before anything is measured, mm^2."""


def without_the_screw(volume: CTVolume, fit: BallFit) -> BallFit:
    """Return the fit of a ball without the pull of a screw that crosses slices on one side of its center only.

    As it is, where none does so. That is not asked of metal, hollow or wrapped balls, which other things bend.
    """
    if not is_plain(fit):
        return fit
    clear = _clear_of_screws(volume, fit)
    if clear is None:
        return fit
    around = fit.neighbourhood.select(fit.used & clear)
    alone = fit_by_part(fit, around, np.ones(len(around.values_hu), dtype=np.bool_))
    if alone is None:
        return fit
    off_mm = alone.theta[CENTER] - fit.theta[CENTER]
    farther_mm = _farther_mm(fit, off_mm, around.offsets_mm)
    noise_mm2 = HALF_A_BALL**2 * WEIGHTS["slices"] * by_slices(alone) + np.outer(farther_mm, farther_mm)
    believed = PRIOR @ inverse(PRIOR + noise_mm2)
    moved_mm = believed @ (off_mm - farther_mm)
    left_mm = STILL_CROSSED * moved_mm
    return replace(
        fit,
        theta=np.append(fit.theta[CENTER] + moved_mm, fit.theta[RADIUS:]),
        by_part_mm2=PRIOR - believed @ PRIOR + np.outer(left_mm, left_mm),
    )


def untold_mm2(volume: CTVolume, fit: BallFit, touching: Beyond) -> FloatArray:
    """Covariance (3, 3) in LPS, mm^2, of the pull of a screw that leaves too few slices clear to tell it.

    The screw makes what it crosses of a ball fainter. What that does to the center, the voxels' influence tells: much
    where few thick slices hold a ball, whose edges tell less and whose levels tell more; nothing where both halves are
    crossed alike. It is stated of clipped balls of ceramic, too, which slices without the screw are not asked about.
    ``fit`` is that of the whole ball, ``touching`` what `held.what_touches` tells of it.
    """
    is_asked = fit.by_part_mm2 is None and (is_plain(fit) or _is_clipped_ceramic(fit))
    crossed_mm = _crossed_mm(volume, fit, touching) if is_asked else None
    if crossed_mm is None:
        return np.zeros((3, 3))
    across = fit.neighbourhood.across
    heights_mm = fit.neighbourhood.offsets_mm[:, across] - fit.theta[CENTER][across]
    beyond_mm = np.maximum(crossed_mm[0] - heights_mm, heights_mm - crossed_mm[1])
    share = np.clip(1.0 - beyond_mm / _beside_mm(volume, fit), 0.0, 1.0)
    ball_hu = fit.contrast_hu * fit.jacobian[:, CONTRAST]
    pull_mm = FAINTER * float(fit.influence_mm_per_hu[:, across] @ (share * ball_hu))
    normal = fit.neighbourhood.axes[across]
    stated: FloatArray = pull_mm**2 * np.outer(normal, normal)
    return stated


def _is_clipped_ceramic(fit: BallFit) -> bool:
    """Whether the scale hides how a ball is shaded that has less contrast than metal."""
    return (
        fit.converged and not fit.is_shaded and fit.contrast_hu <= METAL_CONTRAST_HU and not has_layer(fit.theta)
    )


def is_beside_metal(volume: CTVolume, fit: BallFit) -> bool:
    """Whether there is metal beside a ball in its middle slices, as far off as screws are looked for."""
    turns = np.linspace(0.0, 2.0 * np.pi, AROUND, endpoint=False)
    within = np.delete(fit.neighbourhood.axes, fit.neighbourhood.across, axis=0)
    around = np.stack([np.cos(turns), np.sin(turns)], axis=-1) @ within
    return is_metal_beyond(volume, fit, around)


def _farther_mm(fit: BallFit, off_mm: FloatArray, clear_mm: FloatArray) -> FloatArray:
    """What of ``off_mm`` (3,) leads farther from the screw, towards the voxels ``clear_mm`` (N, 3): an error of theirs.

    A screw pulls a ball away from itself, so that slices without it put the center nearer to it. Half a ball tells its
    radius and its center along the normal together, and errs towards its pole where the profile is not quite as fitted.
    """
    across, farther_mm = fit.neighbourhood.across, np.zeros(3)
    if off_mm[across] * float(np.mean(clear_mm[:, across] - fit.theta[CENTER][across])) > 0.0:
        farther_mm[across] = off_mm[across]
    return farther_mm


def _clear_of_screws(volume: CTVolume, fit: BallFit) -> NDArray[np.bool_] | None:
    """Whether no screw crosses the slices of the voxels (N,) of a fit; None where none or too many are crossed."""
    crossed_mm = _crossed_mm(volume, fit, what_touches(volume, fit))
    if crossed_mm is None:
        return None
    radius_mm, width_mm = float(fit.theta[RADIUS]), float(fit.theta[WIDTH])
    low_mm, high_mm = crossed_mm[0] - _beside_mm(volume, fit), crossed_mm[1] + _beside_mm(volume, fit)
    above_mm, below_mm = radius_mm - high_mm, low_mm + radius_mm
    least_mm = max(LEAST_KEPT * 2.0 * radius_mm, ADAPTED_SLICES * max(width_mm, volume.grid.typical_gap_mm))
    if max(above_mm, below_mm) < least_mm:
        return None
    across = fit.neighbourhood.across
    heights_mm = fit.neighbourhood.offsets_mm[:, across] - fit.theta[CENTER][across]
    is_clear: NDArray[np.bool_] = heights_mm > high_mm if above_mm > below_mm else heights_mm < low_mm
    return is_clear


def _crossed_mm(volume: CTVolume, fit: BallFit, touching: Beyond) -> tuple[float, float] | None:
    """From what height over a ball's center to what height metal lies beside it; None where its slices cross none.

    Slices as they were measured: rays run across the patient's axis in coronal and sagittal pictures, too.
    """
    radius_mm, axes = float(fit.theta[RADIUS]), fit.neighbourhood.axes
    if not len(touching.metal_mm):
        return None
    heights_mm = touching.metal_mm @ axes[fit.neighbourhood.across]
    low_mm, high_mm = float(heights_mm.min()), float(heights_mm.max())
    beyond_mm = radius_mm + _beside_mm(volume, fit)
    return (low_mm, high_mm) if low_mm < beyond_mm and high_mm > -beyond_mm else None


def _beside_mm(volume: CTVolume, fit: BallFit) -> float:
    """How far from metal a slice still crosses it."""
    return (float(fit.theta[WIDTH]) + volume.grid.typical_gap_mm) / 2.0
