"""The patient and the study of a scan, for objects that are to lie beside it in an archive; on request only."""

from __future__ import annotations

import io
import logging
import os
import warnings
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

from pydicom import dcmread
from pydicom.dataset import Dataset
from pydicom.multival import MultiValue

from ronnaplan.ct import Series, find_series
from ronnaplan.ct.header import DEFLATED_LITTLE
from ronnaplan.ct.limits import DEFAULT_LIMITS
from ronnaplan.ct.slices import Instance
from ronnaplan.documents.fiducials import Source
from ronnaplan.errors import FrameMismatchError, InputError
from ronnaplan.text import printable

LOG = logging.getLogger(__name__)

PATIENT = (
    *("PatientName", "PatientID", "IssuerOfPatientID", "PatientBirthDate", "PatientBirthTime", "PatientSex"),
    *("PatientIdentityRemoved", "DeidentificationMethod"),
)
"""Of the Patient Module (PS3.3, C.7.1.1), what names the patient."""
STUDY = (
    *("StudyInstanceUID", "StudyDate", "StudyTime", "ReferringPhysicianName", "StudyID", "AccessionNumber"),
    "StudyDescription",
)
"""The General Study Module (C.7.2.1) but for its sequences."""
MAY_BE_UNKNOWN = (
    *("PatientBirthDate", "PatientBirthTime", "PatientSex", "PatientIdentityRemoved", "StudyDate", "StudyTime"),
    *("ReferringPhysicianName", "StudyDescription"),
)
"""Of both, dates, times, codes and free words. By none of them an archive tells a study, the standard lets them be
empty, and many an anonymizer or old scanner wrote what no date is (``00000000``, ``unknown``, ``1970.01.31``), or words
in another character set than it states."""
_TOO_LONG = "The (value|PN component) length .* exceeds the maximum"
"""What pydicom warns of where a text is longer than the standard lets it be, as many hospitals' accession numbers are:
it is copied, as it is by this that an archive tells the study."""


_MISSPELT = "Incorrect value for Specific Character Set .* assuming"
"""What it warns of where ``ISO_IR 100`` is written ``ISO IR 100``, which leaves no doubt."""
_UNKNOWN_SET = "Unknown encoding|Value .* for Specific Character Set does not allow code extensions"
"""What it warns of where nobody knows the character set, before it guesses letters. Without these it makes no odds."""


class _Modules(NamedTuple):
    """What a file tells of patient and study; of what is ``unknown``, which is empty in ``copied``, its own words."""

    copied: Dataset
    unknown: dict[str, Any]

    def value(self, keyword: str) -> object:
        """Return what the file says, be it known or not."""
        return self.unknown.get(keyword, self.copied.get(keyword))


def patient_of_scan(
    path: str | os.PathLike[str], source: Source, tell: Callable[[str], None] = LOG.warning
) -> Dataset:
    """Return the patient and study modules of the series of ``source``, found below ``path``.

    What is none of DICOM where it may be unknown is left empty, and ``tell`` told so in a sentence that names
    nobody. Raises `InputError` when the series is not there, its files differ in who or which study it is, or another
    value is none of DICOM; `FrameMismatchError` when it lies in another frame of reference than ``source``.
    """
    series = _series(path, source)
    told = [_modules(instance) for instance in _instances(series)]
    first = told[0]
    for other in told[1:]:
        for keyword in (*PATIENT, *STUDY):
            if first.value(keyword) != other.value(keyword):
                raise InputError(
                    f"the files of series {printable(source.series_instance_uid)} differ in {keyword}; "
                    "sort them by patient first"
                )
    for keyword in first.unknown:
        tell(f"the scan's {keyword} is none that DICOM knows, and is left empty; correct it in the scan's headers")
    return first.copied


def _series(path: str | os.PathLike[str], source: Source) -> Sequence[Series]:
    if not source.series_instance_uid:
        raise InputError("the document names no series, so its patient cannot be looked up; leave out --ct")
    found = [
        one for one in find_series(os.fspath(path)).series if one.first.series_uid == source.series_instance_uid
    ]
    if not found:
        raise InputError(
            f"{printable(os.fspath(path))} does not hold series {printable(source.series_instance_uid)}, "
            "of which the document was made; give the scan that was localized"
        )
    for one in found:
        if one.first.study_uid != source.study_instance_uid:
            raise InputError(
                f"series {one.key} is of study {one.first.study_uid} but the document names study "
                f"{source.study_instance_uid}; give the scan that was localized"
            )
        if one.first.frame_of_reference_uid not in (None, source.frame_of_reference_uid):
            raise FrameMismatchError(
                f"series {one.key} lies in the frame of reference {one.first.frame_of_reference_uid} but the document "
                f"in {source.frame_of_reference_uid}; give the scan that was localized"
            )
    return found


def _instances(series: Sequence[Series]) -> Iterator[Instance]:
    for one in series:
        files = {image.instance.blob.name: image.instance for image in one.stack.slices} if one.stack else {}
        yield from files.values() or (one.first,)


def _modules(instance: Instance) -> _Modules:
    pixels, end = instance.pixels, instance.blob.size
    if pixels is not None and pixels.transfer_syntax != DEFLATED_LITTLE:
        end = pixels.offset
    content = instance.blob.read(0, min(end, DEFAULT_LIMITS.header_bytes))
    copied, unknown = Dataset(), {}
    with warnings.catch_warnings(record=True) as of_set:
        warnings.simplefilter("error")  # pydicom warns of values that are none, and keeps them
        warnings.filterwarnings("ignore", f"{_TOO_LONG}|{_MISSPELT}")
        warnings.filterwarnings("always", _UNKNOWN_SET)
        try:
            given = dcmread(
                io.BytesIO(content), force=True, stop_before_pixels=True, specific_tags=[*PATIENT, *STUDY]
            )
        except Exception as error:  # pydicom raises many kinds for a damaged header
            raise _no_copy(instance, "patient or study", error) from error
        for keyword in (*PATIENT, *STUDY):
            raw = given.get_item(keyword)
            try:
                if raw is not None:
                    if of_set and not _is_plain(raw.value):
                        raise UnicodeError("letters of an unknown character set")
                    value = given.get(keyword)
                    setattr(copied, keyword, None if value is None else _as_it_stands(value))
            except Exception as error:
                if keyword not in MAY_BE_UNKNOWN:
                    raise _no_copy(instance, keyword, error) from error
                setattr(copied, keyword, None)
                unknown[keyword] = raw.value
    return _Modules(copied, unknown)


def _is_plain(raw: object) -> bool:
    """Whether a value reads alike in all character sets."""
    return not isinstance(raw, bytes) or (raw.isascii() and b"\x1b" not in raw)


def _as_it_stands(value: object) -> str:
    """Return a text as it is written: one with a backslash is several to pydicom."""
    return "\\".join(map(str, value)) if isinstance(value, MultiValue) else str(value)


def _no_copy(instance: Instance, what: str, error: Exception) -> InputError:
    """Return why ``what`` is not copied: in the words of pydicom, but for the value, which may name somebody."""
    reason = printable(str(error).partition("\n")[0].partition(": ")[0])  # it goes on with a traceback
    return InputError(
        f"the {what} of {printable(instance.blob.name)} cannot be copied ({reason}); correct its header"
    )
