"""Positions of slices that a program wrote with one or two decimals, and pixel spacings with three.

Slices every 0.625 mm then seem 0.6 and 0.7 mm apart, and a ball in them is displaced by up to 30 micrometres.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from ronnaplan.ct import tags
from ronnaplan.ct.slices import SliceImage
from ronnaplan.ct.values import number_or_none, values
from ronnaplan.geometry import FloatArray

ROUNDED_TO_MM: Final = (0.1, 0.01)
"""What positions are rounded to, along each of the patient's axes by itself."""

HOW_NEAR: Final = 0.55
"""Rounding displaces a slice by half a step at most, and by a tenth of that more where it was rounded before."""

LEAST_STEPS: Final = 2.4
"""Gaps of more steps, and another one that a missing slice leaves, are never the rounding of one even line."""

LEAST_SLICES: Final = 20
"""Fewer slices may lie so near to an even line by chance, and tell it less well."""

WRITTEN_MM: Final = 1e-4
"""What is a whole number of steps is one to this, and numbers that are not rounded lie on the line to this."""

CUT_TO: Final = 3
"""Decimals of pixel spacings that are told for too few; with less, cone beams have spacings that are chosen so."""

LEAST_CUT: Final = 5e-4
"""Digits that were left out are told from this share of the spacing on: 0.05 mm in 100."""


def evened(origins_mm: FloatArray) -> FloatArray | None:
    """Return where slices lie (K, 3) that are evenly spaced but for the rounding of ``origins_mm``, else None.

    The line is that from which the farthest of the written numbers is nearest: each must be near enough to be its
    rounding, so that what is uneven by more than the rounding stays as it is written.
    """
    if len(origins_mm) < LEAST_SLICES:
        return None
    steps_mm = np.array([_rounded_to_mm(along) for along in origins_mm.T])
    if not steps_mm.any():
        return None
    even_mm = np.column_stack([_even_line(along) for along in origins_mm.T])
    gaps_mm = np.abs(even_mm[1] - even_mm[0])
    is_told = gaps_mm.max() >= LEAST_STEPS * steps_mm[gaps_mm.argmax()]
    is_near = (np.abs(origins_mm - even_mm) <= HOW_NEAR * steps_mm + WRITTEN_MM).all()
    return even_mm if is_told and is_near else None


def _rounded_to_mm(along_mm: FloatArray) -> float:
    """Return the coarsest step of which all coordinates (K,) are multiples, 0 where there is none, or they are one."""
    for step_mm in ROUNDED_TO_MM if np.ptp(along_mm) > 0.0 else ():
        if np.abs(along_mm - step_mm * np.round(along_mm / step_mm)).max() < WRITTEN_MM:
            return step_mm
    return 0.0


def _even_line(along_mm: FloatArray) -> FloatArray:
    """Return the evenly spaced numbers (K,) of which the one that is farthest from its own of (K,) is nearest."""
    from scipy.optimize import linprog

    middle_mm, one = along_mm.mean(), np.ones(len(along_mm))
    number = np.arange(len(along_mm)) - (len(along_mm) - 1) / 2.0
    above = np.column_stack([number, one, -one])  # of a gap, a shift and the farthest distance
    below = np.column_stack([-number, -one, -one])
    off_mm = along_mm - middle_mm
    found = linprog(
        (0.0, 0.0, 1.0),
        np.concatenate([above, below]),
        np.concatenate([off_mm, -off_mm]),
        bounds=((None, None), (None, None), (0.0, None)),
    )
    gap_mm, shift_mm, _ = np.asarray(found.x)
    even_mm: FloatArray = middle_mm + gap_mm * number + shift_mm
    return even_mm


def is_spacing_cut(image: SliceImage) -> bool:
    """Whether rounding, or leaving digits out, made the pixel spacing of what the diameter of reconstruction tells.

    Scanners' square images are as wide as that; others, cropped say, differ from it by more than digits.
    """
    elements, pixels = image.instance.elements, image.pixels
    written = set(values(elements, tags.PIXEL_SPACING))
    diameter_mm = number_or_none(elements, tags.RECONSTRUCTION_DIAMETER)
    if diameter_mm is None or len(written) != 1 or pixels.rows != pixels.columns:
        return False
    decimals = written.pop().partition(".")[2].rstrip("0")
    step_mm, (spacing_mm, _) = 10.0**-CUT_TO, image.spacing_mm
    lost_mm = diameter_mm / pixels.columns - spacing_mm
    is_digits = -0.5 * step_mm <= lost_mm < step_mm
    return len(decimals) == CUT_TO and is_digits and abs(lost_mm) > LEAST_CUT * spacing_mm
