"""What the index of a disc, a DICOMDIR, lists of each series: files are found by walking, and some may not be there."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping
from io import BytesIO
from typing import TYPE_CHECKING, Final

from ronnaplan.ct.files import Blob
from ronnaplan.ct.limits import Limits

if TYPE_CHECKING:
    from pydicom.dataset import Dataset

INDEX_NAMES: Final = ("DICOMDIR", "DIRFILE")
"""How indices are named, in capitals; the latter by old programs."""
_NOT_IN_USE: Final = 0
"""What a record says that stands for nothing any more (PS3.3, F.3.2.2)."""


def is_index(blob: Blob) -> bool:
    """Whether a file is named as the index of a disc is."""
    return blob.name.upper().endswith(INDEX_NAMES)


def listed_images(blob: Blob, limits: Limits) -> dict[str, set[str]]:
    """Return, by the UIDs of series, those of the images that an index lists; nothing of one that cannot be read."""
    from pydicom import dcmread

    if blob.size > limits.header_bytes:
        return {}
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            index = dcmread(BytesIO(blob.read(0, blob.size)))
            records = {one.seq_item_tell: one for one in index.get("DirectoryRecordSequence") or []}
            return {
                str(one.SeriesInstanceUID): set(_images_of(one, records))
                for one in records.values()
                if one.get("DirectoryRecordType") == "SERIES"
            }
    except Exception:  # pydicom raises many kinds; the files count, whatever their index holds
        return {}


def _images_of(series: Dataset, records: Mapping[int, Dataset]) -> Iterator[str]:
    """Yield the UIDs of a series' images: each record says where in the file the next one is (PS3.3, F.2.2)."""
    offset, left = series.OffsetOfReferencedLowerLevelDirectoryEntity, len(records)
    while offset and left:  # a damaged list may be a circle
        one, left = records[offset], left - 1
        if one.get("DirectoryRecordType") == "IMAGE" and one.get("RecordInUseFlag") != _NOT_IN_USE:
            yield str(one.ReferencedSOPInstanceUIDInFile)
        offset = one.OffsetOfTheNextDirectoryRecord
