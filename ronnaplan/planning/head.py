"""Where a head ends and the air about it begins, coarsely: tells a sinus from the outside, skin from a post."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ronnaplan.bounds import LOWEST_HU
from ronnaplan.ct.volume import WAYS_TO_A_VOLUME, CTVolume, Voxels
from ronnaplan.errors import InputError, check_type
from ronnaplan.geometry import FloatArray
from ronnaplan.planning.sampling import SliceSampler
from ronnaplan.text import place

SKIN_HU = -450.0
"""About half way between air and skin; crossings are found at it and then fitted to the local levels."""

CELL_MM = 2.0
"""Size of the coarse cells in a slice."""

OPENING_MM = 8.0
"""Things on the head narrower than twice this (markers, posts, tubes, a frame's pins) are not head."""

LEAST_HEAD_MM2 = 4000.0
"""A head fills more than this in its largest slice; a scan without that holds no head."""


@dataclass(frozen=True, eq=False, repr=False)
class Head:
    """A scanned head, ready to be measured along paths.

    ``inside`` (K, J', I') tells which coarse cells (``cell`` voxels wide and high) belong to the head, its air
    spaces included. ``met`` keeps what `find_crossings` measured last, by ray: an end that is set is checked, and the
    path to it judged, by one measurement.
    """

    volume: CTVolume
    scan: SliceSampler
    inside: NDArray[np.bool_]
    cell: int
    met: OrderedDict[tuple[float, ...], Any] = field(default_factory=OrderedDict, repr=False)

    def __repr__(self) -> str:
        return f"Head(in {self.volume!r}, its middle at {place(self.center_mm)} mm)"

    @classmethod
    def of(cls, volume: CTVolume) -> Head:
        """Find the head in ``volume``; raises `InputError` when there is none."""
        check_type(volume, CTVolume, "the volume", WAYS_TO_A_VOLUME)
        scan = SliceSampler.of(volume)
        cell = max(1, round(CELL_MM / float(scan.steps_mm.max())))
        inside = _largest_part(np.stack([_tissue(plane, cell, scan) for plane in scan.voxels]))
        filled = np.stack([_fill(plane) for plane in inside])
        area = float(filled.sum(axis=(1, 2)).max(initial=0)) * cell**2 * float(scan.steps_mm.prod())
        if area < LEAST_HEAD_MM2:
            raise InputError(
                f"the largest slice shows {area:.0f} mm^2 of tissue; expected a head (over {LEAST_HEAD_MM2:.0f})"
            )
        return cls(volume, scan, filled, cell)

    @cached_property
    def center_mm(self) -> FloatArray:
        """Centroid (3,) of the head in LPS mm."""
        center: FloatArray = self.places_mm(self.inside).mean(axis=0)
        return center

    @cached_property
    def boundary_mm(self) -> FloatArray:
        """Coarse cells (N, 3) at the surface of the head, in LPS mm."""
        from scipy.ndimage import binary_erosion

        return self.places_mm(self.inside & ~binary_erosion(self.inside))

    def places_mm(self, cells: NDArray[np.bool_]) -> FloatArray:
        """Return the middles (N, 3) of coarse ``cells`` (K, J', I'), in LPS mm."""
        k, j, i = (places.astype(np.float64) for places in np.nonzero(cells))
        half = (self.cell - 1) / 2
        return self.volume.grid.positions_mm(np.stack([k, j * self.cell + half, i * self.cell + half], axis=-1))


def _tissue(plane: Voxels, cell: int, scan: SliceSampler) -> NDArray[np.bool_]:
    """Whether each coarse cell (J', I') of a slice is tissue, narrow things left out."""
    import cv2

    rows, columns = (n // cell for n in plane.shape)
    whole = np.maximum(plane[: rows * cell, : columns * cell], LOWEST_HU).astype(np.float32)
    mean = cv2.resize(whole, (columns, rows), interpolation=cv2.INTER_AREA)
    wide, high = (2 * int(OPENING_MM / (cell * step)) + 1 for step in scan.steps_mm)
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (wide, high))
    # Air inside (sinuses, ear canals) must not cut thin walls away, so it is filled before the opening.
    solid = _fill(mean > SKIN_HU).astype(np.uint8)
    opened: NDArray[np.bool_] = cv2.morphologyEx(solid, cv2.MORPH_OPEN, disc).astype(np.bool_)
    return opened


def _fill(plane: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return a plane with its holes filled: what cannot be reached from beyond its edges."""
    import cv2

    outside = 2
    marked = np.pad(~plane, 1, constant_values=True).astype(np.uint8)
    cv2.floodFill(marked, None, (0, 0), outside)
    filled: NDArray[np.bool_] = marked[1:-1, 1:-1] != outside
    return filled


def _largest_part(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    from scipy.ndimage import label

    parts, count = label(mask)
    if count == 0:
        return mask
    sizes = np.bincount(parts.ravel())
    sizes[0] = 0
    largest: NDArray[np.bool_] = parts == sizes.argmax()
    return largest
