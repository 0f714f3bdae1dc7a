"""Which scan something is of, and whether two things are of one: by frames, and by voxels where frames do not tell."""

from __future__ import annotations

from dataclasses import dataclass

from ronnaplan.errors import FrameMismatchError, InputError
from ronnaplan.geometry import Frame


@dataclass(frozen=True)
class ScanIdentity:
    """The scan that something is of, which is called ``name`` in sentences; what is not stated is None."""

    name: str
    frame: Frame
    series_uid: str | None = None
    voxel_sha256: str | None = None

    def require(self, other: ScanIdentity) -> None:
        """Raise unless ``other`` is of the same examination.

        `FrameMismatchError` for another frame of reference, and for other voxels where neither names one: then only the
        voxels tell. `InputError` for other voxels under one series UID: its files were replaced, or are others of its
        parts. Another series in the same frame is the same head.
        """
        if self.frame != other.frame:
            raise FrameMismatchError(
                f"{other.name} is in frame {other.frame} but {self.name} in {self.frame}; "
                "use the documents and the scan of one examination"
            )
        same = self.voxel_sha256 == other.voxel_sha256
        if self.frame.uid is None and (not same or self.voxel_sha256 is None):
            raise FrameMismatchError(
                f"neither {self.name} nor {other.name} names a frame of reference and their voxels differ or are not "
                "stated; use the scan that the documents were made of"
            )
        stated = None not in (self.series_uid, self.voxel_sha256, other.voxel_sha256)
        if stated and self.series_uid == other.series_uid and not same:
            raise InputError(
                f"{other.name} is of other voxels than {self.name} though both name series {self.series_uid}, as where "
                "its files were replaced or another part of it was read; use what both were made of, or make "
                "the older one anew"
            )
