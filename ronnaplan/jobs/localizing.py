"""A scan's markers, found as a rule says."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ronnaplan.jobs.rules import ScanRule
from ronnaplan.portable import give_back_code

if TYPE_CHECKING:
    from ronnaplan.ct import CTVolume
    from ronnaplan.localization import Fiducials, Template

WARMING_BALL_MM = 11.5
"""Diameter of the ball that is found before there is a scan."""


def find_markers(volume: CTVolume, rule: ScanRule, template: Template | None) -> tuple[Fiducials, tuple[str, ...]]:
    """Find the markers of ``rule``, whose ``template`` was read, whatever their number; warn of other sizes of balls.

    Raises `RonnaplanError` where the scan allows no answer.
    """
    from ronnaplan.localization import Build, localize
    from ronnaplan.localization.size import common_sizes, told_of_others

    marker = Build.parse(rule.marker)
    if rule.diameters:
        return localize(volume, diameter_mm=rule.diameters, template=template, marker=marker), ()
    sizes = common_sizes(volume, rule.expected, marker)
    found = localize(volume, diameter_mm=sizes[0].diameter_mm, template=template, marker=marker)
    return found, told_of_others(sizes, rule.expected)


def warm_up() -> tuple[CTVolume, Fiducials]:
    """Load what finding markers needs, and the compiled code, before there is a scan.

    Returns a scan of one ball in air, and the marker that was found in it. Numba's compiler, which loads what it
    compiled before, would hold 80 MB meanwhile, of which little is needed again: each step's are given back.
    """
    import numpy as np

    from ronnaplan.ct import CTVolume, SeriesSource
    from ronnaplan.ct.grid import SliceGrid
    from ronnaplan.localization import localize
    from ronnaplan.localization.scanner.measured import measured

    places = np.arange(24.0)
    i, j, k = np.meshgrid(places, places, places, indexing="ij")
    beyond_mm = np.sqrt((i - 12) ** 2 + (j - 12) ** 2 + (k - 12) ** 2) - WARMING_BALL_MM / 2
    noise_hu = np.random.default_rng(0).normal(0.0, 5.0, beyond_mm.shape)
    ball = (-1000.0 + 1100.0 / (1.0 + np.exp(4.0 * beyond_mm)) + noise_hu).astype(np.int16)
    origins = np.stack([np.zeros(24), np.zeros(24), places], axis=1)
    grid = SliceGrid(origins, np.array([0.0, 1.0, 0.0]), np.array([1.0, 0.0, 0.0]))
    volume = CTVolume(ball, grid, SeriesSource())
    give_back_code()  # of the compiler, what the system's linker touched
    measured(volume)  # loads a first kernel
    give_back_code()  # and what set the compiler up
    found = localize(volume, diameter_mm=WARMING_BALL_MM)
    give_back_code()
    return volume, found
