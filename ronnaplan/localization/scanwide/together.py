"""What a scan's markers say together of each one's error: how outlines are bent, panels lag and sizes scatter."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ronnaplan.geometry import FloatArray, robust_spread
from ronnaplan.localization.build import SIZE_TOLERANCE_MM, is_off_size
from ronnaplan.localization.examine import LEAST_TOGETHER, Examined, distinct, same_places
from ronnaplan.localization.fit.parameters import BLUR, EDGE, WIDTH, W, edge_variance_mm2
from ronnaplan.localization.judge.motion import Movement
from ronnaplan.localization.judge.uncertainty import ASIDE, MOST_ASIDE, WEIGHTS, by_panel, lag_mm, lagging_mm2
from ronnaplan.localization.scanner.beat import DISPLACED_SHARE
from ronnaplan.localization.scanner.scan import Scan
from ronnaplan.localization.scanner.summed import slope_beside_per_mm
from ronnaplan.localization.scanwide.usual import usual_misfit

LOWEST_CUTOFF_PER_MM = 0.6
"""No kernel passes nothing above so low a frequency: the softest of scanners end at 0.7 / mm. What is wrapped around
balls, fainter than they are, makes two steps of their edges, which together pass nothing at 0.35 to 0.55 / mm."""

SCATTERED_MM, SCATTERED_MM2, RAGGED = 0.03, 0.025, 0.02
"""Bare balls of one stated size do not exceed all of these in any scan: a standard deviation of their diameters, a
robust one of the variance of their edges' blur, and the usual misfit. Balls made to a tolerance and balls under film
differ in size (by 0.1 mm) but not in blur (0.01 mm^2); kernels that are far from the model's are fitted now one way,
now the other (0.04 mm^2), but closely (0.01). What lies on them in lumps does all (0.04 to 0.2 mm and mm^2, 0.03)."""

MEDIAN_SHARE = 0.69
"""Median of a mean square of few normal values, as a share of its expectation (of two: ln 2)."""

NEAR = 5
"""So many markers of a cone beam, those nearest in height, tell what is usual at their height."""

UNUSUAL = 3.0
"""A diameter is unlike the others' where it is off their median by so many of their own standard deviations, or larger
than the smallest third by so many standard errors: it is told about as well as a center along one axis."""


def with_doubted_sizes(markers: Sequence[Examined], others: Sequence[Examined]) -> list[Examined]:
    """Doubt clipped markers of a stated size where the scan's balls that show their size agree on another.

    ``others`` are no markers: balls of a size that is too far off are among them, turned down for nothing else.
    """
    turned_down = [one for one in others if one.failed == {"diameter"} and not one.is_clipped]
    at_none = ~same_places(turned_down, markers).any(axis=1)
    show_it = [one for one in markers if not one.is_clipped]
    show_it += distinct(turned_down[n] for n in np.flatnonzero(at_none))
    excess_mm = {one.stated_mm: _agreed_mm(one.stated_mm, show_it) for one in markers if one.is_clipped}
    return [_of_size(one, excess_mm[one.stated_mm]) if one.is_clipped else one for one in markers]


def _agreed_mm(stated_mm: float, balls: Sequence[Examined]) -> float:
    """By how much all balls that were looked for as of ``stated_mm`` are off it; 0 where few tell, or they differ."""
    excesses_mm = np.array([one.excess_mm for one in balls if one.stated_mm == stated_mm])
    if not len(excesses_mm) or not all(map(is_off_size, excesses_mm)):
        return 0.0
    usual_mm = float(np.median(excesses_mm))
    agreeing = np.count_nonzero(np.abs(excesses_mm - usual_mm) < SIZE_TOLERANCE_MM)
    return usual_mm if agreeing >= max(LEAST_TOGETHER, len(excesses_mm) / 2.0) else 0.0


def _of_size(one: Examined, excess_mm: float) -> Examined:
    """Return a marker whose size others tell, with what that may do to its center, as if it told it itself."""
    covariance_mm2 = one.covariance_mm2 + excess_mm**2 * one.by_excess
    return replace(one, excess_mm=excess_mm, covariance_mm2=covariance_mm2)


def with_usual_errors(scan: Scan, markers: Sequence[Examined]) -> list[Examined]:
    """Let each marker's covariance count what is usual in the scan, and doubt all where something lies on all."""
    markers = _computed(scan, _summed(scan, _uneven(_wrapped(markers))))
    movements = [one.movement for one in markers if one.movement is not None]
    grid = scan.volume.grid
    heights_mm = np.array([one.center_mm @ grid.normal for one in markers]) if grid.is_in_cubes else None
    usual_mm2, axes = usual_odd_mm2(movements, heights_mm), scan.axes
    if usual_mm2 is None:
        return markers
    panel = float(np.median([by_panel(one.parameters) for one in markers]))
    counted = []
    beyond_mm2 = (MOST_ASIDE / ASIDE * _beyond_usual_mm(markers)) ** 2
    for one, moved, usual, beyond in zip(markers, movements, usual_mm2, beyond_mm2, strict=True):
        # Slices that are thin beside the blur tell little of their profile's shape: a panel's may be taken for a box.
        more_mm2 = lagging_mm2(max(panel - by_panel(one.parameters), 0.0), lag_mm(grid), axes)
        covariance_mm2 = with_usual(one.covariance_mm2 + more_mm2, moved, usual, axes) + beyond * one.by_excess
        counted.append(replace(one, covariance_mm2=covariance_mm2))
    return counted


def _summed(scan: Scan, markers: Sequence[Examined]) -> list[Examined]:
    """State what is left of what summing rays before the logarithm may do."""
    along_mm2 = np.outer(scan.axes[W], scan.axes[W])
    stated = []
    for one in markers:
        slope_per_mm = slope_beside_per_mm(scan.volume, one.center_mm, one.diameter_mm / 2.0)
        error_mm = scan.summed.error_mm(float(one.parameters[WIDTH]), slope_per_mm)
        stated.append(replace(one, covariance_mm2=one.covariance_mm2 + error_mm**2 * along_mm2))
    return stated


def _computed(scan: Scan, markers: Sequence[Examined]) -> list[Examined]:
    """State what slices do that were computed from others at another distance, or that repeat others."""
    error_mm2 = scan.unplaced_mm2
    if scan.is_computed:
        error_mm2 = error_mm2 + (DISPLACED_SHARE * scan.gap_mm) ** 2 * np.outer(scan.axes[W], scan.axes[W])
    if not error_mm2.any():
        return list(markers)
    return [replace(one, covariance_mm2=one.covariance_mm2 + error_mm2) for one in markers]


def _wrapped(markers: Sequence[Examined]) -> list[Examined]:
    """Doubt all markers of a scan whose usual edge is no kernel's."""
    cutoffs_per_mm = [cutoff_per_mm(float(one.parameters[BLUR]), float(one.parameters[EDGE])) for one in markers]
    is_no_kernel = bool(markers) and float(np.median(cutoffs_per_mm)) < LOWEST_CUTOFF_PER_MM
    return [replace(one, is_covered=one.is_covered or is_no_kernel) for one in markers]


def _uneven(markers: Sequence[Examined]) -> list[Examined]:
    """Doubt all markers of one stated size that differ in size and in blur and are no close spheres: they are covered.

    By how much that moves a center is not told by the marker's own diameter then, but by how far theirs scatter.
    """
    doubted = list(markers)
    for stated_mm in {one.stated_mm for one in markers}:
        places = [n for n, one in enumerate(markers) if one.stated_mm == stated_mm and not one.is_clipped]
        if len(places) < LEAST_TOGETHER:
            continue
        scatter_mm = float(np.std([markers[n].excess_mm for n in places]))
        scatter_mm2 = robust_spread(np.array([edge_variance_mm2(markers[n].parameters) for n in places]))
        ragged = usual_misfit([markers[n] for n in places])
        if scatter_mm <= SCATTERED_MM or scatter_mm2 <= SCATTERED_MM2 or ragged <= RAGGED:
            continue
        for n in places:
            covariance_mm2 = markers[n].covariance_mm2 + scatter_mm**2 * markers[n].by_excess
            doubted[n] = replace(markers[n], is_covered=True, covariance_mm2=covariance_mm2)
    return doubted


def cutoff_per_mm(blur_mm: float, edge: float) -> float:
    """Return the frequency at which a kernel's transfer function, 1 + edge (2 pi f blur)^2 of a Gaussian's, is zero.

    Infinite where it never is. A kernel that falls more steeply than a Gaussian is fitted as well with an ``edge``
    below zero as with one above, so that the edge alone says nothing.
    """
    return 1.0 / (2.0 * math.pi * blur_mm * math.sqrt(-edge)) if edge < 0.0 else math.inf


def _beyond_usual_mm(markers: Sequence[Examined]) -> FloatArray:
    """By how much each marker's diameter (M,) is off what those of its stated one have in common."""
    beyond_mm = np.zeros(len(markers))
    stated_mm = np.array([math.nan if one.is_clipped else one.stated_mm for one in markers])
    excesses_mm = np.array([one.excess_mm for one in markers])
    errors_mm = np.sqrt([np.trace(one.covariance_mm2) / 3.0 for one in markers])
    for diameter in set(stated_mm[np.isfinite(stated_mm)]):
        alike = stated_mm == diameter
        beyond_mm[alike] = beyond_usual_mm(excesses_mm[alike], errors_mm[alike])
    return beyond_mm


def usual_odd_mm2(movements: Sequence[Movement], heights_mm: FloatArray | None = None) -> FloatArray | None:
    """What is usual in a scan of `Movement.odd_mm2`, (M, 3); None where there are fewer than `LEAST_TOGETHER` markers.

    Cone beams bend what stands higher or lower more: where ``heights_mm`` (M,) are given and those nearest show more,
    that is usual there.
    """
    if len(movements) < LEAST_TOGETHER:
        return None
    odd_mm2 = np.array([moved.odd_mm2 for moved in movements])
    usual_mm2 = np.tile(np.median(odd_mm2, axis=0) / MEDIAN_SHARE, (len(movements), 1))
    if heights_mm is None:
        return usual_mm2
    nearest = np.argsort(np.abs(heights_mm[:, np.newaxis] - heights_mm), axis=1)[:, :NEAR]
    most_mm2: FloatArray = np.maximum(usual_mm2, odd_mm2[nearest].mean(axis=1))
    return most_mm2


def with_usual(covariance_mm2: FloatArray, moved: Movement, usual_mm2: FloatArray, axes: FloatArray) -> FloatArray:
    """Return the covariance (3, 3) with the mean of its own odd bending and the usual (3,) in place of its own.

    Two to four amplitudes a marker tell little alone. ``axes`` (3, 3) are u, v, w in LPS.
    """
    change = WEIGHTS["odd"] * (usual_mm2 - moved.odd_mm2) / 2.0
    pooled: FloatArray = covariance_mm2 + axes.T @ np.diag(change) @ axes
    return pooled


def beyond_usual_mm(excesses_mm: FloatArray, errors_mm: FloatArray) -> FloatArray:
    """By how much each diameter (M,) is off what the scan's markers have in common; 0 where that is no more than usual.

    A scanner's kernel makes all of them alike, to a few micrometres in thin slices, so this tells a film that is too
    thin to make a marker's diameter another than the stated one. What does make it so, is counted already. Films only
    add: what is larger than the smallest third by more than ``errors_mm`` (M,) tell, the errors of the centers along
    one axis, is not bare, however many there are of it. Where most are off the stated diameter, the others are not
    believed either.
    """
    plain = np.abs(excesses_mm) <= SIZE_TOLERANCE_MM
    if len(plain) >= LEAST_TOGETHER and 2 * np.count_nonzero(plain) <= len(plain):
        return np.where(plain, excesses_mm, 0.0)
    if np.count_nonzero(plain) < LEAST_TOGETHER:
        return np.zeros(len(plain))
    apart_mm = np.where(plain, excesses_mm - np.median(excesses_mm[plain]), 0.0)
    usual_mm = UNUSUAL * robust_spread(apart_mm[plain])
    apart_mm[np.abs(apart_mm) <= min(usual_mm, SIZE_TOLERANCE_MM)] = 0.0
    bare = max((int(plain.sum()) - 1) // 3, 1)  # not the very smallest, which noise may have made so
    larger_mm = np.where(plain, excesses_mm - np.sort(excesses_mm[plain])[bare], 0.0)
    larger_mm[larger_mm <= UNUSUAL * np.median(errors_mm[plain])] = 0.0
    return np.where(apart_mm == 0.0, larger_mm, apart_mm)
