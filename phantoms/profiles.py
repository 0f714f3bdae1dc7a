"""Slice sensitivity profiles: what a slice weighs along its normal."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy import special

from phantoms.errors import PhantomError
from phantoms.solids import FloatArray

Shape = Literal["box", "trapezoid", "triangle", "gaussian"]
PLATEAU = 0.4
"""Top of a trapezoid over its full width at half maximum."""
GAUSSIAN_REACH = 4.0
"""A Gaussian profile ends at this many standard deviations."""
SIGMA_PER_FWHM = 1 / np.sqrt(8 * np.log(2))


@dataclass(frozen=True)
class Profile:
    """A symmetric profile of unit area with a full width at half maximum of ``fwhm_mm``."""

    shape: Shape
    fwhm_mm: float

    def __post_init__(self) -> None:
        if not (np.isfinite(self.fwhm_mm) and self.fwhm_mm > 0):
            raise PhantomError(f"a slice profile is {self.fwhm_mm} mm wide; expected a positive width")

    @property
    def reach_mm(self) -> float:
        """Distance from the slice's middle beyond which nothing is seen."""
        factor = {"box": 0.5, "trapezoid": 1 - PLATEAU / 2, "triangle": 1.0}
        return self.fwhm_mm * float(factor.get(self.shape, GAUSSIAN_REACH * SIGMA_PER_FWHM))

    def cumulative(self, offset_mm: FloatArray) -> FloatArray:
        """Return the area of the profile below each offset from the slice's middle."""
        x = np.clip(np.asarray(offset_mm, dtype=np.float64) / self.fwhm_mm, -2.0, 2.0)
        if self.shape == "gaussian":
            edge = special.ndtr(GAUSSIAN_REACH)
            area = special.ndtr(np.clip(x / SIGMA_PER_FWHM, -GAUSSIAN_REACH, GAUSSIAN_REACH))
            return np.asarray((area - (1 - edge)) / (2 * edge - 1), dtype=np.float64)
        top = {"box": 1.0, "trapezoid": PLATEAU}.get(self.shape, 0.0)
        # Each flank is a ramp centered on half the FWHM: the profile is a box smoothed by a box of 1 - top.
        ramp = 1 - top
        return _ramp_area(x + 0.5, ramp) - _ramp_area(x - 0.5, ramp)


def _ramp_area(x: FloatArray, width: float) -> FloatArray:
    """Return the integral of a step from 0 to 1 that rises linearly over ``width`` about zero."""
    if width == 0:
        return np.maximum(x, 0.0)
    inside = np.clip(x + width / 2, 0.0, width)
    rest: FloatArray = inside**2 / (2 * width) + np.maximum(x - width / 2, 0.0)
    return rest
