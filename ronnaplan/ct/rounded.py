"""Positions of slices that a program wrote with one or two decimals, and where the slices were.

Slices every 0.625 mm then seem 0.6 and 0.7 mm apart, and a ball in them is displaced by up to 30 micrometres.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from ronnaplan.geometry import FloatArray

ROUNDED_TO_MM: Final = (0.1, 0.01)
"""What positions are rounded to, along each of the patient's axes by itself."""

HOW_NEAR: Final = 0.75
"""Rounding displaces a slice by half a step at most; the even line itself is told to as much as half of that."""

LEAST_SLICES: Final = 20
"""Fewer slices may lie so near to an even line by chance, and tell it less well."""

WRITTEN_MM: Final = 1e-4
"""What is a whole number of steps is one to this, and numbers that are not rounded lie on the line to this."""


def evened(origins_mm: FloatArray) -> FloatArray | None:
    """Return where slices lie (K, 3) that are evenly spaced but for the rounding of ``origins_mm``, else None.

    The line is that of least squares, which each written number must be near enough to be its rounding.
    """
    count = len(origins_mm)
    if count < LEAST_SLICES:
        return None
    steps_mm = np.array([_rounded_to_mm(along) for along in origins_mm.T])
    number = np.arange(count) - (count - 1) / 2.0
    gap_mm = number @ origins_mm / (number @ number)
    even_mm: FloatArray = origins_mm.mean(axis=0) + number[:, np.newaxis] * gap_mm
    is_near = bool((np.abs(origins_mm - even_mm) <= HOW_NEAR * steps_mm + WRITTEN_MM).all())
    return even_mm if is_near else None


def _rounded_to_mm(along_mm: FloatArray) -> float:
    """Return the coarsest step of which all coordinates (K,) are multiples, 0 where there is none, or they are one."""
    for step_mm in ROUNDED_TO_MM if np.ptp(along_mm) > 0.0 else ():
        if np.abs(along_mm - step_mm * np.round(along_mm / step_mm)).max() < WRITTEN_MM:
            return step_mm
    return 0.0
