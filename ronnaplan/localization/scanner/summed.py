"""What slices do to a ball whose rays are summed before the logarithm is taken, and whether a scan's were.

A detector as wide as the slice adds up what it receives over the slice's height, and the logarithm of that is what its
rays are taken to have lost: less than they lose on the average, by half the variance of the loss within the slice
(G. Glover and N. Pelc, Medical Physics 7:238, 1980). That thins the poles of a ball, where its chords change within a
slice, and displaces it towards where what else lies in its rays takes more: by the slope of that loss over the height
times the variance of the slice's profile. Scanners of many rows take the logarithm first. The poles tell which it was.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

import numpy as np

from kernelcache import njit
from ronnaplan.ct.volume import CTVolume, Voxels
from ronnaplan.geometry import FloatArray
from ronnaplan.localization.fit.ball_fit import BallFit
from ronnaplan.localization.fit.model import spheres
from ronnaplan.localization.fit.neighbourhood import Neighbourhood, first_of_each
from ronnaplan.localization.fit.parameters import (
    BLUR,
    EDGE,
    RADIUS,
    SHAPE,
    WIDTH,
    U,
    V,
    W,
    profile_half_mm,
)

WATER_PER_MM = 0.0195
"""What a mm of water takes of a ray's logarithm, at the energies of CT (70 keV)."""

HEIGHTS, CHORDS, FREQUENCIES, RADII = 32, 96, 96, 128
"""So many heights in a slice, chords of a ball, frequencies and radii of a picture tell what is lost, to 1 %."""

HIGHEST_SIGMAS, HIGHEST_PER_MM = 0.75, 2.0
"""The blur passes next to nothing above the first frequency, in cycles for each of its standard deviations, and no
scanner does above the second."""

ANGLES, BESSEL_STEP = 192, 0.05
"""Bessel's function is a mean over so many directions, tabulated so closely; it is exact to 3e-4."""

NO_LOSS_HU = -850.0
"""What is below is air: its noise and its rounding would add up over a picture."""

PADDING_HU = 31000.0
"""What is brighter than any scale goes is padding that no tag tells (-2000, say, that was stored without its sign)."""

SPARSE_MM = 3.0
"""Pixels so far apart tell what lies beside a ball."""

BESIDE = 1.25
BESIDE_MM = 1.0
"""What lies nearer to a ball's center than this many radii and this is the ball, or hides within its own edge."""

LEAST_SLOPE_PER_MM = 0.012
"""What summing does to the poles is at least as bad as such a slope: so much more of a ray's logarithm does a head take
for each mm of height beside its middle (0.05 on its top)."""


@dataclass(frozen=True)
class Summed:
    """Whether a scan's rays were summed ``first``, before the logarithm, and with what standard error that is known.

    The ``error`` is a share of what summing does.
    """

    first: bool
    error: float

    def error_mm(self, width_mm: float, slope_per_mm: float) -> float:
        """Standard error along the slices' normal that is left to a ball in slices of this `WIDTH`."""
        return self.error * math.hypot(slope_per_mm, LEAST_SLOPE_PER_MM) * width_mm**2 / 12.0


UNTOLD = Summed(first=False, error=math.sqrt(0.5))
"""Where nothing tells, nothing is made good, though either is as likely as the other."""


def lost_hu(around: Neighbourhood, theta: FloatArray, slope_per_mm: float, layer_mm: float = 0.0) -> FloatArray:
    """HU (N,) by which a ball of parameters ``theta`` (P,) is darker where the rays were summed first.

    ``slope_per_mm`` says how much more of the logarithm all else takes for each mm of height, ``layer_mm`` how the
    ball is made, as in `Build`.
    """
    first = first_of_each(around.slices)
    from_axis_mm = np.hypot(around.offsets_mm[:, U] - theta[U], around.offsets_mm[:, V] - theta[V])
    radii_mm = np.linspace(0.0, float(from_axis_mm.max()), RADII)
    lost = _lost(around.offsets_mm[first, W] - theta[W], theta, layer_mm, slope_per_mm)
    pictures_hu = _pictures_hu(lost, theta, radii_mm)
    of_slices_mm = np.split(from_axis_mm, first[1:])
    return np.concatenate(
        [
            np.interp(seen_mm, radii_mm, picture_hu)
            for seen_mm, picture_hu in zip(of_slices_mm, pictures_hu, strict=True)
        ]
    )


def lost_to_summing_hu(volume: CTVolume, fit: BallFit) -> FloatArray:
    """HU (N,) by which the voxels of a ball's fit are darker where rays were summed first."""
    slope_per_mm = slope_beside_per_mm(volume, fit.center_mm, fit.diameter_mm / 2.0)
    return lost_hu(fit.neighbourhood, fit.theta, slope_per_mm, fit.prior.layer_mm)


def _beside_mm(theta: FloatArray) -> FloatArray:
    """How far from a ball's center its `CHORDS` lie."""
    return (np.arange(CHORDS) + 0.5) / CHORDS * float(theta[RADIUS])


def _lost(places_mm: FloatArray, theta: FloatArray, layer_mm: float, slope_per_mm: float) -> FloatArray:
    """How much of the logarithm is lost to each chord (K, `CHORDS`) of a ball in slices at ``places_mm`` (K,)."""
    heights_mm, profile = profile_seen(theta)
    from_middle_mm = places_mm[:, np.newaxis, np.newaxis] + heights_mm
    losses = chord_losses(theta, layer_mm, _beside_mm(theta)[:, np.newaxis], from_middle_mm)
    other = slope_per_mm * heights_mm
    lost: FloatArray = (
        losses @ profile + np.log(np.exp(-losses - other) @ profile) - np.log(np.exp(-other) @ profile)
    )
    return lost


def chord_losses(
    theta: FloatArray, layer_mm: float, beside_mm: FloatArray, from_middle_mm: FloatArray
) -> FloatArray:
    """What a ball takes of the logarithm of rays (...) that pass so far beside and above its center.

    Those that pass its cavity, or what is wrapped around it, lose to that, too: less than nothing to a cavity.
    """
    squares_mm2 = beside_mm**2 + from_middle_mm**2
    losses_hu_mm = [
        level_hu * 2.0 * np.sqrt(np.maximum(radius_mm**2 - squares_mm2, 0.0))
        for radius_mm, level_hu in spheres(theta, layer_mm)
    ]
    losses: FloatArray = WATER_PER_MM / 1000.0 * np.sum(losses_hu_mm, axis=0)
    return losses


def profile_seen(theta: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Heights (mm, from its middle) within a slice, and how much what is there counts in it (`HEIGHTS`,)."""
    nodes, weights = _heights()
    profile = weights * (1.0 - nodes**2) ** float(theta[SHAPE])
    return profile_half_mm(float(theta[WIDTH]), float(theta[SHAPE])) * nodes, profile / profile.sum()


def kernel_passed(theta: FloatArray, count: int) -> tuple[FloatArray, FloatArray]:
    """So many frequencies (count,), 1/mm, evenly spaced from half a step on, and what the kernel passes of each."""
    blur_mm = float(theta[BLUR])
    step_per_mm = min(HIGHEST_SIGMAS / blur_mm, HIGHEST_PER_MM) / count
    frequencies = (np.arange(count, dtype=np.float64) + 0.5) * step_per_mm
    phases = 2.0 * np.pi * blur_mm * frequencies
    passed: FloatArray = np.exp(-0.5 * phases**2) * (1.0 + float(theta[EDGE]) * phases**2)
    return frequencies, passed


def _pictures_hu(lost: FloatArray, theta: FloatArray, radii_mm: FloatArray) -> FloatArray:
    """What back-projection through the kernel makes (K, R) of what is lost to a ball's chords (K, `CHORDS`)."""
    frequencies, passed = kernel_passed(theta, FREQUENCIES)
    step_per_mm = 2.0 * frequencies[0]
    chord_mm = float(theta[RADIUS]) / CHORDS
    spectrum = 2.0 * chord_mm * lost @ np.cos(2.0 * np.pi * np.outer(_beside_mm(theta), frequencies)) * passed
    rings = np.interp(2.0 * np.pi * np.outer(frequencies, radii_mm), *_bessel())
    pictures_hu: FloatArray = (spectrum * 2.0 * np.pi * frequencies * step_per_mm) @ rings * 1000.0 / WATER_PER_MM
    return pictures_hu


def slope_beside_per_mm(volume: CTVolume, center_mm: FloatArray, radius_mm: float) -> float:
    """How much more of a ray's logarithm all but a ball takes for each mm along the slices' normal.

    The mean over all rays through the ball's center: that of lines through a place is the sum of all else in the
    picture over its distance (J. Radon, 1917).
    """
    grid = volume.grid
    places_mm = grid.slice_positions_mm - center_mm @ grid.normal
    at_the_poles = []
    for pole_mm in (-radius_mm, radius_mm):
        above = int(np.searchsorted(places_mm, pole_mm))
        near = [number for number in (above - 1, above) if 0 <= number < len(places_mm)]
        losses = [_loss(volume, number, center_mm, radius_mm) for number in near]
        at_the_poles.append(float(np.interp(pole_mm, places_mm[near], losses)))
    return (at_the_poles[1] - at_the_poles[0]) / (2.0 * radius_mm)


def _loss(volume: CTVolume, number: int, center_mm: FloatArray, radius_mm: float) -> float:
    """What all but a ball takes of rays through its center, in one slice, on the average over all directions."""
    grid = volume.grid
    every = max(int(SPARSE_MM / grid.pixel_mm), 1)
    seen_hu = volume.voxels_hu[number, ::every, ::every]
    corner_mm = grid.axes[:2] @ (grid.origins_mm[number] - center_mm)
    steps_mm, padding_hu = every * grid.steps_mm, volume.padding_or_nan_hu
    beside_mm = BESIDE * radius_mm + BESIDE_MM
    return WATER_PER_MM / math.pi * _over_distance(seen_hu, corner_mm, steps_mm, padding_hu, beside_mm)


@njit(cache=True, nogil=True)
def _over_distance(picture: Voxels, corner: FloatArray, steps: FloatArray, padding: float, beside: float) -> float:
    """Integrate the density of a ``picture``, that of water being 1, over its distance from the origin, in mm.

    The ``corner`` (2,) is the place of the first pixel, and ``steps`` (2,) are between pixels; what lies ``beside`` the
    origin, no farther away than this, is left out.
    """
    total = 0.0
    for j in range(picture.shape[0]):
        v = corner[1] + j * steps[1]
        for i in range(picture.shape[1]):
            u, value = corner[0] + i * steps[0], float(picture[j, i])
            distance = math.sqrt(u * u + v * v)
            if NO_LOSS_HU < value < PADDING_HU and value != padding and distance > beside:
                total += (value + 1000.0) / 1000.0 / distance
    return float(total * steps[0] * steps[1])


@cache
def _heights() -> tuple[FloatArray, FloatArray]:
    nodes, weights = np.polynomial.legendre.leggauss(HEIGHTS)
    return nodes, weights


@cache
def _bessel() -> tuple[FloatArray, FloatArray]:
    """Bessel's function J0 in a table: SciPy has it, too, but takes longer to load than a scan to read."""
    x = np.arange(0.0, 1.5 * ANGLES, BESSEL_STEP)
    cosines = np.cos((np.arange(ANGLES) + 0.5) * np.pi / ANGLES)
    return x, np.cos(np.outer(x, cosines)).mean(axis=1)
