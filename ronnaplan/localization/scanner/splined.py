"""The slices from which a scan's were computed by cubic splines.

Who resamples thick slices to thinner ones by cubic splines leaves slices that overshoot beside what thick ones cut off:
no slice profile shows a ball so. But along each column of voxels all values lie on one chain of cubics, whose knots are
the measured slices, to rounding; nothing that has noise of its own does. Where the knots are is looked for by how much
the best chain leaves over of some columns. With it fitted to all columns, its values at the knots are the scan that was
made.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ronnaplan.ct.volume import CTVolume, VolumeFlag, Voxels
from ronnaplan.geometry import FloatArray
from ronnaplan.localization.scanner.measured import CHANGE_HU

CLOSEST, FARTHEST, STEP, PHASES = 1.5, 12.0, 1.015, 16
"""Measured slices lie so many computed ones apart, between which all distances at such ratios and so many phases of
each are looked at."""

LEAST_SLICES, AT_FIRST = 16, 32
"""So few slices tell nothing of knots; so many tell where they are about."""

ALIKE = 0.0
"""How slices bend goes along with how the next ones do, by a coefficient of correlation above this: by 0.1 to 0.7 where
splines computed them, by -0.7 to -0.1 where noise is each slice's own. The others cost no search."""

COLUMNS, SAMPLED, NOISE_ENDS = 128, 48, 5.0
"""So many columns of voxels tell, half of them any, half those that change most of so many rows and columns. What bends
by more medians than this is no noise."""

LEFT_HU, ROUNDED_HU = 0.5, 2.0
"""Rounding leaves 0.3 HU of each voxel over at the RMS, and cutting fractions off toward zero 0.35; 1.5 HU at most."""

FEW, CLEARLY = 32, 0.5
"""So many columns tell which knots to look at closely: those that leave less than this share of what is usual at their
distance."""

UNLIKE = 4.0
"""Knots that are half their distance off leave so many times as much over: else the image is smooth, and tells none."""

NARROWER, ROUNDS, AROUND = 0.6, 14, np.linspace(-1.0, 1.0, 5)
"""Knots are looked for about the best so often, each time so much more narrowly, at so many places and distances."""

ROWS_AT_ONCE = 16

TINY = 0.01
"""A knot this share of their distance beyond the outermost slice is still told by it."""


@dataclass(frozen=True)
class _Knots:
    """Where knots are, as slice indices: ``step`` apart, one at ``middle``."""

    middle: float
    step: float

    def within(self, count: int) -> FloatArray:
        """Return the knots (N,) among so many slices."""
        first = math.ceil(-self.middle / self.step - TINY)
        last = math.floor((count - 1 - self.middle) / self.step + TINY)
        return self.middle + self.step * np.arange(first, last + 1, dtype=np.float64)

    def splines(self, places: FloatArray, count: int) -> FloatArray:
        """Return the basis splines (P, M) of all that reach so many slices, at ``places`` (P,)."""
        first = math.floor(-self.middle / self.step) - 1
        last = math.ceil((count - 1 - self.middle) / self.step) + 1
        apart = np.abs((places[:, np.newaxis] - self.middle) / self.step - np.arange(first, last + 1))
        near, far = 2.0 / 3.0 - apart**2 + apart**3 / 2.0, np.maximum(2.0 - apart, 0.0) ** 3 / 6.0
        basis: FloatArray = np.where(apart < 1.0, near, far)
        return basis


def before_splines(volume: CTVolume) -> CTVolume:
    """Return the scan of which cubic splines made this one, flagged so; itself where none did."""
    voxels_hu = volume.voxels_hu
    if len(voxels_hu) < LEAST_SLICES or not volume.grid.is_evenly_spaced:
        return volume
    aside = max(len(voxels_hu) - AT_FIRST, 0) // 2
    if _bend_alike(voxels_hu[aside : len(voxels_hu) - aside]) < ALIKE:
        return volume
    knots = _knots(voxels_hu)
    if knots is None:
        return volume
    thick = _at_knots(voxels_hu, knots)
    if thick is None:
        return volume
    grid = volume.grid.at_slices(knots.within(len(voxels_hu)))
    return replace(volume.flagged(VolumeFlag.REFORMATTED), voxels_hu=thick, grid=grid)


def _sampled(voxels_hu: Voxels) -> FloatArray:
    """Return some columns (K, N) of all slices."""
    _, rows, columns = voxels_hu.shape
    some = voxels_hu[:, :: max(rows // SAMPLED, 1), :: max(columns // SAMPLED, 1)]
    return some[:, _is_within(some)].astype(np.float64)


def _is_within(voxels_hu: Voxels) -> NDArray[np.bool_]:
    """Tell which columns (...) of voxels (K, ...) the scale's ends did not cut off."""
    within: NDArray[np.bool_] = (voxels_hu.min(axis=0) > voxels_hu.min()) & (
        voxels_hu.max(axis=0) < voxels_hu.max()
    )
    return within


def _bend_alike(voxels_hu: Voxels) -> float:
    """Return the correlation of how neighbouring slices bend, without the edges."""
    bends = np.diff(_sampled(voxels_hu), 2, axis=0)
    if not bends.size or not bends.any():
        return 0.0
    ends = NOISE_ENDS * float(np.median(np.abs(bends))) + 1.0
    one, other = bends[:-1], bends[1:]
    seen = (np.abs(one) < ends) & (np.abs(other) < ends)
    squares = float(np.sqrt(np.sum(one[seen] ** 2) * np.sum(other[seen] ** 2)))
    return float(np.sum(one[seen] * other[seen])) / squares if squares > 0.0 else 0.0


def _knots(voxels_hu: Voxels) -> _Knots | None:
    """Return the knots of the chains of cubics on which some columns lie; None where they lie on none."""
    lines = _sampled(voxels_hu)
    changes_hu = np.ptp(lines, axis=0)
    if np.count_nonzero(changes_hu > CHANGE_HU) < COLUMNS:
        return None
    evenly = np.linspace(0, len(changes_hu) - 1, COLUMNS // 2).astype(int)
    lines = lines[:, np.concatenate([evenly, np.argsort(changes_hu)[-COLUMNS // 2 :]])]
    count = len(lines)
    reach = min(AT_FIRST, count)
    start = (count - reach) // 2
    at_first = lines[start : start + reach]
    narrowed = (_narrowed(at_first, one, reach) for one in _roughly(at_first))
    found = next((one for one in narrowed if _left_hu(at_first, one) < LEFT_HU), None)
    if found is None:
        return None
    while reach < count:
        before, reach = start, min(2 * reach, count)
        start = (count - reach) // 2
        found = replace(found, middle=found.middle + before - start)
        found = _narrowed(lines[start : start + reach], found, reach)
    left_hu = _left_hu(lines, found)
    shifted_hu = _left_hu(lines, replace(found, middle=found.middle + found.step / 2.0))
    return found if left_hu < LEFT_HU and shifted_hu > UNLIKE * left_hu else None


def _roughly(lines_hu: FloatArray) -> list[_Knots]:
    """Return knots that leave clearly less over of columns (K, N) than others do, farthest apart first.

    Knots at half the distance and less, with others between, leave as little over.
    """
    few = lines_hu[:, : 2 * FEW : 2]  # mostly noise, which tells best about where
    steps = CLOSEST * STEP ** np.arange(int(math.log(FARTHEST / CLOSEST) / math.log(STEP)) + 1)
    middle = (len(lines_hu) - 1) / 2.0
    tried = [[_Knots(middle + step * n / PHASES, float(step)) for n in range(PHASES)] for step in steps]
    left_hu = np.array([[_left_hu(few, one) for one in at_step] for at_step in tried])
    least = left_hu.min(axis=1)
    padded = np.pad(least, 1, constant_values=np.inf)
    is_lowest = (least <= padded[:-2]) & (least <= padded[2:]) & (least < CLEARLY * np.median(left_hu, axis=1))
    return [tried[n][int(np.argmin(left_hu[n]))] for n in np.flatnonzero(is_lowest)[::-1]]


def _narrowed(lines_hu: FloatArray, found: _Knots, reach: int) -> _Knots:
    """Return the best knots about those that were ``found``, of columns (K, N) of which half as many told them."""
    by_middle, by_step = found.step / PHASES, found.step * (STEP - 1.0) * AT_FIRST / reach
    middle = (len(lines_hu) - 1) / 2.0
    for _ in range(ROUNDS):
        near = found.middle + found.step * round((middle - found.middle) / found.step)
        tried = [_Knots(near + by_middle * m, found.step + by_step * s) for m in AROUND for s in AROUND]
        found = min(tried, key=lambda one: _left_hu(lines_hu, one))
        by_middle, by_step = NARROWER * by_middle, NARROWER * by_step
    return found


def _left_hu(lines_hu: FloatArray, knots: _Knots) -> float:
    """Return what chains of cubics with these ``knots`` leave over of columns (K, N), RMS of what they leave free."""
    count = len(lines_hu)
    splines = knots.splines(np.arange(float(count)), count)
    splines = splines[:, splines.any(axis=0)]
    base = np.linalg.qr(splines)[0]
    left = lines_hu - base @ (base.T @ lines_hu)
    return math.sqrt(float(np.sum(left**2)) / (max(count - splines.shape[1], 1) * lines_hu.shape[1]))


def _at_knots(voxels_hu: Voxels, knots: _Knots) -> Voxels | None:
    """Return what was measured (N, J, I) at the ``knots``; None unless all columns within the scale lie on chains."""
    count, rows, columns = voxels_hu.shape
    splines = knots.splines(np.arange(float(count)), count)
    heights = np.linalg.pinv(splines)
    told = (knots.splines(knots.within(count), count) @ heights).astype(np.float32)
    chain = (splines @ heights).astype(np.float32)
    within = _is_within(voxels_hu)
    thick = np.empty((len(told), rows, columns), dtype=voxels_hu.dtype)
    for row in range(0, rows, ROWS_AT_ONCE):
        here = voxels_hu[:, row : row + ROWS_AT_ONCE].astype(np.float32)
        some = here.reshape(count, -1)
        left = np.abs(some - chain @ some)[:, within[row : row + ROWS_AT_ONCE].ravel()]
        if left.max(initial=0.0) > ROUNDED_HU:
            return None
        values = (told @ some).reshape(len(told), *here.shape[1:])
        thick[:, row : row + ROWS_AT_ONCE] = values if thick.dtype == np.float32 else np.round(values)
    return thick
