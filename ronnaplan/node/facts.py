"""What the node must know of an instance before it takes it: read from the header, within the reader's limits."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from ronnaplan.ct import tags
from ronnaplan.ct.encapsulated import require_whole
from ronnaplan.ct.files import DiskFile
from ronnaplan.ct.header import read_header
from ronnaplan.ct.limits import DEFAULT_LIMITS
from ronnaplan.ct.values import text
from ronnaplan.errors import InputError
from ronnaplan.text import printable, whole_number

UID: Final = re.compile(r"(?=.{1,64}$)[0-9]+(\.[0-9]+)*")
"""A UID as it may become the name of a file."""


@dataclass(frozen=True)
class Facts:
    """Who an instance is, and what rules look at. ``sha256`` is that of its data set, without the file's meta part."""

    sop_uid: str
    sop_class: str
    study_uid: str
    series_uid: str
    syntax: str
    modality: str
    description: str
    station: str
    protocol: str
    patient_name: str
    expected: int | None
    """Instances that the header says the series has."""
    sha256: str
    size: int


def read_facts(path: Path, sha256: str, *, only_whole: bool = False) -> Facts:
    """Read a file that the node wrote down as it was received; raises `InputError` for what is no DICOM instance.

    ``sha256`` is that of its data set. With ``only_whole`` it does so for half of one, too.
    """
    file = DiskFile(str(path), path.stat().st_size)
    header = read_header(file, DEFAULT_LIMITS)
    if only_whole:
        require_whole(file, header)
    elements = header.elements
    uids = {}
    for name, tag in (
        ("SOP instance", tags.SOP_INSTANCE_UID),
        ("study", tags.STUDY_INSTANCE_UID),
        ("series", tags.SERIES_INSTANCE_UID),
    ):
        uids[name] = text(elements, tag)
        if UID.fullmatch(uids[name]) is None:
            raise InputError(
                f"its {name} UID is '{printable(uids[name], 80)}'; expected up to 64 digits and points"
            )
    return Facts(
        sop_uid=uids["SOP instance"],
        sop_class=text(elements, tags.SOP_CLASS_UID),
        study_uid=uids["study"],
        series_uid=uids["series"],
        syntax=header.transfer_syntax,
        modality=text(elements, tags.MODALITY),
        description=text(elements, tags.SERIES_DESCRIPTION),
        station=text(elements, tags.STATION_NAME),
        protocol=text(elements, tags.PROTOCOL_NAME),
        patient_name=text(elements, tags.PATIENT_NAME),
        expected=whole_number(text(elements, tags.NUMBER_OF_SERIES_RELATED_INSTANCES)),
        sha256=sha256,
        size=file.size,
    )
