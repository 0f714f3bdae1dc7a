"""A second image (MR, CTA) of the same head, over the cuts of the first: blended, or as a checkerboard."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any, Final

import numpy as np

from ronnaplan.ct import CTVolume
from ronnaplan.errors import UsageError
from ronnaplan.geometry import FloatArray
from ronnaplan.planner.aligning import Alignment, align
from ronnaplan.planner.cuts import Shades, shaded
from ronnaplan.planner.worker import Job, Start
from ronnaplan.planning.sampling import AIR_HU, SliceSampler
from ronnaplan.pose import transform_points
from ronnaplan.scene.cut import Cut
from ronnaplan.scene.field import Field
from ronnaplan.scene.sampled import values_hu

MODES: Final = ("blend", "checkerboard")

CELL_MM = 2.0
"""Both images are registered on cells of this size."""

DOUBTFUL_MM = 2.0
"""Two starts that end further apart than this did not find one answer."""

SQUARES = 8
"""Along the shorter side of a view."""

WINDOW_SHARES = (1.0, 99.5)
"""The second image is black below one and white above the other percentile of its values."""

SCALE = 1000.0
"""The range between these percentiles, for the registration: images other than CT have no scale of their own."""


class Second:
    """The second image, where it lies in the first, and how it is shown; not at all until it is registered."""

    def __init__(self, first: CTVolume, image: CTVolume, name: str, start: Start) -> None:
        """Take an image as registered where its frame of reference is that of the ``first``."""
        self.name, self.share, self.mode = name, 0.5, MODES[0]
        self._first, self._image, self._start = first, image, start
        self._scan = SliceSampler.of(image)
        low, high = np.percentile(image.voxels_hu[::2, ::4, ::4], WINDOW_SHARES)
        self._window = (float(low), float(max(high, low + 1.0)))
        uid = image.source.frame_of_reference_uid
        same = uid is not None and uid == first.source.frame_of_reference_uid
        self._pose: FloatArray | None = np.eye(4) if same else None
        self.quality = "placed by its own frame of reference, which is that of the scan" if same else ""

    @property
    def placed(self) -> bool:
        """Whether it is known where it lies."""
        return self._pose is not None

    def register(self) -> None:
        """Have it registered to the first image; how far two starts agree is told."""
        fields = Field.of(self._first, CELL_MM), Field.of(self._scaled(), CELL_MM)
        self._start(Job(f"registering {self.name} to the scan", partial(align, *fields), self._keep))

    def show(self, share: float, mode: str) -> None:
        """Show so much of it (0 to 1), blended or in every other square."""
        if mode not in MODES:
            raise UsageError(f"images are not shown as {mode}; they are as {', '.join(MODES)}")
        self.share, self.mode = share, mode

    @property
    def look(self) -> tuple[Any, ...]:
        """What its picture depends on, besides the cut."""
        return (self.share, self.mode, self.quality) if self.placed else ()

    def over(self, shades: Shades, cut: Cut) -> Shades:
        """Return the picture of a cut through the first image with this one over it."""
        if self._pose is None or (self.mode == MODES[0] and not self.share):
            return shades
        turned = self._pose[:3, :3]
        there = Cut(
            turned @ cut.right,
            turned @ cut.down,
            transform_points(self._pose, cut.center_mm[np.newaxis])[0],
            cut.field_mm,
        )
        mine = shaded(values_hu(self._scan, there, shades.shape, self._window[0]), self._window)
        if self.mode == MODES[0]:
            return np.rint(shades * (1.0 - self.share) + mine * self.share).astype(np.uint8)
        side = max(1, min(shades.shape) // SQUARES)
        rows, columns = (np.arange(count) // side for count in shades.shape)
        return np.where((rows[:, np.newaxis] + columns) % 2 == 0, mine, shades)

    @property
    def told(self) -> dict[str, Any]:
        """The image in the page's words."""
        return {
            "name": self.name,
            "placed": self.placed,
            "share": self.share,
            "mode": self.mode,
            "quality": self.quality or "of another frame of reference: register it to see it",
        }

    def _keep(self, found: Alignment) -> None:
        self._pose = found.moving_from_fixed
        doubt = "" if found.apart_mm <= DOUBTFUL_MM else "DOUBTFUL, look closely: "
        self.quality = (
            f"{doubt}registered by SimpleITK (mutual information); two starts end {found.apart_mm:.2f} mm apart "
            "within the head. To look at only: nothing is measured in it"
        )

    def _scaled(self) -> CTVolume:
        low, high = self._window
        values = (self._image.voxels_hu.astype(np.float32) - low) * (SCALE / (high - low)) + AIR_HU
        return replace(self._image, voxels_hu=values)
