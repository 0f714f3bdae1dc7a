"""Reconstruction kernels, from very soft to edge-enhancing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from phantoms.errors import PhantomError
from phantoms.solids import FloatArray


@dataclass(frozen=True)
class Kernel:
    """A reconstruction kernel: ramp times ``(1 + boost (f/c)^2) exp(-(f/c)^power)``, f and c in cycles per mm."""

    cutoff_per_mm: float
    power: float
    boost: float = 0.0

    def response(self, frequency_per_mm: FloatArray) -> FloatArray:
        """Return the kernel's modulation, one at frequency zero, so that mass is kept."""
        x = frequency_per_mm / self.cutoff_per_mm
        modulation: FloatArray = (1 + self.boost * x**2) * np.exp(-(x**self.power))
        return modulation


KERNELS = {
    "very soft": Kernel(0.24, 2.0),
    "soft": Kernel(0.36, 2.0),
    "smooth": Kernel(0.43, 2.0),
    "standard": Kernel(0.50, 2.2),
    "detail": Kernel(0.60, 2.6, boost=0.3),
    "bone": Kernel(0.80, 4.0, boost=0.6),
    "plain": Kernel(0.90, 8.0),
    "edge": Kernel(0.50, 2.0, boost=3.0),
    "strong edge": Kernel(0.55, 2.0, boost=6.0),
}
"""The named kernels; those with a boost overshoot at edges."""


def kernel(name: str) -> Kernel:
    """Return the kernel called ``name``; raises `PhantomError` with the known names."""
    if name not in KERNELS:
        raise PhantomError(f"unknown kernel {name!r}; expected one of {', '.join(KERNELS)}")
    return KERNELS[name]
