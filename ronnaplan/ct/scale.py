"""Whether values can be Hounsfield units of something in air: what a header says wrongly of their scale shows in them.

A rescale may have been applied twice, or never, or have a wrong sign or factor; stored values may have lost their sign.
The picture looks the same then, in a window of its own. But markers are not found in it, or other things are taken for
air. A crop, or a phantom of foam, may look so, too: it is flagged, never refused.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ronnaplan.bounds import LOWEST_HU
from ronnaplan.ct.flags import VolumeFlag, Voxels
from ronnaplan.ct.scratch import one_by_one

AIR_BELOW_HU: Final = -500.0
"""A head is scanned in air, which is lower than this in every scan, and never so in values that are offset."""
AIR_ABOVE_HU: Final = -1500.0
"""Half of an offset of 1024 below air. Cone beams whose scale is their own show air at -1200."""
PADDING_GAP_HU: Final = 100.0
"""Air has noise, and leaves no such gap between its values: one that lies alone stands for what was not measured."""
TISSUE_ABOVE_HU: Final = -300.0
"""Tissue, bone, and markers of any material are higher than this."""
BRIGHT_HU: Final = 500.0
"""Not even of a head that fills the field of view is half brighter than this."""
SEEN: Final = 32
"""So many slices, rows and columns are looked at."""
LEAST_VOXELS: Final = 128 * 128
"""Fewer, not even one coarse slice, are too few to show what a head in air looks like."""


def doubts_of_scale(voxels_hu: Voxels, padding_hu: float | None) -> tuple[VolumeFlag, ...]:
    """Return the reasons to doubt that values (K, J, I) are HU, other than those that are ``padding_hu``."""
    if voxels_hu.size < LEAST_VOXELS:
        return ()
    seen = seen_values(voxels_hu, padding_hu)
    if not seen.size:
        return VolumeFlag.NO_AIR, VolumeFlag.NO_TISSUE
    air = _without_paddings(seen[seen < AIR_BELOW_HU])
    doubts = {
        VolumeFlag.NO_AIR: not any(low <= AIR_BELOW_HU for low, _ in _ends(seen, voxels_hu, padding_hu)),
        VolumeFlag.LOW_AIR: air.size > 0 and float(np.median(air)) < AIR_ABOVE_HU,
        VolumeFlag.NO_TISSUE: not any(high > TISSUE_ABOVE_HU for _, high in _ends(seen, voxels_hu, padding_hu)),
        VolumeFlag.INVERTED: float(np.median(seen)) > BRIGHT_HU,
    }
    return tuple(flag for flag, holds in doubts.items() if holds)


def unmeasured_hu(voxels_hu: Voxels) -> float | None:
    """Return what stands in voxels (K, J, I) for what was not measured, outside the circle of reconstruction.

    That is the one value, below any that air can take, in all corners of all slices; None where there is none.
    """
    corners = np.array([plane[[0, 0, -1, -1], [0, -1, 0, -1]] for plane in one_by_one(voxels_hu)])
    value = float(corners.min())
    return value if value < LOWEST_HU and bool((corners == value).all()) else None


def seen_values(voxels_hu: Voxels, padding_hu: float | None) -> NDArray[Any]:
    """Return some of the values (N,), from all over the scan, that are no padding."""
    steps = [slice(None, None, max(size // SEEN, 1)) for size in voxels_hu.shape]
    return _measured(voxels_hu[tuple(steps)], padding_hu)


def _measured(voxels_hu: NDArray[Any], padding_hu: float | None) -> NDArray[Any]:
    """Return the values that are no padding."""
    return voxels_hu.ravel() if padding_hu is None else voxels_hu[voxels_hu != padding_hu]


def _without_paddings(air: NDArray[Any]) -> NDArray[Any]:
    """Return values without the lowest ones that lie alone, and the next: several paddings may be without a tag."""
    values = np.unique(air)
    alone = np.append(np.diff(values) > PADDING_GAP_HU, False)
    return air[air > values[alone.argmin()]] if air.size else air


def _ends(seen: NDArray[Any], voxels_hu: Voxels, padding_hu: float | None) -> Iterator[tuple[float, float]]:
    """Yield the lowest and the highest value of what was ``seen``, and then, as it may not tell all, of each slice."""
    yield float(seen.min()), float(seen.max())
    for plane in one_by_one(voxels_hu):
        measured = _measured(plane, padding_hu)
        if measured.size:
            yield float(measured.min()), float(measured.max())
