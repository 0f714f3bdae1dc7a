"""Slices that were computed at another spacing than that of the measured ones: their noise beats.

A workstation that computes slices of 1 mm from slices of 0.8 mm takes each from the two about it, whose noise cancels
the more, the farther it lies from both: to half of its variance in the middle. How far that is goes round from slice to
slice, and so does the noise, as no scanner's does. As much goes round how thick the slices are, so that no profile
describes them all, and a ball's poles are displaced by what they met with. Where so many slices were computed that
straight lines tell it (`scanner.measured`), these are left out; here none is like a measured one.

Metal and balls that stand in some slices and not in the next ones make a scanner's noise go up and down, too. But what
was mixed of two slices has less noise the more of it it shares with its neighbours; streaks, the more, the more.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from kernelcache import njit
from ronnaplan.ct.volume import CTVolume, Voxels
from ronnaplan.geometry import FloatArray
from ronnaplan.localization.fit.algebra import quantile
from ronnaplan.threads import in_parts

DISPLACED_SHARE = 0.02
"""Standard error along the slices' normal, as a share of their distance, where they were computed so. Balls of 6 to
14 mm were displaced by 0.006 to 0.048 of it RMS in scans of three renderers, 0.022 in all."""

LEAST_SHARE, LEAST_AMPLITUDE, CHANCE = 0.4, 0.08, 1e-4
"""The noise beats if one wave makes such a share of how its logarithm changes from slice to slice, is as high as this,
and comes no oftener by chance (R. Fisher, Proc. R. Soc. A 125:54, 1929): 0.6 and more, and 0.1 to 0.3, where slices
were computed at 0.5 to 1.5 of their distance; in what was scanned as it is 0.25 and 0.05 at most."""

MOST_AMPLITUDE = 0.5
"""What two slices are mixed to has half of their noise's variance at least, so that its logarithm goes up and down by
0.35 (waves of 0.24 to 0.37 were seen). A higher wave is that of streaks, which some slices show and others do not."""

SOFT_HU = (-300.0, 500.0)
"""Noise is looked at in soft tissue: air may be cut off, and bone is all edges."""

SLOW, OPPOSED = 0.3, -0.5
"""What stands in several slices makes waves below the first frequency. There a beat is told only if what neighbours
share of their noise goes against it, by this coefficient of correlation: by -0.78 to -1 in what was computed at 0.64 to
1.2 of the distance, in 16 of 18 heads with crowns, screws and nuts by -0.5 to 0.6."""

ROWS, LEAST_SEEN = 16, 300
"""So many rows of a slice tell its noise, if they show so much soft tissue."""

NOISE_ENDS = 3.0
"""What bends by more than this many medians is an edge."""

AROUND = 6
"""What changes slowly is what differs along the head: a parabola through the slices so far to either side."""

OF_A_WAVE = 3
"""A wave has a height, a phase and a frequency: so few slices it fits, whatever their noise."""

LOWEST, FREQUENCIES = 0.08, 400
"""Waves from this many to half a period for each slice are looked for."""


def noise_beats(volume: CTVolume) -> bool:
    """Whether the noise of a scan's slices goes round from one to the next, as it does where they were computed."""
    voxels_hu = volume.voxels_hu
    if len(voxels_hu) <= 2 * AROUND:
        return False
    every = max(voxels_hu.shape[1] // ROWS, 1)
    noise = np.concatenate(in_parts(lambda first, end: _noise(voxels_hu[first:end, ::every]), len(voxels_hu)))
    left = _without_what_is_slow(np.log(noise))
    told = np.flatnonzero(np.isfinite(left))
    square = float(np.sum(left[told] ** 2))
    if len(told) <= OF_A_WAVE or square == 0.0:
        return False
    explained, wave = _explained(left[told], told)
    share, highest = explained / square, float(np.sqrt(2.0 * explained / len(told)))
    is_chance = len(told) / 2.0 * max(1.0 - share, 0.0) ** ((len(told) - OF_A_WAVE) / 2.0) > CHANCE
    if is_chance or share <= LEAST_SHARE or not LEAST_AMPLITUDE < highest < MOST_AMPLITUDE:
        return False
    return wave.frequency > SLOW or _is_opposed(_without_what_is_slow(_shared(voxels_hu[:, ::every])), wave, told)


class _Wave(NamedTuple):
    """A wave of a ``frequency`` per slice, in its own phase."""

    frequency: float
    cos: float
    sin: float

    def at(self, places: NDArray[np.intp]) -> FloatArray:
        """Its height (N,) at ``places`` (N,)."""
        phases = 2.0 * np.pi * self.frequency * places
        height: FloatArray = self.cos * np.cos(phases) + self.sin * np.sin(phases)
        return height


def _is_opposed(shared: FloatArray, wave: _Wave, told: NDArray[np.intp]) -> bool:
    """Whether what slices share with their neighbours (K,) goes against a wave at the places (N,) that are told."""
    told = told[np.isfinite(shared[told])]
    if len(told) <= OF_A_WAVE or np.ptp(shared[told]) == 0.0:
        return False
    return bool(np.corrcoef(wave.at(told), shared[told])[0, 1] < OPPOSED)


def _shared(slices: Voxels) -> FloatArray:
    """How far the bends of ``slices`` (K, J, I) go along with those of the two beside each (K,); NaN if none tell."""
    values = slices.astype(np.float64)
    is_soft = (values > SOFT_HU[0]) & (values < SOFT_HU[1])
    bends = values[..., :-2] - 2.0 * values[..., 1:-1] + values[..., 2:]
    seen = (is_soft[..., :-2] & is_soft[..., 1:-1] & is_soft[..., 2:]).reshape(len(slices), -1)
    bends = bends.reshape(len(slices), -1)
    for some, told in zip(bends, seen, strict=True):
        told &= np.abs(some) < NOISE_ENDS * (np.median(np.abs(some[told])) if told.any() else 0.0) + 0.5
    both = seen[:-1] & seen[1:]
    before, behind = np.where(both, bends[:-1], 0.0), np.where(both, bends[1:], 0.0)
    squares = np.sum(before**2, axis=1) * np.sum(behind**2, axis=1)
    is_told = (np.count_nonzero(both, axis=1) >= LEAST_SEEN) & (squares > 0.0)
    along = np.where(is_told, np.sum(before * behind, axis=1) / np.sqrt(np.where(is_told, squares, 1.0)), np.nan)
    shared = np.full(len(slices), np.nan)
    shared[1:-1] = (along[:-1] + along[1:]) / 2.0
    return shared


def _explained(values: FloatArray, places: NDArray[np.intp]) -> tuple[float, _Wave]:
    """How much of the sum of squares of ``values`` (N,) at ``places`` (N,) the best wave makes, fitted to each."""
    frequencies = np.linspace(LOWEST, 0.5, FREQUENCIES, endpoint=False)
    phases = 2.0 * np.pi * np.outer(frequencies, places)
    cos, sin = np.cos(phases), np.sin(phases)
    by_cos, by_sin = cos @ values, sin @ values
    cos_cos, sin_sin, cos_sin = (
        np.sum(one * other, axis=1) for one, other in ((cos, cos), (sin, sin), (cos, sin))
    )
    explained = sin_sin * by_cos**2 - 2.0 * cos_sin * by_cos * by_sin + cos_cos * by_sin**2
    most = int(np.argmax(explained / (cos_cos * sin_sin - cos_sin**2)))
    parts = by_cos * sin_sin - by_sin * cos_sin, by_sin * cos_cos - by_cos * cos_sin
    square = (cos_cos * sin_sin - cos_sin**2)[most]
    height = (float(part[most] / square) for part in parts)
    return float(explained[most] / square), _Wave(float(frequencies[most]), *height)


def _without_what_is_slow(values: FloatArray) -> FloatArray:
    """Return what is left of ``values`` (K,) beside parabolas through those about each; NaN at both ends."""
    places = np.arange(-AROUND, AROUND + 1.0)
    middle = np.linalg.pinv(np.vander(places, 3))[-1]  # what of each the parabola's value in the middle is made of
    left = np.full(len(values), np.nan)
    left[AROUND:-AROUND] = values[AROUND:-AROUND] - np.convolve(values, middle, "valid")
    return left


@njit(cache=True, nogil=True)
def _noise(slices: Voxels) -> FloatArray:
    """Mean square (K,) of how the ``slices`` (K, J, I) bend along their rows; NaN where too little is seen."""
    count, rows, columns = slices.shape
    noise, bends = np.full(count, np.nan), np.empty(rows * columns)
    for k in range(count):
        seen = 0
        for j in range(rows):
            for i in range(1, columns - 1):
                before, here, behind = (
                    float(slices[k, j, i - 1]),
                    float(slices[k, j, i]),
                    float(slices[k, j, i + 1]),
                )
                if min(before, here, behind) > SOFT_HU[0] and max(before, here, behind) < SOFT_HU[1]:
                    bends[seen] = abs(before - 2.0 * here + behind)
                    seen += 1
        if seen < LEAST_SEEN:
            continue
        most, total, counted = NOISE_ENDS * quantile(bends[:seen], 0.5) + 0.5, 0.0, 0
        for n in range(seen):
            if bends[n] < most:
                total += bends[n] * bends[n]
                counted += 1
        noise[k] = total / counted if total > 0.0 else np.nan
    return noise
