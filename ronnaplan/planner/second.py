"""A second image (MR, CTA) of the same head, over the cuts of the first: blended, or as a checkerboard."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Final

import numpy as np

from ronnaplan.bounds import LOWEST_HU
from ronnaplan.ct import CTVolume
from ronnaplan.errors import UsageError
from ronnaplan.geometry import FloatArray
from ronnaplan.planner.aligning import Alignment, align
from ronnaplan.planner.cuts import Shades, shaded
from ronnaplan.planner.worker import Job, Start
from ronnaplan.planning.sampling import SliceSampler
from ronnaplan.scene.cut import Cut
from ronnaplan.scene.field import Field
from ronnaplan.scene.sampled import values_hu
from ronnaplan.transforms import transform_points

CELL_MM = 2.0
"""Both images are registered on cells of this size."""

DOUBTFUL_MM = 2.0
"""Two starts that end further apart than this did not find one answer."""

MODES: Final = ("blend", "checkerboard")

SQUARES = 8
"""Along the shorter side of a view."""

WINDOW_SHARES = (1.0, 99.5)
"""The second image is black below one and white above the other percentile of its values."""

SCALE = 1000.0
"""The range between these percentiles, for the registration: images other than CT have no scale of their own."""


@dataclass(frozen=True)
class Blend:
    """So much of the second image (0 to 1), over all of the first or in every other square."""

    share: float = 0.5
    mode: str = MODES[0]

    def __post_init__(self) -> None:
        """Refuse a mode that there is not."""
        if self.mode not in MODES:
            raise UsageError(f"images are not shown as {self.mode}; they are as {', '.join(MODES)}")


def is_rigid(pose: FloatArray) -> bool:
    """Tell whether a matrix (4, 4) turns and moves, and does nothing else."""
    turned = pose[:3, :3]
    unturned = np.allclose(turned @ turned.T, np.eye(3), atol=1e-6) and float(np.linalg.det(turned)) > 0
    return bool(unturned and np.array_equal(pose[3], [0.0, 0.0, 0.0, 1.0]))


def known_by(image: CTVolume) -> str:
    """Return a SHA-256 of an image's voxels and of where they lie: the same voxels under another header are another."""
    digest, grid = hashlib.sha256(image.voxel_sha256.encode()), image.grid
    for places in (grid.origins_mm, grid.row_step_mm, grid.column_step_mm):
        digest.update(np.ascontiguousarray(places, dtype=np.float64).data)
    return digest.hexdigest()


class Second:
    """The second image and where it lies in the first; it is not shown until it is registered."""

    def __init__(
        self, first: CTVolume, image: CTVolume, name: str, start: Start, keep: Callable[[Alignment], None]
    ) -> None:
        """Take an image as registered where its frame of reference is that of the ``first``.

        ``keep`` is given what a registration found.
        """
        self.name, self._keep = name, keep
        self._first, self._image, self._start = first, image, start
        self._scan = SliceSampler.of(image)
        low, high = np.percentile(image.voxels_hu[::2, ::4, ::4], WINDOW_SHARES)
        self._window = (float(low), float(max(high, low + 1.0)))
        uid = image.source.frame_of_reference_uid
        same = uid is not None and uid == first.source.frame_of_reference_uid
        self._pose: FloatArray | None = np.eye(4) if same else None
        self.quality = (
            "placed by its own frame of reference, which is that of the scan: nothing was compared" if same else ""
        )

    @property
    def placed(self) -> bool:
        """Whether it is known where it lies."""
        return self._pose is not None

    def register(self) -> None:
        """Have it registered to the first image; how far two starts agree is told."""
        fields = Field.of(self._first, CELL_MM), Field.of(self._scaled(), CELL_MM)
        self._start(Job(f"registering {self.name} to the scan", partial(align, *fields), self._take))

    def look(self, blend: Blend) -> tuple[Any, ...]:
        """Return what its picture depends on, besides the cut."""
        return (blend, self.quality) if self.placed else ()

    def over(self, shades: Shades, cut: Cut, blend: Blend) -> Shades:
        """Return the picture of a cut through the first image with this one over it."""
        if self._pose is None or (blend.mode == MODES[0] and not blend.share):
            return shades
        turned = self._pose[:3, :3]
        there = Cut(
            turned @ cut.right,
            turned @ cut.down,
            transform_points(self._pose, cut.center_mm[np.newaxis])[0],
            cut.field_mm,
        )
        mine = shaded(values_hu(self._scan, there, shades.shape, self._window[0]), self._window)
        if blend.mode == MODES[0]:
            return np.rint(shades * (1.0 - blend.share) + mine * blend.share).astype(np.uint8)
        side = max(1, min(shades.shape) // SQUARES)
        rows, columns = (np.arange(count) // side for count in shades.shape)
        return np.where((rows[:, np.newaxis] + columns) % 2 == 0, mine, shades)

    def told(self, blend: Blend) -> dict[str, Any]:
        """Return the image in the page's words."""
        return {
            "name": self.name,
            "placed": self.placed,
            "share": blend.share,
            "mode": blend.mode,
            "quality": self.quality or "of another frame of reference: register it to see it",
        }

    def _take(self, found: Alignment) -> None:
        self.place(found)
        self._keep(found)

    def place(self, found: Alignment) -> None:
        """Take it as lying where a registration found it; what is no rigid motion is passed over."""
        if not is_rigid(found.moving_from_fixed):
            return
        self._pose = found.moving_from_fixed
        doubt = "" if found.apart_mm <= DOUBTFUL_MM and not found.exchanged else "DOUBTFUL, look closely: "
        if found.exchanged:
            doubt += (
                f"with {' and '.join(found.exchanged)} exchanged it fits better, as if its header were wrong; "
            )
        self.quality = (
            f"{doubt}registered by SimpleITK (mutual information); two starts end {found.apart_mm:.2f} mm apart "
            "within the head. To look at only: nothing is measured in it"
        )

    def _scaled(self) -> CTVolume:
        low, high = self._window
        values = (self._image.voxels_hu.astype(np.float32) - low) * (SCALE / (high - low)) + LOWEST_HU
        return replace(self._image, voxels_hu=values)
