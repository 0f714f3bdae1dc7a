"""The scan that one received series is, and whose. Its folder and UID, which stand beside, are told in no reason."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from ronnaplan.ct.catalogue import find_series
from ronnaplan.ct.reader import read_found
from ronnaplan.errors import InputError

if TYPE_CHECKING:
    from pydicom import Dataset

    from ronnaplan.ct import CTVolume
    from ronnaplan.ct.catalogue import Catalogue
    from ronnaplan.ct.scratch import Scratch
    from ronnaplan.documents.fiducials import Source


def read_received(folder: Path, scratch: Scratch) -> CTVolume:
    """Return the scan whose files lie in ``folder``; raises `InputError` where they are none, or several."""
    with _told_without(folder):
        found = find_series(folder)
        reason = _why_not(found)
        if reason:
            raise InputError(reason)
        return read_found(found, scratch=scratch)


def patient_received(folder: Path, source: Source, tell: Callable[[str], None]) -> Dataset:
    """Return what `patient_of_scan` does of the scan whose files lie in ``folder``."""
    from ronnaplan.documents.patient import patient_of_scan

    with _told_without(folder):
        return patient_of_scan(folder, source, tell)


@contextmanager
def _told_without(folder: Path) -> Iterator[None]:
    """Leave a ``folder`` out of what is said of the files in it."""
    try:
        yield
    except InputError as error:
        raise InputError(str(error).replace(f"{folder}{os.sep}", "")) from error


def _why_not(found: Catalogue) -> str:
    """Return what keeps the files that were ``found`` from being one scan; empty where there is one to be read."""
    if len(found.usable) > 1:
        apart = " and ".join(found.usable[0].apart)
        return f"it holds {len(found.usable)} scans of different {apart}; send each as a series of its own"
    if found.usable:
        return ""
    return "; ".join(dict.fromkeys(problem for series in found.series for problem in series.problems))
