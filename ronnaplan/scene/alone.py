"""A head by itself: what it lies on is left out of what is drawn, where it can be told apart."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ronnaplan.bounds import LOWEST_HU
from ronnaplan.scene.field import Field

Mask = NDArray[np.bool_]
"""Which cells (nz, ny, nx) of a field are meant."""

SKIN_HU: Final = -400.0
"""What is denser is no air."""

THIN_MM: Final = 6.4
"""What is thinner than this is no head: headrest, cushion's cover, strap; but ear and marker's post, too."""

RIDGE_MM: Final = 3.2
"""What stands out no further from the thick body is of it: edges, and terraces of thick slices."""

PART_MM: Final = 80.0
"""What is thin, hangs on and reaches further along an axis is no part of the head: no ear and no post is so long."""

HOLLOW_SHARE: Final = 0.6
"""A body whose thick part fills less of the outline is hollow, as dry skulls and shells are: nothing is left out of it.
A head fills 0.97 of its own outline and more than 0.7 of that with a curved rest which it touches at both ends; a skull
of plastic with thin walls 0.49."""

VEIL_MM: Final = 4.8
"""About the head all is kept so far: what is half skin and half air."""


def alone(field: Field) -> Field:
    """Return the field with the thickest body and its small parts only, and air about them.

    It stays as it is where there is none, or where something thinner has a larger outline.
    """
    from scipy.ndimage import binary_dilation, binary_erosion, label

    dense = field.values >= SKIN_HU
    thin = max(1, round(THIN_MM / 2 / field.cell_mm))
    core = _largest(binary_erosion(dense, iterations=thin))
    if core is None:
        return field
    pieces, _ = label(dense)
    number = int(pieces.flat[core.argmax()])
    whole = pieces == number
    body = binary_dilation(core, iterations=thin + round(RIDGE_MM / field.cell_mm)) & whole
    outline = _filled(whole)
    if _has_larger(pieces, number, int(outline.sum())):
        return field
    if body.sum() < HOLLOW_SHARE * outline.sum():
        body = outline
    else:
        body |= _small_parts(whole & ~body, PART_MM / field.cell_mm)
    kept = binary_dilation(body, iterations=round(VEIL_MM / field.cell_mm)) & (body | ~dense)
    return replace(field, values=np.where(kept, field.values, np.float32(LOWEST_HU)))


def _largest(mask: Mask) -> Mask | None:
    """Return the largest piece, None where there is none."""
    from scipy.ndimage import label

    pieces, count = label(mask)
    if not count:
        return None
    sizes = np.bincount(pieces.ravel())
    sizes[0] = 0
    found: Mask = pieces == sizes.argmax()
    return found


def _has_larger(pieces: NDArray[np.integer[Any]], but: int, cells: int) -> bool:
    """Whether the outline of any other piece holds more than so many cells."""
    from scipy.ndimage import find_objects

    for number, places in enumerate(find_objects(pieces), start=1):
        box = pieces[places]
        if number != but and box.size > cells and _filled(box == number).sum() > cells:
            return True
    return False


def _small_parts(mask: Mask, most_cells: float) -> Mask:
    """Return the pieces that are no longer than so many cells along any axis."""
    from scipy.ndimage import find_objects, label

    pieces, count = label(mask)
    small = np.zeros(count + 1, dtype=np.bool_)
    for number, places in enumerate(filter(None, find_objects(pieces)), start=1):
        small[number] = max(each.stop - each.start for each in places) <= most_cells
    found: Mask = small[pieces]
    return found


def _filled(mask: Mask) -> Mask:
    """Return all that lies within the outlines in each axial slice."""
    import cv2

    found = np.zeros(mask.shape, dtype=np.uint8)
    for whole, outlined in zip(found, mask, strict=True):
        lines, _ = cv2.findContours(outlined.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        cv2.drawContours(whole, lines, -1, 1, cv2.FILLED)
    return found.astype(np.bool_)
