"""The scan that one received series is. Why it is none is told without its folder and UID, which stand beside it."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from ronnaplan.ct import find_series, read_ct
from ronnaplan.errors import InputError

if TYPE_CHECKING:
    from ronnaplan.ct import CTVolume
    from ronnaplan.ct.scratch import Scratch


def read_received(folder: Path, scratch: Scratch) -> CTVolume:
    """Return the scan whose files lie in ``folder``; raises `InputError` where they are none, or several."""
    try:
        return read_ct(folder, scratch=scratch)
    except InputError as error:
        reason = _why_not(folder) or str(error)
        raise InputError(reason.replace(f"{folder}{os.sep}", "")) from error


def _why_not(folder: Path) -> str:
    """Return what keeps the files in ``folder`` from being one scan; empty where each of them is a part of one."""
    found = find_series(folder)
    if len(found.usable) > 1:
        apart = " and ".join(found.usable[0].apart)
        return f"it holds {len(found.usable)} scans of different {apart}; send each as a series of its own"
    if found.usable:
        return ""
    return "; ".join(dict.fromkeys(problem for series in found.series for problem in series.problems))
