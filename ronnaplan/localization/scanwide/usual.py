"""What is usual in a scan: misfit, slice profile, softness and roundness that its markers show together.

What all of them show is the scanner's and says nothing against one of them; what one alone shows is its own.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ronnaplan.geometry import FloatArray
from ronnaplan.localization.build import Build
from ronnaplan.localization.examine import LEAST_TOGETHER, Examined, distinct, examine_place
from ronnaplan.localization.fit.parameters import WIDTH, softness_mm2
from ronnaplan.localization.judge.evidence import Usual
from ronnaplan.localization.scanner.scan import Scan
from ronnaplan.threads import single_threaded_algebra

ALIKE_MM = 0.75
ALIKE_SHARE = 0.6
"""Markers of one scan show the same slice profile, to within this or this share of its width."""

BLURRED_MM2 = 0.25
"""Nor is its edge softer (`softness_mm2`) than theirs at the median by more than this: one kernel makes all. Of 270
balls in ten scans none is by 0.07, nor by 0.02 but under a kernel that is fitted now one way, now the other; and a head
that jumps by 1 mm adds so much along the jump at most."""

OVAL_SHARE, OVALS = 0.04, 2.0
"""Within the slices a marker's semi-axes differ by no more than the first share and so many times what they do at the
median: by 0.013 in some 200 balls of 40 kinds of axial scans, also where the head jumped, for slices that lie aside
shear a ball but leave each cut round; by 0.06 in cone beams where 0.04 is usual. Eggs of 0.9 differ by 0.1, less the
square of the cosine between their axis and the slices' normal."""

OF_THE_SURFACE = {"coverage", "informed", "roundness", "whole"}
"""Tests that streaks of metal and of few views spoil in a whole scan, as in cone beams of a short turn."""

OF_THE_PROFILE = {"thickness"}
"""The test that a scan fails whose slices were computed from thicker ones, if its header does not say so."""


@dataclass(frozen=True)
class UsualInScan:
    """The balls of a scan, which tell what is usual at any height, and how much wider than nominal profiles may be."""

    balls: Sequence[Examined]
    broadening_mm: float = 0.0

    def near(self, one: Examined, normal: FloatArray) -> Usual:
        """Return what is usual about one place: misfit and size of those that are nearest along the ``normal`` (3,).

        Cone beams make edges the more ragged the farther these are from the plane of the source, metal in its slices.
        """
        nearest = sorted(self.balls, key=lambda ball: abs(float((ball.center_mm - one.center_mm) @ normal)))
        nearest = nearest[:LEAST_TOGETHER]
        return Usual(usual_misfit(nearest), self.broadening_mm, _usual_diameter_mm(nearest, one.stated_mm))


def usual_of(examined: Sequence[Examined]) -> UsualInScan:
    """Return what is usual in a scan; nothing where too few balls tell.

    Balls whose slice profile alone is too wide for the header tell, too, where all balls of the scan show the same.
    """
    markers = [one for one in examined if one.is_marker]
    balls = distinct(one for one in examined if one.failed <= OF_THE_PROFILE)
    if len(balls) >= LEAST_TOGETHER and not all(one.is_marker for one in balls):
        off = _off_profile(balls)
        same = [one for one, is_off in zip(balls, off, strict=True) if not is_off]
        is_the_scans = not any(one.is_marker and is_off for one, is_off in zip(balls, off, strict=True))
        if len(same) >= LEAST_TOGETHER and is_the_scans:
            return UsualInScan(same, _broadening_mm(balls) + ALIKE_MM)
    return UsualInScan(markers)


def by_the_usual(parts: Sequence[tuple[Scan, Sequence[Examined]]], build: Build) -> list[list[Examined]]:
    """Judge once more what was turned down for what is usual in a scan alone, by what all ``parts`` of it show.

    What is found so shows what is usual, too, where nothing was found before: a cone beam's edges are the more ragged
    the lower a ball is. So all is asked again while more is found.
    """
    judged, found = [list(examined) for _, examined in parts], -1
    with single_threaded_algebra():
        while (markers := sum(one.is_marker for part in judged for one in part)) > found:
            found, shown = markers, usual_of([one for part in judged for one in part])
            judged = [
                [judged_again(scan, one, build, shown) for one in part]
                for (scan, _), part in zip(parts, judged, strict=True)
            ]
    return judged


def judged_again(scan: Scan, one: Examined, build: Build, shown: UsualInScan) -> Examined:
    """Judge one place by what is usual about it, if it was turned down for nothing else."""
    if not one.failures or not one.failed <= OF_THE_SURFACE | OF_THE_PROFILE:
        return one
    usual = shown.near(one, scan.volume.grid.normal)
    excused = (OF_THE_SURFACE if usual.misfit > 0.0 else set()) | (
        OF_THE_PROFILE if usual.broadening_mm > 0.0 else set()
    )
    return examine_place(scan, one.candidate_mm, one.stated_mm, build, usual) if one.failed <= excused else one


def usual_misfit(balls: Sequence[Examined]) -> float:
    """Return the misfit (share of the contrast) that a scan's balls have; 0 where too few tell."""
    return float(np.median([one.misfit for one in balls])) if len(balls) >= LEAST_TOGETHER else 0.0


def _usual_diameter_mm(balls: Sequence[Examined], stated_mm: float) -> float:
    """Return the diameter as which a scan's balls of the stated one are fitted; NaN where too few tell."""
    fitted_mm = [one.diameter_mm for one in balls if one.stated_mm == stated_mm and not one.is_clipped]
    return float(np.median(fitted_mm)) if len(fitted_mm) >= LEAST_TOGETHER else math.nan


def _broadening_mm(balls: Sequence[Examined]) -> float:
    """By how much the balls' slice profiles usually are wider than nominal."""
    nominal, widths = _profiles_mm(balls)
    return float(np.median(widths - nominal))


def _off_profile(balls: Sequence[Examined]) -> NDArray[np.bool_]:
    """Which balls' slice profiles are unlike the others' (N,).

    Where slices lie farther apart in a part of a scan, they are either thicker there, or leave gaps: the profile is as
    much wider than nominal as elsewhere, or as wide.
    """
    nominal, widths = _profiles_mm(balls)
    off = np.full(len(balls), fill_value=True)
    for expected in (nominal + _broadening_mm(balls), np.full(len(balls), np.median(widths))):
        off &= np.abs(widths - expected) > np.maximum(ALIKE_MM, ALIKE_SHARE * expected)
    return off


def _profiles_mm(balls: Sequence[Examined]) -> tuple[FloatArray, FloatArray]:
    """Return how wide the slices' profile is by name (N,), not everywhere the same where gaps tell, and as fitted."""
    return np.array([one.thickness_mm for one in balls]), np.array([one.parameters[WIDTH] for one in balls])


def unlike_turned_down(accepted: Sequence[Examined]) -> list[Examined]:
    """Turn down what is unlike the scan's other markers: its profile is another, its edge softer, or it is more oval.

    One alone may be anything; of two nobody knows which is right.
    """
    if len(accepted) < LEAST_TOGETHER:
        return list(accepted)
    others_mm = float(np.median([one.parameters[WIDTH] for one in accepted]))
    judged = [
        _unlike(
            one, f"its ends are blurred over {one.parameters[WIDTH]:.1f} mm, the others' over {others_mm:.1f} mm"
        )
        if is_off
        else one
        for one, is_off in zip(accepted, _off_profile(accepted), strict=True)
    ]
    return _as_round(_as_sharp(judged))


def usual_profiles_mm(markers: Sequence[Examined]) -> list[float]:
    """Return for each marker how wide the slices' profile is (full width at half maximum).

    Of one scanner that is what the markers show at the median; where too few tell, each tells for itself.
    """
    shown_mm = [one.profile_mm for one in markers]
    return len(shown_mm) * [float(np.median(shown_mm))] if len(shown_mm) >= LEAST_TOGETHER else shown_mm


def _unlike(one: Examined, reason: str) -> Examined:
    return replace(one, failures=(("alike", reason),))


def _as_sharp(judged: Sequence[Examined]) -> list[Examined]:
    """Turn down what has a softer edge than the others; where metal is clipped, its contrast hides its blur."""
    tells = [one.is_marker and not one.is_clipped for one in judged]
    if sum(tells) < LEAST_TOGETHER:
        return list(judged)
    blurs_mm2 = np.array([softness_mm2(one.parameters) for one in judged])
    soft = tells & (blurs_mm2 > np.median(blurs_mm2[tells]) + BLURRED_MM2)
    reason = f"its edge is softer than the others' by more than {BLURRED_MM2:g} mm^2 of variance"
    return [_unlike(one, reason) if is_soft else one for one, is_soft in zip(judged, soft, strict=True)]


def _as_round(judged: Sequence[Examined]) -> list[Examined]:
    """Turn down what is more oval within the slices than the others; what lies on a ball makes it oval, too."""
    ovals = np.array([_oval(one.shape) if one.is_marker and one.shows_its_shape else math.nan for one in judged])
    if np.isfinite(ovals).sum() < LEAST_TOGETHER:
        return list(judged)
    usual = float(np.nanmedian(ovals))
    return [
        _unlike(one, f"it is oval by {oval:.1%} within the slices, the others by {usual:.1%}")
        if oval > OVALS * usual + OVAL_SHARE
        else one
        for one, oval in zip(judged, ovals, strict=True)
    ]


def _oval(shape: FloatArray) -> float:
    """By which share the semi-axes of an ellipsoid of a ``shape`` (3, 3) differ within the slices; NaN of none."""
    least, most = np.linalg.eigvalsh(shape[:2, :2])
    return 0.5 * math.log(most / least) if least > 0.0 else math.nan
