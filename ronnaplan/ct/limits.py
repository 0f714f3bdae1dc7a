"""How much a reader may take on before it refuses: guards against damaged and hostile files."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ronnaplan.bounds import LARGEST_HU

if TYPE_CHECKING:
    from numpy.typing import NDArray

MIB = 1 << 20
GIB = 1 << 30
INT16_BITS = 16
LARGE_DEFLATED = "it is deflated as a whole, and too large to be unpacked for each image; export it uncompressed"
"""Why a file is not read of which each image would have all before it unpacked anew."""


@dataclass(frozen=True)
class Limits:
    """Upper bounds of one read; raise one knowingly, for data you trust.

    ``files`` counts what lies below the given folder or inside the archive; ``folder_depth`` and
    ``sequence_depth`` say how deep folders and DICOM sequences may nest. ``header_bytes`` and
    ``header_elements`` are what may stand before the pixels of one file, ``file_bytes`` the size of one file
    once unpacked, ``volume_bytes`` the voxels of the finished volume, ``archive_bytes`` all of a zip archive
    once unpacked.
    """

    files: int = 50_000
    folder_depth: int = 32
    sequence_depth: int = 32
    header_bytes: int = 16 * MIB
    header_elements: int = 500_000
    file_bytes: int = 4 * GIB
    volume_bytes: int = 4 * GIB
    archive_bytes: int = 32 * GIB


DEFAULT_LIMITS = Limits()


def are_hu(values: NDArray[Any]) -> bool:
    """Return whether ``values`` (...) are finite numbers that a scanner's scale holds."""
    low, high = float(values.min(initial=0)), float(values.max(initial=0))  # a float16 could not hold the bound
    return low >= -LARGEST_HU and high <= LARGEST_HU


def fit_int16(values: NDArray[Any]) -> bool:
    """Return whether ``values`` (...) are whole numbers, all of which an int16 holds."""
    if values.dtype.kind == "i" and values.dtype.itemsize <= INT16_BITS // 8:
        return True
    most = 1 << INT16_BITS - 1
    if not (-most <= values.min() and values.max() < most):
        return False
    return bool(values.dtype.kind in "iu" or (values == values.round()).all())
