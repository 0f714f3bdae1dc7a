"""Along which direction do the slices blur? Oblique reformats keep the profile of slices that lay otherwise.

A workstation that computes slices in a new direction from thick ones leaves every ball blurred along the old slices'
normal, by their profile, and by the kernel across it. No header says where that was. But a blur that has other axes
than the slices' is seen in each ball: to first order it adds the image's second derivatives (the equation of heat).
Where three balls and more agree, they are fitted anew with w along that direction: then the model is again the one of
the scan that was made.

Old slices blur all balls of a scan along one direction. A gantry that turns while it looks blurs each across the line
to its axis, which a sharp kernel shows in balls far from it; of many balls around a head some lie in the same direction
from the axis. So no direction is believed that half of the balls or more do not show. Balls that are all on one side of
the head show theirs alike, but it leads across the patient's axis, along which slices are measured.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence

import numpy as np

from ronnaplan.geometry import FloatArray
from ronnaplan.localization.build import Build
from ronnaplan.localization.examine import LEAST_TOGETHER, Examined, distinct, examine_places
from ronnaplan.localization.fit.parameters import LEAST_SPREAD_MM2
from ronnaplan.localization.scanner.scan import Scan, Slant
from ronnaplan.localization.scanwide.usual import OF_THE_PROFILE

AGREE_DEG = 20.0
"""Directions within so many degrees are the same: single balls tell theirs to a few, to 13 beside something else."""

LEAST_SLANT_MM2 = 0.03
"""With less of a covariance between the slices' axes, a blur's own are not looked for: it moves no center."""

LONGER = 1.8
"""Thick slices blur by this many times the variance across them, or more (2.4 to 7 in reformats of 2 and 3 mm). What a
focal spot or a metal's streaks do beside the kernel is less (1.0 to 1.4)."""

BETTER = 0.9
"""Along their own profile balls misfit by no more than this share of what they did (half of it, most)."""

EXCUSED = OF_THE_PROFILE | {"free"}
"""What may be wrong with balls that tell the direction: how much skin touches one says nothing of its slices, and lies
beyond the limit by noise."""

RESIZED_SHARE, RESIZED_MM = 0.02, 0.03
"""Balls keep their size to this share of it and this: an egg that lies aslant, which looks like a ball in a profile as
long as it is longer, seems larger by 2.6 to 5 %."""

UPRIGHT = 0.5
"""Slices that were measured lie across the patient's axis to 60 degrees (the cosine). A turning gantry blurs at right
angles to its own axis, which leads off the patient's by 30 degrees at most."""

MAX_TURNS = 3
"""So often the direction is told anew."""


def along_the_blur(scan: Scan, examined: Sequence[Examined], build: Build) -> Scan:
    """Return the scan with w along its blur, if the balls among what was ``examined`` fit better so; else as it is."""

    def refit(slant: Slant, balls: Sequence[Examined]) -> list[Examined]:
        turned = Scan(scan.volume, slant, whole=scan)
        return examine_places(turned, [(one.center_mm, one.stated_mm) for one in balls], build)

    slant = slant_seen(scan.axes, examined, refit)
    return scan if slant is None else Scan(scan.volume, slant, whole=scan)


def slant_seen(
    axes: FloatArray, examined: Sequence[Examined], refit: Callable[[Slant, Sequence[Examined]], list[Examined]]
) -> Slant | None:
    """Return the slant of a scan whose slices have the ``axes`` (3, 3) in LPS; None where its balls show none.

    It is told again by balls that are ``refit`` along it, for the first order is not exact, and believed only where
    these misfit less.
    """
    seen = _with_blur(examined)
    before = balls = agreeing(seen)
    if not _are_most(balls, seen):
        return None
    found, w = None, axes[2]
    for _ in range(MAX_TURNS):
        slant = slant_of(balls, w)
        if slant is None:
            break
        found, w = slant, slant.axis
        balls = agreeing(_with_blur(refit(slant, balls)))
    if found is None or abs(float(found.axis[2])) < UPRIGHT:
        return None
    return found if _is_better(balls, before) else None


def agreeing(balls: Sequence[Examined]) -> list[Examined]:
    """Return the largest set of ``balls``, whose blurs are known, that are blurred most in one direction."""
    if not balls:
        return []
    directions = np.array([longest_axis(one.blur_mm2) for one in balls])
    agree = np.abs(directions @ directions.T) > np.cos(np.radians(AGREE_DEG))
    return [one for one, is_so in zip(balls, agree[int(np.argmax(agree.sum(axis=1)))], strict=True) if is_so]


def slant_of(balls: Sequence[Examined], w: FloatArray) -> Slant | None:
    """Return what the usual blur of ``balls`` says of their slices.

    None where these are fewer than three, or where it is alike across ``w`` (3,), with which they were fitted, or not
    clearly longest in one direction.
    """
    if len(balls) < LEAST_TOGETHER:
        return None
    blur_mm2 = np.median([one.blur_mm2 for one in balls], axis=0)
    along_mm2 = float(w @ blur_mm2 @ w)
    across_mm2 = (float(np.trace(blur_mm2)) - along_mm2) / 2.0
    upright_mm2 = across_mm2 * np.eye(3) + (along_mm2 - across_mm2) * np.outer(w, w)
    if float(np.linalg.norm(blur_mm2 - upright_mm2)) <= LEAST_SLANT_MM2:
        return None
    variances_mm2, axes = np.linalg.eigh(blur_mm2)
    if variances_mm2[2] < LONGER * variances_mm2[1]:
        return None
    axis = axes[:, 2]
    width_mm = math.sqrt(12.0 * max(float(variances_mm2[2]) - LEAST_SPREAD_MM2, 0.0))
    return Slant(np.asarray(axis * np.copysign(1.0, axis @ w)), width_mm)


def longest_axis(blur_mm2: FloatArray) -> FloatArray:
    """Return the axis (3,) along which a blur (3, 3) is widest: where slices are thick, that is along their profile."""
    axis: FloatArray = np.linalg.eigh(blur_mm2)[1][:, -1]
    return axis


def _with_blur(examined: Iterable[Examined]) -> list[Examined]:
    """One candidate a place, of those whose blur is known."""
    return distinct(one for one in examined if np.isfinite(one.blur_mm2).all())


def _are_most(balls: Sequence[Examined], seen: Sequence[Examined]) -> bool:
    """Whether ``balls``, which are among what is ``seen``, are more than the others of the stated size."""
    return len(balls) > sum(map(_is_as_stated, seen)) - sum(map(_is_as_stated, balls))


def _is_as_stated(one: Examined) -> bool:
    """Whether this is a ball of the stated size, but for what the profile of other slices may make of it."""
    return one.failed <= EXCUSED and abs(one.excess_mm) <= RESIZED_SHARE * one.stated_mm + RESIZED_MM


def _is_better(balls: Sequence[Examined], before: Sequence[Examined]) -> bool:
    """Whether more balls of the stated size are seen than ``before``, or as many that misfit less."""
    now, then = ([one.misfit for one in seen if _is_as_stated(one)] for seen in (balls, before))
    if len(now) < LEAST_TOGETHER or len(now) < len(then):
        return False
    return len(now) > len(then) or float(np.median(now)) <= BETTER * float(np.median(then))
