"""Folders below a root, the series in one of them, and the case that each belongs to."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ronnaplan.case.folder import CT_FOLDER, FIDUCIALS, PLACEMENT, PLAN, REGISTRATION, placement_at
from ronnaplan.ct.catalogue import Series, find_series
from ronnaplan.ct.files import DiskFile
from ronnaplan.ct.images import is_image_file
from ronnaplan.ct.preview import preview
from ronnaplan.ct.summary import SeriesSummary, summarize, summary_of
from ronnaplan.documents.fiducials import read_fiducials
from ronnaplan.documents.plan import read_plan
from ronnaplan.documents.registration import read_registration
from ronnaplan.errors import InputError, UsageError
from ronnaplan.text import printable

DOCUMENTS: dict[str, Callable[[Path], Any]] = {
    PLAN: read_plan,
    FIDUCIALS: read_fiducials,
    REGISTRATION: read_registration,
    PLACEMENT: placement_at,
}
"""Readers of the documents that are of one scan."""

MOST_LISTED = 1000
"""Entries of a folder that are shown."""


@dataclass(frozen=True, eq=False)
class Found:
    """One series that was found at ``path``, whose documents lie in the folder ``case``.

    ``picture`` (J, I) is None where none can be drawn; ``strangers`` are documents of ``case`` of another scan.
    """

    path: Path
    case: Path
    summary: SeriesSummary
    picture: NDArray[np.uint8] | None
    strangers: tuple[str, ...] = ()

    @property
    def is_known(self) -> bool:
        """Whether it was planned in."""
        return (self.case / PLAN).is_file() and not self.strangers

    @property
    def series(self) -> str | None:
        """What chooses it; None for an image file."""
        return None if is_image_file(self.path) else self.summary.series


class Places:
    """What may be looked at: everything below ``root``, and nothing else."""

    def __init__(self, root: Path) -> None:
        self.root = root.resolve()

    def at(self, below: str) -> Path:
        """Return a place below the root; raises `UsageError` for any other."""
        try:
            place = (self.root / below).resolve()
        except (OSError, ValueError) as error:
            raise UsageError("that is no place below the root; look through the folders shown") from error
        if not place.is_relative_to(self.root) or not os.path.exists(place):  # noqa: PTH110
            raise UsageError(f"{printable(below)} is no place below the root; look through the folders shown")
        return place

    def listed(self, below: str) -> dict[str, Any]:
        """Return what lies in a folder: folders, and files that may hold a scan; hidden ones are left out."""
        folder = self.at(below)
        if not folder.is_dir():
            raise UsageError(f"{printable(below)} is no folder; look for series in it instead")
        try:
            inside = sorted(one for one in folder.iterdir() if not one.name.startswith("."))
        except OSError as error:
            raise UsageError(f"{printable(below)} cannot be opened ({error.strerror}); choose another") from error
        # os.path, unlike pathlib, takes what may not be looked into for what is not there
        folders = {one for one in inside if os.path.isdir(one)}  # noqa: PTH112
        shown = [one for one in inside if one in folders or one.suffix.lower() == ".zip" or is_image_file(one)]
        entries = [
            {
                "name": one.name,
                "at": one.relative_to(self.root).as_posix() if one.is_relative_to(self.root) else "",
                "folder": one in folders,
                "case": any(os.path.isfile(one / name) for name in (PLAN, FIDUCIALS)),  # noqa: PTH113
            }
            for one in shown[:MOST_LISTED]
        ]
        at = "" if folder == self.root else folder.relative_to(self.root).as_posix()
        return {"at": at, "root": self.root.name, "entries": entries, "more": max(0, len(shown) - MOST_LISTED)}


def series_at(path: Path, root: Path, called: str = "") -> list[Found]:
    """Return the series at a path, those that can be used first; raises `InputError` where there are none.

    The case of each lies below ``root``, beside its files or further up. That there are none is told of what the page
    calls the place.
    """
    if path.is_file() and is_image_file(path):
        strangers = _strangers(_frames_in(path.parent), None)
        return [Found(path, path.parent, summarize(path)[0][0], None, strangers)]
    catalogue = find_series(path)
    catalogue.require_series(called)
    ordered = sorted(catalogue.series, key=lambda one: not one.is_usable)
    planned = cache(_frames_in)
    found = []
    for one in ordered:
        case = _case_of(path, one, root, planned)
        strangers = _strangers(planned(case), one.first.frame_of_reference_uid)
        found.append(Found(path, case, summary_of(one), preview(one), strangers))
    return found


def rows(found: list[Found]) -> list[dict[str, Any]]:
    """Return series as the page lists them, without the patient."""
    told = [
        asdict(one.summary)
        | {"drawn": one.picture is not None, "known": one.is_known, "strangers": ", ".join(one.strangers)}
        for one in found
    ]
    for one in told:
        del one["patient_name"]
    return told


def _case_of(path: Path, series: Series, root: Path, planned: Callable[[Path], dict[str, str | None]]) -> Path:
    """Return the folder of a scan's documents, wherever below ``root`` the scan was looked for.

    It is the nearest about the files that holds documents of the scan's frame of reference, as ``planned`` tells. Where
    none does it is the folder of the files, and the one above of an archive or of ``ct``: one for each patient.
    """
    if path.is_file():
        return path.parent
    images = [] if series.stack is None else series.stack.slices
    files = {one.instance.blob for one in images}
    folders = {os.path.dirname(one.path) for one in files if isinstance(one, DiskFile)}  # noqa: PTH120
    scan = Path(os.path.commonpath(folders)) if folders else path
    beside = scan.parent if scan.name == CT_FOLDER else scan
    above = [one for one in (beside, *beside.parents) if one.is_relative_to(root)]
    uid = series.first.frame_of_reference_uid
    return next((one for one in above if uid is not None and uid in planned(one).values()), beside)


def _strangers(frames: dict[str, str | None], uid: str | None) -> tuple[str, ...]:
    """Return the names of documents, with the ``frames`` they are of, that are not of the frame of a scan."""
    return tuple(name for name, known in frames.items() if known != uid)


def _frames_in(folder: Path) -> dict[str, str | None]:
    """Return the UIDs of the frames of reference that the documents in a folder are of, by their names."""
    found: dict[str, str | None] = {}
    for name, read in DOCUMENTS.items():
        with contextlib.suppress(InputError):  # none, or none that can be read: that is told when it is opened
            found[name] = read(folder / name).identity.frame.uid
    return found
