"""DICOM files for research: what names nobody is kept, everything else goes (PS3.15, Annex E, basic profile).

Only attributes that `ronnaplan.documents.basic_profile` lists are kept; of the pixels, only the bits that hold values.
UIDs are replaced, each by the same new one wherever it stands, in all files of one run; they cannot be turned back
without its ``secret``.
"""

from __future__ import annotations

import hmac
import io
import shutil
import warnings
from pathlib import Path
from typing import Final

import numpy as np
from pydicom import dcmread
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.uid import UID

from ronnaplan import __version__
from ronnaplan.ct import tags
from ronnaplan.ct.derived import told_by_description
from ronnaplan.ct.files import Blob, DamagedError, NotDicomError, Skipped, given_path
from ronnaplan.ct.folders import blobs_below
from ronnaplan.ct.header import read_header
from ronnaplan.ct.limits import DEFAULT_LIMITS
from ronnaplan.ct.no_dicom import is_failed_copy
from ronnaplan.ct.slices import instance_from_header
from ronnaplan.ct.system_folders import UNFINISHED
from ronnaplan.ct.uids import CT_IMAGE
from ronnaplan.documents.basic_profile import CONTENT, DUMMIES, EMPTIED, EMPTY, ENTERED, KEPT, REPLACED, TAKEN
from ronnaplan.documents.files import make_folder, move_up, write_atomically
from ronnaplan.errors import InputError
from ronnaplan.text import printable

LONGEST_NAME: Final = 16
"""Characters of a patient's pseudonym: as many as DICOM's short strings (SH) hold."""
LEAST_SECRET_BYTES: Final = 32
"""A shorter secret could be guessed, and with it who is behind a pseudonym."""
WHOLE: Final = "whole"
"""The folder in the target that holds all files until they are moved up."""


def deidentify(source: str | Path, target: str | Path, secret: bytes) -> int:
    """Write every DICOM file below ``source`` to the folder ``target``, naming nobody; return how many there were.

    ``secret`` makes the new UIDs: with the same one, files of two runs still belong together. They are written to
    `UNFINISHED` in ``target``, which no reader of scans looks into, and moved up when all are there. Raises
    `InputError` for a ``target`` that holds anything, a file or folder that cannot be opened, a file that cannot be
    read whole, one of another class than `TAKEN`, and pixels that are said to show a name; then nothing is left.
    Files that are no DICOM are left out, but for those that seem to be what a copy that failed has left.
    """
    folder = make_folder(target)
    _require_empty(folder)
    skipped: list[Skipped] = []
    blobs = sorted(blobs_below(given_path(source), DEFAULT_LIMITS, skipped), key=lambda one: one.name)
    for one in skipped:
        if one.is_trouble:
            raise InputError(f"{one.name}: {one.reason}; see to it, or leave it out")
    part, whole = make_folder(folder / UNFINISHED), folder / WHOLE
    names: list[str] = []
    try:
        for blob in blobs:
            if _is_object(blob):
                names.append(f"{len(names) + 1:05d}.dcm")
                write_atomically(part / names[-1], _deidentified_bytes(blob, secret))
        if not names:
            raise InputError(f"{printable(source)} holds no DICOM object; give a folder of CT images")
        move_up(part, whole, names)
    except BaseException:  # a part would be taken for the whole
        for one_of_two in (part, whole):
            shutil.rmtree(one_of_two, ignore_errors=True)
        for name in names:
            (folder / name).unlink(missing_ok=True)
        raise
    return len(names)


def _require_empty(folder: Path) -> None:
    """Raise `InputError` for a folder that holds anything."""
    part = folder / UNFINISHED
    if part.exists():
        raise InputError(
            f"{part} is there: another run writes to it, or one that was ended left it; remove it, or name another "
            "folder"
        )
    if any(folder.iterdir()):
        raise InputError(f"{folder} is not empty; name a new folder, so that nothing in it is taken for made here")


def _is_object(blob: Blob) -> bool:
    """Whether a file is a DICOM object, and no index of others; raises `InputError` for a damaged one."""
    try:
        header = read_header(blob, DEFAULT_LIMITS)
        pixels = instance_from_header(blob, header).pixels
        if pixels is not None and pixels.length is not None and pixels.length < pixels.frame_bytes * pixels.frames:
            raise DamagedError("it ends within its pixels")
    except NotDicomError as error:
        if is_failed_copy(blob):
            raise InputError(
                f"{blob.name}: {error}, though it seems to have been; copy it again, or leave it out"
            ) from error
        return False
    except DamagedError as error:
        raise InputError(f"{blob.name}: {error.with_remedy('copy it again, or leave it out')}") from error
    return tags.FILE_SET_ID not in header.elements


def _deidentified_bytes(blob: Blob, secret: bytes) -> bytes:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of odd values: most of them go
            given = dcmread(io.BytesIO(blob.read(0, blob.size)), force=True)
            given.file_meta.TransferSyntaxUID = UID(read_header(blob, DEFAULT_LIMITS).transfer_syntax)
            file = io.BytesIO()
            deidentified(given, secret).save_as(file, enforce_file_format=True)
            return file.getvalue()
    except InputError as error:
        raise InputError(f"{blob.name}: {error}") from error
    except Exception as error:  # pydicom raises many kinds for a damaged file
        raise InputError(f"{blob.name} cannot be read whole ({printable(error)}); leave it out") from error


def deidentified(given: Dataset, secret: bytes) -> Dataset:
    """Return what may be kept of a data set; raises `InputError` for other classes and for names in the pixels."""
    if given.get("SOPClassUID") not in TAKEN:
        raise InputError(
            f"it is of class {printable(given.get('SOPClassUID'))}; only CT and what was found in it is taken"
        )
    if not given.get("SOPInstanceUID"):
        raise InputError("it has no SOP Instance UID, by which a DICOM file is told from others; leave it out")
    if (given.get("BurnedInAnnotation") or "NO") != "NO":
        raise InputError("its pixels are said to show annotations, which may name the patient; leave it out")
    kept = _kept(given, secret)
    _clear_overlays(kept, given)
    _tell_making(kept, given)
    for keyword in EMPTY:
        setattr(kept, keyword, None)
    for keyword in CONTENT:
        if keyword in given:
            setattr(kept, keyword, None)
    who = "|".join(str(given.get(keyword) or "") for keyword in ("IssuerOfPatientID", "PatientID"))
    if not given.get("PatientID"):  # else all who have none would be one person
        who += f"|{given.get('PatientName') or ''}|{given.get('PatientBirthDate') or ''}"
    kept.PatientID = f"R{_mac(secret, who).hex()[: LONGEST_NAME - 1]}".upper()
    kept.PatientName = kept.PatientID
    kept.PatientIdentityRemoved = "YES"
    kept.LongitudinalTemporalInformationModified = "REMOVED"
    kept.DeidentificationMethod = f"ronnaplan {__version__}: PS3.15 basic profile, listed attributes kept"
    code = Dataset()
    code.CodeValue, code.CodingSchemeDesignator = "113100", "DCM"
    code.CodeMeaning = "Basic Application Confidentiality Profile"
    kept.DeidentificationMethodCodeSequence = [code]
    kept.file_meta = FileMetaDataset()
    kept.file_meta.TransferSyntaxUID = given.file_meta.TransferSyntaxUID
    kept.file_meta.MediaStorageSOPClassUID = kept.SOPClassUID
    kept.file_meta.MediaStorageSOPInstanceUID = kept.SOPInstanceUID
    return kept


def _tell_making(kept: Dataset, given: Dataset) -> None:
    """Have Image Type say what the description alone tells of how an image was made: a projection stays one."""
    written = kept.get("ImageType") or ()
    image_type = (written,) if isinstance(written, str) else tuple(written)
    if kept.SOPClassUID == CT_IMAGE:
        told = told_by_description(image_type, str(given.get("SeriesDescription") or ""))
        if told:
            kept.add_new(tags.IMAGE_TYPE, "CS", [*image_type, *told])


def _kept(given: Dataset, secret: bytes, number: int = 1) -> Dataset:
    """Return what may be kept of a data set, or of the item of this ``number`` of a sequence."""
    found = Dataset()
    for element in given:
        if element.keyword in KEPT:
            found.add(element)
        elif element.keyword in REPLACED and element.value:
            found.add_new(element.tag, element.VR, _uid(secret, str(element.value)))
        elif element.keyword in ENTERED:
            found.add_new(element.tag, "SQ", [_kept(item, secret, n) for n, item in enumerate(element.value, 1)])
        elif element.keyword in EMPTIED:
            found.add_new(element.tag, "SQ", [Dataset()])
        elif element.keyword in DUMMIES:
            dummy = DUMMIES[element.keyword]
            found.add_new(element.tag, element.VR, f"{dummy}{number}" if element.VR == "SH" else dummy)
    return found


OVERLAY_GROUPS: Final = range(0x6000, 0x6100, 2)
BIT_POSITION: Final = 0x0102
"""Element of an overlay's group: the bit of the pixels that holds it, 0 where it has data of its own."""


def _clear_overlays(kept: Dataset, given: Dataset) -> None:
    """Clear the bits of pixels that hold no values: scanners wrote overlays there, which may show a name.

    Raises `InputError` for compressed pixels that are said to hold an overlay, and for values beyond their words.
    """
    allocated, stored = kept.get("BitsAllocated", 0), kept.get("BitsStored", 0)
    if "PixelData" not in kept or allocated not in (8, 16, 32) or not 1 <= stored < allocated:
        return
    if given.file_meta.TransferSyntaxUID.is_encapsulated:
        told = [given.get((group, BIT_POSITION)) for group in OVERLAY_GROUPS]
        if any(one is not None and one.value for one in told):
            raise InputError("its compressed pixels hold an overlay, which may show a name; leave it out")
        return
    above = allocated - 1 - kept.HighBit
    below = allocated - stored - above
    if min(above, below) < 0:
        raise InputError(f"its values of {stored} bits cannot end at bit {kept.HighBit}; leave it out")
    order = "<" if given.file_meta.TransferSyntaxUID.is_little_endian else ">"
    whole = np.dtype(f"{order}u{allocated // 8}")
    signed = np.dtype(f"{order}i{allocated // 8}")
    pixels = np.frombuffer(kept.PixelData, signed if kept.PixelRepresentation == 1 else whole)
    told = [kept.get(keyword) for keyword in ("PixelPaddingValue", "PixelPaddingRangeLimit")]
    padding = np.array([one % (1 << allocated) for one in told if one is not None], whole).view(pixels.dtype)
    cleared = pixels << above >> above >> below << below
    if padding.size:  # it may lie beyond the stored bits
        cleared = np.where((pixels >= padding.min()) & (pixels <= padding.max()), pixels, cleared)
    kept.add_new(tags.PIXEL_DATA, kept["PixelData"].VR, cleared.astype(pixels.dtype).tobytes())


def _uid(secret: bytes, uid: str) -> UID:
    """Return the UID that stands for ``uid``, of 128 bits of a keyed hash (PS3.5, B.2)."""
    return UID(f"2.25.{int.from_bytes(_mac(secret, uid.strip())[:16], 'big')}")


def _mac(secret: bytes, text: str) -> bytes:
    return hmac.digest(secret, text.encode(), "sha256")
