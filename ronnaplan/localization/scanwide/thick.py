"""Slices far thicker than their header says, or far thinner: its balls together tell, and its noise.

A fit is given up where the profile becomes wider than any ball explains beside the header's slice thickness
(`descent.is_no_marker`). Where a filter ran along thin slices, or the tag holds a row's width, that is so of all small
balls of the scan. What has too wide a profile is then fitted anew as if the slices were as thick as it seemed. That is
believed if three balls are seen among it, and if the noise is as blurred as they are: eggs and capsules of one size
that stand along the slices' normal look like balls in thick slices, too, but nothing blurs the noise about them.

A tag far above the slices' distance is kept where reformats of thin slices hold that of what they were made for. There
the noise alone tells, before anything is looked for: with it fits begin far off, and balls on skin are led astray.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ronnaplan.ct.volume import CTVolume
from ronnaplan.localization.examine import LEAST_TOGETHER, Examine, Examined, distinct
from ronnaplan.localization.fit.parameters import WIDTH
from ronnaplan.localization.scanner.scan import Scan
from ronnaplan.localization.scanwide.usual import OF_THE_PROFILE

NO_BALL = {"stayed", "contrast", "blur", "free"}
"""Tests that say, however wide the profile is, that nothing there is a ball."""

ALIKE_NOISE = 0.25
"""Noise of slices half a profile's width apart is alike to 0.5 of its variance where the profile is a box, to 0.47
where it is a Gaussian, and not where slices are thin. Half of this is asked for."""

TOO_THICK = 2.0
"""Slices that are said to be thicker than so many times their distance are doubted."""

PAIRS, NOISE_ENDS = 16, 5.0
"""So many pairs of slices tell how alike noise is, by what differs by less than this many medians of what differs."""


def as_thick(scan: Scan, examined: Sequence[Examined], examine: Examine) -> Scan:
    """Return the scan with slices as thick as its balls and noise show them; as it is, if they do not.

    ``examined`` is what ``examine`` made of the scan as it is. Nothing changes in a scan that shows a marker, nor where
    all fits went to their ends (`usual.usual_of`).
    """
    too_wide = [one for one in examined if one.failed >= OF_THE_PROFILE and not one.failed & NO_BALL]
    is_given_up = any("converged" in one.failed for one in too_wide)
    if not is_given_up or len(too_wide) < LEAST_TOGETHER or any(one.is_marker for one in examined):
        return scan
    seems_mm = float(np.median([one.parameters[WIDTH] for one in too_wide]))
    wanted = [(one.candidate_mm, one.stated_mm) for one in too_wide]
    again = examine(of_thickness(scan, seems_mm), wanted)
    balls = distinct(one for one in again if one.failed <= OF_THE_PROFILE)
    if len(balls) < LEAST_TOGETHER:
        return scan
    shown_mm = float(np.median([one.parameters[WIDTH] for one in balls]))
    return of_thickness(scan, shown_mm) if noise_alike(scan.volume, shown_mm / 2.0) >= ALIKE_NOISE else scan


def as_thin(scan: Scan) -> Scan:
    """Return the scan with slices as thick as their distance, if its header says far more, and its noise does not.

    Slices that overlap so far share their noise.
    """
    stated_mm = scan.volume.grid.thickness_mm or 0.0
    if stated_mm <= TOO_THICK * scan.gap_mm or not noise_alike(scan.volume, stated_mm / 2.0) < ALIKE_NOISE:
        return scan
    return of_thickness(scan, scan.gap_mm)


def noise_alike(volume: CTVolume, apart_mm: float) -> float:
    """Return the correlation of the noise of slices that lie about ``apart_mm`` apart; NaN where there is none.

    Noise is what differs between neighbouring pixels, without the edges that few of them have between them. What is cut
    off at the scale's lower end shows none, nor does what fills more than half of the slices with one value: padding.
    """
    gaps_mm, voxels_hu = volume.grid.spacings_mm, volume.voxels_hu
    apart = max(round(apart_mm / float(np.median(gaps_mm))), 1) if gaps_mm.size else len(voxels_hu)
    last = len(voxels_hu) - apart
    if last < 1:
        return math.nan
    firsts = np.unique(np.linspace(0, last - 1, min(PAIRS, last)).astype(int))
    both_hu = np.stack([voxels_hu[firsts], voxels_hu[firsts + apart]]).astype(np.float64)
    is_seen = ((both_hu > voxels_hu.min()) & (both_hu != np.median(both_hu))).all(axis=0)
    differ_hu = np.diff(both_hu, axis=-1)[:, is_seen[..., 1:] & is_seen[..., :-1]]
    if not differ_hu.size:
        return math.nan
    ends_hu = NOISE_ENDS * np.median(np.abs(differ_hu))
    one, other = differ_hu[:, (np.abs(differ_hu) < ends_hu).all(axis=0)]
    noise_hu2 = float(one @ one + other @ other) / 2.0
    return float(one @ other) / noise_hu2 if noise_hu2 > 0.0 else math.nan


def of_thickness(scan: Scan, thickness_mm: float) -> Scan:
    """Return the scan as if its header said that the slices are so thick."""
    grid = replace(scan.volume.grid, thickness_mm=thickness_mm)
    return Scan(replace(scan.volume, grid=grid), scan.slant, whole=scan, summed=scan.summed)
