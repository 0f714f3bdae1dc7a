"""A case: the documents that were made of one scan, found once and checked to belong together."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ronnaplan.case.expectation import expectation
from ronnaplan.case.judgement import Judgement
from ronnaplan.case.surroundings import Labels, Rules, Surroundings, Terrain
from ronnaplan.ct import CTVolume, find_series, read_ct
from ronnaplan.ct.identity import ScanIdentity
from ronnaplan.ct.images import is_image_file
from ronnaplan.documents.fiducials import FiducialsDocument, read_fiducials
from ronnaplan.documents.limits import read_limits
from ronnaplan.documents.plan import read_plan
from ronnaplan.documents.registration import RegistrationDocument, read_registration
from ronnaplan.errors import InputError
from ronnaplan.planning import Plan
from ronnaplan.planning.labels import read_label_map
from ronnaplan.planning.uncertainty import Expectation

if TYPE_CHECKING:
    from ronnaplan.documents.placement import PlacementDocument

FIDUCIALS, REGISTRATION, PLAN, LIMITS = "fiducials.json", "registration.json", "plan.json", "limits.json"
PLACEMENT = "placement.json"
"""What the documents are called in a case."""

SCAN = "the scan"

CT_FOLDER = "ct"
"""A scan that lies in the case is in this folder, in a file so called (``ct.zip``), or among the documents."""

AnyPath = str | os.PathLike[str]


@dataclass(frozen=True)
class CaseFiles:
    """Where the documents of a case lie, each None where there is none."""

    plan: Path | None = None
    fiducials: Path | None = None
    registration: Path | None = None
    limits: Path | None = None
    placement: Path | None = None

    @classmethod
    def of_folder(cls, folder: AnyPath) -> CaseFiles:
        """Find the documents in ``folder``; raises `InputError` where there are none."""
        home = Path(folder)
        if not home.is_dir():
            raise InputError(f"{home} is not a folder; give the folder that holds {FIDUCIALS}")
        found = cls(*(_if_there(home / name) for name in (PLAN, FIDUCIALS, REGISTRATION, LIMITS, PLACEMENT)))
        if not (found.plan or found.fiducials or found.registration):
            raise InputError(
                f"{home} holds none of {FIDUCIALS}, {REGISTRATION} and {PLAN}; write one of them there"
            )
        return found

    @property
    def named(self) -> dict[str, Path]:
        """The files that are known, by what they are called in a case."""
        places = (self.fiducials, self.registration, self.plan, self.limits, self.placement)
        named = zip((FIDUCIALS, REGISTRATION, PLAN, LIMITS, PLACEMENT), places, strict=True)
        return {name: path for name, path in named if path is not None}


@dataclass(frozen=True, eq=False)
class Case:
    """The documents of a case and its scan, each None where there is none, and what a person stated.

    ``hashes`` holds (name, SHA-256) of every document as read, and of the scan's voxels. Raises
    `FrameMismatchError` for documents of different frames of reference, `InputError` for markers of other voxels, and
    for documents of other voxels of the same series.
    """

    volume: CTVolume | None = None
    plan: Plan | None = None
    fiducials: FiducialsDocument | None = None
    registration: RegistrationDocument | None = None
    rules: Rules = field(default_factory=Rules)
    no_go: Labels = field(default_factory=dict)
    hashes: tuple[tuple[str, str], ...] = ()
    placement: PlacementDocument | None = None
    files: CaseFiles = field(default_factory=CaseFiles)
    """Where the documents were read, by which a refusal names them."""

    def __post_init__(self) -> None:
        _require_one_scan(self)

    @cached_property
    def expected(self) -> Expectation:
        """What error is to be expected, as registered and as planned."""
        return expectation(self.fiducials, self.registration, self.rules.sigma_ct_mm, self.rules.sigma_ots_mm)

    @cached_property
    def surroundings(self) -> Surroundings:
        """What the case's trajectories are judged against; raises `InputError` without a scan."""
        if self.volume is None:
            raise InputError("the scan is not at hand, so no trajectory can be measured in it; give it with --ct")
        terrain = Terrain(self.volume, self.no_go)
        return Surroundings(terrain, self.rules, self.fiducials, self.registration)

    @cached_property
    def judgements(self) -> tuple[Judgement, ...]:
        """How the plan's trajectories were judged, in its order; raises `InputError` without a scan."""
        return () if self.plan is None else self.surroundings.judge_all(self.plan)


def read_case(
    files: CaseFiles,
    read_volume: Callable[[], CTVolume | None],
    rules: Rules | None = None,
    no_go: Sequence[AnyPath] = (),
) -> Case:
    """Read the documents of a case, then its scan with ``read_volume``: what is wrong with them is told before that.

    ``no_go`` are label maps of the scan (`InputError` without one); limits that lie in the case are added to
    ``rules``. Raises what the documents' readers and `Case` raise.
    """
    stated = with_limits(rules or Rules(), files.limits)
    plan = read_plan(files.plan) if files.plan else None
    fiducials = read_fiducials(files.fiducials) if files.fiducials else None
    registration = read_registration(files.registration) if files.registration else None
    read = [*files.named.values(), *(path for path in map(Path, no_go) if path.is_file())]
    hashes = [(path.name, hashlib.sha256(path.read_bytes()).hexdigest()) for path in read]
    volume = read_volume()
    if volume is not None:
        hashes.append(("voxels of the scan", volume.voxel_sha256))
    return Case(
        volume,
        plan,
        fiducials,
        registration,
        stated,
        read_labels(no_go, volume),
        tuple(hashes),
        placement_at(files.placement) if files.placement else None,
        files,
    )


def placement_at(path: Path) -> PlacementDocument:
    """Read where the robot shall stand; raises `InputError`."""
    from ronnaplan.documents.placement import read_placement  # few cases have one

    return read_placement(path)


def scan_in(folder: AnyPath) -> Path | None:
    """Return where the scan of the case in ``folder`` lies: its ``ct``, or among the documents; None without one.

    What is called ``ct`` is the scan, usable or not: who reads it is told why it is not.
    """
    home = Path(folder)
    files = [one for one in sorted(home.glob(f"{CT_FOLDER}.*")) if is_image_file(one) or one.suffix == ".zip"]
    beside = next((one for one in (home / CT_FOLDER, *files) if one.exists()), None)
    if beside is not None:
        return beside
    try:
        return home if find_series(home, progress=False).usable else None
    except InputError:
        return None


def read_scan(
    folder: AnyPath, ct: AnyPath | None, series_uid: str | None, *, progress: bool = False
) -> CTVolume | None:
    """Read the scan at ``ct``, or else that of the case in ``folder``; None where there is none."""
    path = ct if ct is not None else scan_in(folder)
    return None if path is None else read_ct(path, series_uid, progress=progress)


def with_limits(rules: Rules, path: Path | None) -> Rules:
    """Return ``rules`` with the limits of a file, where there is one."""
    return rules if path is None else replace(rules, limits=read_limits(path))


def _if_there(path: Path) -> Path | None:
    return path if path.is_file() else None


def read_labels(paths: Sequence[AnyPath], volume: CTVolume | None) -> Labels:
    """Return the regions of all label maps by name; raises `InputError` without the scan that they are of."""
    if not paths:
        return {}
    if volume is None:
        raise InputError("a label map was given but not the scan that it belongs to; give the scan with --ct")
    found: dict[str, NDArray[np.bool_]] = {}
    for path in paths:
        for name, mask in read_label_map(path, volume).items():
            # regions of two files may have one name: both are kept
            found[name if name not in found else f"{name} ({os.fspath(path)})"] = mask
    return found


def _require_one_scan(case: Case) -> None:
    """Refuse documents of another scan than the one they are shown on, and markers of other voxels in any series."""
    for one, other in combinations(_identities(case), 2):
        one.require(other)
    stated = case.fiducials.source.voxel_sha256 if case.fiducials else None
    if case.volume is not None and stated not in (None, case.volume.voxel_sha256):
        raise InputError(
            f"{case.files.fiducials or FIDUCIALS} was made from other voxels than those of the scan; give the scan it "
            "was made from"
        )


def _identities(case: Case) -> list[ScanIdentity]:
    """Return which scan the scan is, and that of each document there is, by their files or their names in a case."""
    files = case.files
    found = (
        (SCAN, case.volume),
        (files.fiducials or FIDUCIALS, case.fiducials),
        (files.registration or REGISTRATION, case.registration),
        (files.plan or PLAN, case.plan),
        (files.placement or PLACEMENT, case.placement),
    )
    return [replace(one.identity, name=os.fspath(name)) for name, one in found if one is not None]
