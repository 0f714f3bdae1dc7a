"""What a file is that is no DICOM file, as far as its name and its first bytes tell."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from ronnaplan.ct.archives import starts_as_archive
from ronnaplan.ct.files import Blob, DamagedError, DiskFile, Skipped, starts_with
from ronnaplan.ct.images import is_image_file

PACKED: Final = "it is packed in a way that is not read; unpack it first"
_ENDINGS: Final = (".dcm", ".dcm.gz", ".dcm.part")
"""How files are named that are images, were packed by themselves, or did not come whole."""
_PACKED: Final = (".tar", ".tgz", ".gz", ".bz2", ".xz", ".zst", ".7z", ".rar")
"""How files are named that hold others, and are not looked into."""
_OTHER_IMAGES: Final = (".hdr", ".img", ".gipl", ".vtk", ".vti", ".mnc", ".mgh", ".mgz", ".jnii", ".bnii")
"""How images are named whose formats are not read."""
_APPLE_DOUBLE: Final = b"\0\x05\x16\x07"
"""How files begin in which macOS keeps, beside a file ``NAME`` as ``._NAME``, what other systems' disks cannot."""
_SEEN_BYTES: Final = 132
"""Up to where each DICOM file says that it is one."""


def is_failed_copy(blob: Blob) -> bool:
    """Whether a file that is no DICOM file seems to have been an image: by its name, or as it is blank."""
    if blob.name.lower().endswith(_ENDINGS):
        return not starts_with(blob, _APPLE_DOUBLE)
    return _is_blank(blob)


def is_inner_archive(skipped: Skipped) -> bool:
    """Whether a file that was left out is a zip archive within another one."""
    return skipped.reason == PACKED and skipped.name.lower().endswith(".zip")


def _is_blank(blob: Blob) -> bool:
    """Whether a file that is named as images are is empty, or begins with zeros alone, as a copy that failed does."""
    name = Path(blob.name)
    is_image = name.suffix.lower() in ("", ".ima") or name.suffix[1:].isdigit()
    if not is_image or name.name.startswith("."):
        return False
    try:
        return not blob.read(0, _SEEN_BYTES).strip(b"\0")
    except DamagedError:  # a disk or a network that fails now
        return True


def why_no_dicom(blob: Blob) -> str:
    """Return what a file is that is no DICOM file, as far as its name tells; "" for any other."""
    name = blob.name.lower()
    is_zip = name.endswith(".zip")
    if is_zip and not starts_as_archive(blob):
        return "it is no zip archive in spite of its name; copy it again"
    if isinstance(blob, DiskFile) and (is_zip or is_image_file(Path(blob.path))):
        return "it is an image file or archive; name it by itself"
    if name.endswith(_OTHER_IMAGES):
        return "it is an image in a format that is not read; convert it to NIfTI, NRRD or MetaImage"
    return PACKED if is_zip or name.endswith(_PACKED) else ""
