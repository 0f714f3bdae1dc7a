"""What a scan's markers say together: misfit, slice profile, bending and size that are usual in it.

What all of them show is the scanner's and says nothing against one of them; what one alone shows is its own.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ronnaplan.geometry import FloatArray
from ronnaplan.localization.build import Build
from ronnaplan.localization.examine import Examined, Scan, examine_place
from ronnaplan.localization.motion import LEAST_TOGETHER
from ronnaplan.localization.parameters import EDGE, WIDTH
from ronnaplan.localization.uncertainty import beyond_usual_mm, usual_odd_mm2, with_usual

ALIKE_MM = 0.75
ALIKE_SHARE = 0.6
"""Markers of one scan show the same slice profile, to within this or this share of its width."""

SOFTEST_EDGE = -0.3
"""The least edge enhancement of any kernel: below it the transfer function falls through zero where it still passes a
fifth, exp(1 / (2 edge)). What is wrapped around balls, fainter than they are, makes two steps of their edges: -0.4."""

OF_THE_SURFACE = {"coverage", "roundness"}
"""Tests that streaks of metal and of few views spoil in a whole scan, as in cone beams of a short turn."""


def usual_misfit(examined: Sequence[Examined]) -> float:
    """Return the misfit (share of the contrast) that a scan's markers have; 0 where too few tell."""
    misfits = [one.misfit for one in examined if one.is_marker]
    return float(np.median(misfits)) if len(misfits) >= LEAST_TOGETHER else 0.0


def by_the_usual(scan: Scan, examined: Sequence[Examined], build: Build, usual: float) -> list[Examined]:
    """Judge what was turned down for its surface alone once more, now that the scan's ``usual`` misfit is known."""
    return [
        examine_place(scan, one.candidate_mm, one.stated_mm, build, usual)
        if usual > 0 and one.failures and {name for name, _ in one.failures} <= OF_THE_SURFACE
        else one
        for one in examined
    ]


def alike(accepted: Sequence[Examined]) -> list[Examined]:
    """Turn down what one scanner cannot have shown: a profile that is not that of the scan's other markers.

    One alone may be anything; of two nobody knows which is right.
    """
    if len(accepted) < LEAST_TOGETHER:
        return list(accepted)
    nominal = np.array([one.thickness_mm for one in accepted])  # not everywhere the same where gaps stand for it
    widths = np.array([one.parameters[WIDTH] for one in accepted])
    usual = nominal + np.median(widths - nominal)
    off = np.abs(widths - usual) > np.maximum(ALIKE_MM, ALIKE_SHARE * usual)
    return [
        replace(
            one,
            failures=(("alike", f"its ends are blurred over {width:.1f} mm, the others' over {others:.1f} mm"),),
        )
        if is_off
        else one
        for one, width, others, is_off in zip(accepted, widths, usual, off, strict=True)
    ]


def together(scan: Scan, markers: Sequence[Examined]) -> list[Examined]:
    """Let each marker's covariance count what is usual in the scan, and doubt all where something lies on all."""
    markers = _wrapped(markers)
    movements = [one.movement for one in markers if one.movement is not None]
    usual_mm2, axes = usual_odd_mm2(movements), scan.volume.grid.axes
    if usual_mm2 is None:
        return markers
    return [
        replace(
            one, covariance_mm2=with_usual(one.covariance_mm2, moved, usual_mm2, axes) + beyond**2 * one.by_excess
        )
        for one, moved, beyond in zip(markers, movements, _beyond_usual_mm(markers), strict=True)
    ]


def _wrapped(markers: Sequence[Examined]) -> list[Examined]:
    """Doubt all markers of a scan whose usual edge is no kernel's."""
    is_no_kernel = bool(markers) and float(np.median([one.parameters[EDGE] for one in markers])) < SOFTEST_EDGE
    return [replace(one, is_covered=one.is_covered or is_no_kernel) for one in markers]


def _beyond_usual_mm(markers: Sequence[Examined]) -> FloatArray:
    """By how much each marker's diameter (M,) is off what those of its stated one have in common."""
    beyond_mm = np.zeros(len(markers))
    stated_mm = np.array([math.nan if one.is_clipped else one.stated_mm for one in markers])
    excesses_mm = np.array([one.excess_mm for one in markers])
    for diameter in set(stated_mm[np.isfinite(stated_mm)]):
        alike = stated_mm == diameter
        beyond_mm[alike] = beyond_usual_mm(excesses_mm[alike])
    return beyond_mm
