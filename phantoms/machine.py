"""What every scanner has in common: its settings, and how it is asked for images."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from phantoms.beam import check_kilovolts
from phantoms.errors import PhantomError
from phantoms.kernels import kernel
from phantoms.motion import STILL, Motion, Span
from phantoms.profiles import Profile
from phantoms.scene import Scene
from phantoms.solids import FloatArray, Vector
from phantoms.stack import SliceStack

Images = NDArray[np.floating[Any]]
"""Images (K, rows, columns) in HU, neither rounded nor clipped."""


@dataclass(frozen=True)
class Machine(ABC):
    """A scanner of any kind; where the slices lie is a `SliceStack`."""

    kernel: str = "standard"
    dose: float = 1.0
    """1 is a usual head scan, 7.5 HU in 1 mm standard slices of a 200 mm water disc; 0 leaves all noise out."""
    kilovolts: float = 120.0
    electronic_noise: float = 8.0
    """Standard deviation added to each reading, in quanta."""
    scatter: float = 0.0
    """Strength of scattered radiation; 0.02 is a usual clinical residue."""
    extended_scale: bool = False
    """Whether values above 3071 HU are kept."""

    motion: Motion = STILL
    """How the patient moves during the scan."""
    scanned_mm: tuple[float, float] = (0.0, 0.0)
    """From where to where along the slices' normal the scan goes; matters only when the patient moves."""

    def __post_init__(self) -> None:
        kernel(self.kernel)
        check_kilovolts(self.kilovolts)
        self._check(
            ("dose", self.dose, self.dose >= 0, "zero or more"),
            ("electronic noise", self.electronic_noise, self.electronic_noise >= 0, "zero or more"),
            ("scatter", self.scatter, 0 <= self.scatter < 1, "0 to 1"),
        )

    def _check(self, *checks: tuple[str, float, bool, str]) -> None:
        """Raise `PhantomError` for the first wrong setting of (name, value, whether it is good, what is expected)."""
        for name, value, good, expected in checks:
            if not good:
                raise PhantomError(f"the scanner's {name} is {value}; expected {expected}")

    @property
    def field_radius_mm(self) -> float:
        """Radius about the axis of rotation within which the images show anything."""
        return float("inf")

    def as_read(self, view: NDArray[np.floating[Any]], quanta: FloatArray | float, *seed: int) -> None:
        """Turn the part of ``quanta`` that arrives at each element into what is read of it, in place.

        The noise is normal, with the variance of counts and electronics; ``seed`` is the reading's own.
        """
        if not self.dose:
            return
        spread = np.sqrt(quanta * view + self.electronic_noise**2) / quanta
        view += spread * np.random.default_rng([*seed, 20260301]).standard_normal(view.shape, dtype=np.float32)
        # As on real scanners, readings are raised to the electronic noise, or their logarithms would run away.
        np.maximum(view, max(1.0, self.electronic_noise) / quanta, out=view, casting="same_kind")

    def aimed(self, stack: SliceStack) -> Self:
        """Return the scanner as it is set up for ``stack``."""
        places = stack.positions_mm
        return replace(self, scanned_mm=(float(places.min()), float(places.max())))

    def seen_during(self, place_mm: Vector, radius_mm: float, stack: SliceStack) -> Span:
        """Return from when to when, in parts of the scan, a ball in the scene is in the beam."""
        return 0.0, 1.0

    @abstractmethod
    def reconstruct(
        self, scene: Scene, stacks: Sequence[SliceStack], *, seed: int = 0, progress: bool = False
    ) -> list[Images]:
        """Return the images of each stack, all from one scan: what they share is measured once."""

    def profile(self, stack: SliceStack) -> Profile:
        """Return the sensitivity along the slices' normal, as physics makes it (not as the header says)."""
        return Profile("box", stack.thickness_mm)
