"""Whether an archive's matches fit what it was asked for: one that knows a key less well may pass over it."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from datetime import datetime
from fnmatch import fnmatchcase
from typing import Final

from pydicom.dataset import Dataset

from ronnaplan.errors import InputError
from ronnaplan.node.facts import UID
from ronnaplan.text import printable

LEVELS: Final = {"STUDY": "StudyInstanceUID", "SERIES": "SeriesInstanceUID", "IMAGE": "SOPInstanceUID"}
"""What can be asked for, from the whole to its parts, and what names one."""

DATES: Final = re.compile(r"[0-9]{8}|[0-9]{8}-[0-9]{8}|[0-9]{8}-|-[0-9]{8}")


def are_days(text: str) -> bool:
    """Whether a text is a day of the calendar, YYYYMMDD, or a span of days, which may have no end."""
    if DATES.fullmatch(text) is None:
        return False
    days = [day for day in text.split("-") if day]
    try:
        for day in days:
            datetime.strptime(day, "%Y%m%d")
    except ValueError:
        return False
    return days == sorted(days)


def fitting(archive: str, level: str, keys: Mapping[str, str], found: Sequence[Dataset]) -> list[Dataset]:
    """Return the matches, each once; raises `InputError` for one without a UID, or that does not fit ``keys``."""
    matches: dict[str, Dataset] = {}
    for one in found:
        uid = str(one.get(LEVELS[level]) or "")
        if UID.fullmatch(uid) is None:
            raise InputError(
                f"{archive} answered the {LEVELS[level]} '{printable(uid, 80)}'; expected up to 64 digits and points"
            )
        for keyword, wanted in keys.items():
            told = str(one.get(keyword) or "").strip(" \0")
            if wanted and told and not _fits(keyword, wanted.strip(), told):
                raise InputError(
                    f"{archive} answered with another {keyword} than it was asked for, as if it passed over this key"
                )
        matches.setdefault(uid, one)
    return list(matches.values())


def _fits(keyword: str, wanted: str, told: str) -> bool:
    """Whether a value fits a key (PS3.4, C.2.2.2)."""
    if keyword.endswith("UID"):
        return told in wanted.split("\\")
    if keyword.endswith("Date"):
        first, _, last = wanted.rpartition("-") if "-" in wanted else (wanted, "", wanted)
        return first <= told <= (last or told)
    return any(fnmatchcase(told.casefold(), one.replace("[", "[[]")) for one in wanted.casefold().split("\\"))
