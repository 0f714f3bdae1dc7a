"""A scan as a browser's graphics card draws it whole: 8-bit values on even cells, and tables of colour and opacity."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ronnaplan.scene.field import Field
from ronnaplan.scene.things import rgb

LOW_HU, HIGH_HU = -1024.0, 2026.0
"""What is shown as 0 and as 255: about 12 HU a step."""

MOST_CELLS: Final = 256
"""Along a side: every browser with WebGL2 takes as many."""

BLOCK: Final = 8
"""Of so many cells along a side the greatest value is told, so that empty ones are skipped."""

Table = tuple[tuple[float, str, float], ...]


@dataclass(frozen=True)
class Preset:
    """Colour and opacity of a millimetre at some HU, linear between; ``surface`` is where a click lands."""

    points: Table
    surface: str


PRESETS: Final = {
    "bone": Preset(((180, "#b8865a", 0.0), (320, "#e3cba0", 0.35), (700, "#f6ecd6", 0.9)), "skull"),
    "soft tissue": Preset(((-560, "#d8a48a", 0.0), (-380, "#e0b89c", 0.9), (2000, "#f6ecd6", 1.0)), "skin"),
    "skin over bone": Preset(
        (
            *((-560, "#d8a48a", 0.0), (-400, "#f0cdb4", 0.06), (-150, "#f0cdb4", 0.008), (200, "#c98d63", 0.004)),
            *((350, "#e8d6b4", 0.3), (800, "#fbf4e2", 0.9)),
        ),
        "skull",
    ),
    "vessels and metal": Preset(
        (
            *((110, "#a33a2c", 0.0), (190, "#d0523c", 0.12), (320, "#e3cba0", 0.05), (1200, "#f6ecd6", 0.12)),
            (1900, "#ffe9a8", 0.95),
        ),
        "skull",
    ),
}
"""What a volume is drawn as."""


@dataclass(frozen=True, eq=False)
class Volume:
    """Values (nz, ny, nx) from 0 to 255 on cells of ``cell_mm``; ``low_mm`` (3,) is the corner of the first, LPS."""

    values: NDArray[np.uint8]
    low_mm: NDArray[np.float64]
    cell_mm: float

    @classmethod
    def of(cls, field: Field) -> Volume:
        """Take a field, coarser where it has too many cells."""
        step = -(-max(field.values.shape) // MOST_CELLS)
        values = field.values[::step, ::step, ::step]
        shades = np.clip((values - LOW_HU) * (255.0 / (HIGH_HU - LOW_HU)), 0.0, 255.0).astype(np.uint8)
        cell = step * field.cell_mm
        return cls(shades, field.origin_mm - cell / 2, cell)

    @property
    def greatest(self) -> NDArray[np.uint8]:
        """The greatest value in each block (k, j, i) of `BLOCK` cells a side and in the cells that touch it."""
        from scipy.ndimage import maximum_filter

        sides = [-(-count // BLOCK) for count in self.values.shape]
        padded = np.pad(
            maximum_filter(self.values, 3),
            [(0, BLOCK * n - count) for n, count in zip(sides, self.values.shape, strict=True)],
        )
        blocks = padded.reshape(sides[0], BLOCK, sides[1], BLOCK, sides[2], BLOCK)
        found: NDArray[np.uint8] = blocks.max(axis=(1, 3, 5))
        return found

    @property
    def packed(self) -> bytes:
        """What the page is sent: the values, then the greatest of each block, x first."""
        return self.values.tobytes() + self.greatest.tobytes()

    @property
    def shape(self) -> dict[str, Any]:
        """How the page has to read it, and where it lies."""
        cells = list(self.values.shape[::-1])
        return {
            "cells": cells,
            "blocks": [-(-count // BLOCK) for count in cells],
            "low": self.low_mm.tolist(),
            "size": [self.cell_mm * count for count in cells],
        }


def table(preset: Preset, strength: float) -> NDArray[np.uint8]:
    """Return colour and opacity a millimetre (256, 4) of each value; ``strength`` multiplies how dense all is."""
    levels = np.linspace(LOW_HU, HIGH_HU, 256)
    at = [hu for hu, _, _ in preset.points]
    colours = np.array([rgb(colour) for _, colour, _ in preset.points])
    opacity = np.interp(levels, at, [share for _, _, share in preset.points], left=0.0)
    denser = 1.0 - np.power(1.0 - np.minimum(opacity, 0.999), strength)
    parts = [np.interp(levels, at, colours[:, n]) for n in range(3)]
    found: NDArray[np.uint8] = np.rint(255 * np.stack([*parts, denser], axis=-1)).astype(np.uint8)
    return found
