"""A case: the folder that holds what was made of one scan, checked to belong together."""

from __future__ import annotations

import hashlib
import os
from dataclasses import dataclass
from pathlib import Path

from ronnaplan.ct import CTVolume, find_series, read_ct
from ronnaplan.documents.fiducials import FiducialsDocument, read_fiducials
from ronnaplan.documents.plan import read_plan
from ronnaplan.documents.registration import RegistrationDocument, read_registration
from ronnaplan.errors import FrameMismatchError, InputError
from ronnaplan.planning import Plan

FIDUCIALS, REGISTRATION, PLAN = "fiducials.json", "registration.json", "plan.json"
"""What the documents are called in a case."""

SCAN = "the scan"

CT_FOLDER = "ct"
"""A scan that lies in the case is in this folder, or among the documents."""


@dataclass(frozen=True, eq=False)
class Case:
    """The documents of a case and its scan, each None where there is none.

    ``hashes`` holds (name, SHA-256) of every document as read, and of the scan's voxels.
    """

    volume: CTVolume | None
    fiducials: FiducialsDocument | None
    registration: RegistrationDocument | None
    plan: Plan | None
    hashes: tuple[tuple[str, str], ...]


def read_case(
    folder: str | os.PathLike[str],
    ct: str | os.PathLike[str] | None = None,
    series_uid: str | None = None,
    *,
    progress: bool = False,
) -> Case:
    """Read the case in ``folder``; its scan is at ``ct``, or in the folder itself.

    Raises `InputError` for a folder without documents or a scan of other voxels, `FrameMismatchError` for
    documents of different frames of reference.
    """
    home = Path(folder)
    if not home.is_dir():
        raise InputError(f"{home} is not a folder; give the folder that holds {FIDUCIALS}")
    present = [home / name for name in (FIDUCIALS, REGISTRATION, PLAN) if (home / name).is_file()]
    if not present:
        raise InputError(f"{home} holds none of {FIDUCIALS}, {REGISTRATION} and {PLAN}; write one of them there")
    volume = _scan(home, ct, series_uid, progress)
    hashes = [(path.name, hashlib.sha256(path.read_bytes()).hexdigest()) for path in present]
    if volume is not None:
        hashes.append(("voxels of the scan", volume.voxel_sha256))
    case = Case(
        volume,
        read_fiducials(home / FIDUCIALS) if home / FIDUCIALS in present else None,
        read_registration(home / REGISTRATION) if home / REGISTRATION in present else None,
        read_plan(home / PLAN) if home / PLAN in present else None,
        tuple(hashes),
    )
    _check(case)
    return case


def scan_in(folder: str | os.PathLike[str]) -> Path | None:
    """Return where the scan of the case in ``folder`` lies: its ``ct``, or among the documents; None without one."""
    home = Path(folder)
    beside = home / CT_FOLDER if (home / CT_FOLDER).exists() else home
    try:
        return beside if find_series(beside, progress=False).usable else None
    except InputError:
        return None


def _scan(
    home: Path, ct: str | os.PathLike[str] | None, series_uid: str | None, progress: bool
) -> CTVolume | None:
    path = ct if ct is not None else scan_in(home)
    return None if path is None else read_ct(path, series_uid, progress=progress)


def _check(case: Case) -> None:
    """Refuse documents of another scan than the one they are shown on."""
    frames = {
        SCAN: case.volume.frame if case.volume else None,
        FIDUCIALS: case.fiducials.points.frame if case.fiducials else None,
        REGISTRATION: case.registration.ct_frame if case.registration else None,
        PLAN: case.plan.frame if case.plan else None,
    }
    known = [(name, frame) for name, frame in frames.items() if frame is not None]
    for name, frame in known[1:]:
        if frame != known[0][1]:
            raise FrameMismatchError(
                f"{name} is in frame {frame} but {known[0][0]} in {known[0][1]}; a case holds one examination"
            )
    stated = case.fiducials.source.voxel_sha256 if case.fiducials else None
    if case.volume is not None and stated not in (None, case.volume.voxel_sha256):
        raise InputError(
            f"{FIDUCIALS} was made from other voxels than those of the scan; give the scan it was made from"
        )
