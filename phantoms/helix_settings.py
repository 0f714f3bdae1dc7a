"""How a helical scanner is set: its detector, its table and its focal spot."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from phantoms.machine import Machine
from phantoms.solids import FloatArray

Method = Literal["180LI", "360LI", "WFBP"]
"""Linear interpolation between rays of half a turn or of whole turns; weighted filtered back-projection."""


@dataclass(frozen=True)
class HelixSettings(Machine):
    """Lengths of the detector are those at the axis of rotation: it is thought there, flat, and scaled down."""

    rows: int = 32
    row_mm: float = 0.6
    pitch: float = 0.8
    """Feed of a turn over the height of all rows."""
    method: Method = "WFBP"
    views: int = 960
    """Readings a turn."""
    bin_mm: float = 0.6
    source_mm: float = 570.0
    """Distance from the focal spot to the axis, and from there to the detector."""
    detector_mm: float = 470.0
    spot_mm: tuple[float, float] = (0.7, 0.8)
    """Focal spot across and along the axis."""
    flying_spot: bool = False
    """Whether the focal spot jumps between two places from reading to reading, which halves the sampling distance."""
    quarter_offset: bool = True
    """Whether the detector is shifted by a quarter element, so that opposite rays interleave."""
    bow_tie: bool = True
    """Whether a filter evens out what arrives behind a head."""
    start_deg: float = 0.0
    """Where the tube is when it passes the origin."""

    def __post_init__(self) -> None:
        super().__post_init__()
        highest = 2.0 if self.rows <= 4 else 1.5
        self._check(
            ("number of rows", self.rows, 2 <= self.rows <= 128, "2 to 128"),
            ("row height in mm", self.row_mm, 0.1 <= self.row_mm <= 10, "0.1 to 10"),
            ("pitch", self.pitch, 0.1 <= self.pitch <= highest, f"0.1 to {highest:g}"),
            (
                "number of views a turn",
                self.views,
                self.views >= 32 and self.views % 4 == 0,
                "32 or more, by fours",
            ),
            ("detector element in mm", self.bin_mm, 0.05 <= self.bin_mm <= 5, "0.05 to 5"),
        )

    @property
    def feed_mm(self) -> float:
        """How far the table moves in a turn."""
        return self.pitch * self.rows * self.row_mm

    def times(self, heights_mm: FloatArray) -> FloatArray:
        """Return when, in parts of the scan, the tube is at each place along the axis; it starts where it must."""
        low, high = self.scanned_mm
        return np.clip((heights_mm - low) / max(high - low, 1e-9), 0.0, 1.0)
