"""What stands out of a scanned head, or beside it: posts, screws, tubes, a frame's pins; not what it lies on."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ronnaplan.bounds import LOWEST_HU
from ronnaplan.ct.volume import Voxels
from ronnaplan.geometry import FloatArray, unit
from ronnaplan.planning.head import SKIN_HU, Head

LEAST_MM3 = 15.0
"""What is smaller, half of a ball of 4 mm, is noise."""
ROD_MM = 1.0
"""Means over so much of a slice are looked at: of fine voxels, many to a cell, too many are bright by noise alone."""


def beside(head: Head) -> FloatArray:
    """Return balls (N, 4), middle in LPS and radius in mm, about the cells of all that is denser than air beside it.

    What lies right on the scalp is of its surface. What leaves the scan towards the feet, with all that it touches,
    is left out: it is the holder that the head was scanned on, and another stands in the room.
    """
    from scipy.ndimage import binary_dilation, label

    dense = np.stack([_dense(plane, head) for plane in head.scan.voxels])
    on_scalp = binary_dilation(head.inside, np.ones((1, 3, 3), dtype=np.bool_))
    parts, count = label(dense & ~on_scalp, np.ones((3, 3, 3)))
    cell_mm3 = head.cell**2 * float(head.scan.steps_mm.prod()) * head.volume.grid.typical_gap_mm
    stands = np.bincount(parts.ravel(), minlength=count + 1) * cell_mm3 >= LEAST_MM3
    stands[0] = False
    stands[_last_towards_feet(parts, head)] = False
    middles_mm = head.places_mm(stands[parts])
    return np.column_stack([middles_mm, np.full(len(middles_mm), _half_diagonal_mm(head))])


def _dense(plane: Voxels, head: Head) -> NDArray[np.bool_]:
    """Whether any of each coarse cell (J', I') of a slice is denser than air: a thin rod fills none."""
    import cv2

    cell = head.cell
    rows, columns = (n // cell for n in plane.shape)
    wide, high = (max(1, round(ROD_MM / step)) for step in head.scan.steps_mm.tolist())
    means = cv2.blur(np.maximum(plane, LOWEST_HU).astype(np.float32), (wide, high))
    cells = (means[: rows * cell, : columns * cell] > SKIN_HU).reshape(rows, cell, columns, cell)
    return np.asarray(cells.any(axis=(1, 3)))


def _last_towards_feet(parts: NDArray[np.signedinteger], head: Head) -> NDArray[np.signedinteger]:
    """Return the numbers of ``parts`` (K, J', I') on the face of the scan that is nearest to the feet."""
    grid = head.volume.grid
    superior = [unit(step)[2] for step in (grid.normal, grid.row_step_mm, grid.column_step_mm)]
    axis = int(np.abs(superior).argmax())
    face: NDArray[np.signedinteger] = np.take(parts, 0 if superior[axis] > 0 else -1, axis=axis)
    return face.ravel()


def _half_diagonal_mm(head: Head) -> float:
    """Half of a coarse cell's longest diagonal, where slices are farthest apart."""
    gap_mm = float(head.volume.grid.spacings_mm.max(initial=0.0))
    return float(np.linalg.norm([*(head.cell * head.scan.steps_mm), gap_mm])) / 2
