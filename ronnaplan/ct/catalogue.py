"""From a folder, a file or a zip archive to the series in it: what each is, and whether it is a usable CT.

Reads headers only, each file once.
"""

from __future__ import annotations

import os
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence, Set
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from ronnaplan.ct import tags
from ronnaplan.ct.apart import what_it_has
from ronnaplan.ct.copies import CUT_COPY, without_cut_copies
from ronnaplan.ct.file_set import INDEX_NAMES, is_index, listed_images
from ronnaplan.ct.files import Blob, DamagedError, NotDicomError, Skipped, given_path
from ronnaplan.ct.folders import blobs_below
from ronnaplan.ct.frames import images_of, lacks_a_file, why_not_scan
from ronnaplan.ct.header import read_header
from ronnaplan.ct.limits import DEFAULT_LIMITS, Limits
from ronnaplan.ct.no_dicom import is_failed_copy, why_no_dicom
from ronnaplan.ct.progress import advancing
from ronnaplan.ct.slices import CT_ONLY, CT_OR_MR, Instance, SliceImage, instance_from_header
from ronnaplan.ct.stack import LEAST_SLICES, Stack, stacks_of
from ronnaplan.ct.volume import VolumeFlag
from ronnaplan.errors import InputError
from ronnaplan.text import printable

DICOMDIR_CLASS: Final = "1.2.840.10008.1.3.10"
_SCANS: Final = frozenset[str]().union(*CT_OR_MR.values())
MOST_LISTED, MOST_REASONS = 10, 5
"""A message names so many series, or says of so many why they cannot be used."""


class SeveralSeriesError(InputError):
    """There are several usable series, and none was chosen."""


@dataclass(frozen=True)
class Series:
    """One series, or one part of a series that holds several stacks.

    ``key`` chooses it: the SeriesInstanceUID, with ``#2`` and so on where a series falls into parts.
    ``problems`` say why it cannot be read; empty for a usable CT. ``cut`` tells of files of it that were passed over,
    as they are the beginnings of others.
    """

    key: str
    first: Instance
    file_count: int
    stack: Stack | None
    problems: tuple[str, ...]
    cut: tuple[str, ...] = ()

    @property
    def is_usable(self) -> bool:
        """Whether it can be read as a CT volume."""
        return not self.problems

    @property
    def notes(self) -> tuple[str, ...]:
        """Reasons to doubt a usable series."""
        return (*self.stack.flags, *self.cut) if self.stack is not None else ()

    @property
    def apart(self) -> tuple[str, ...]:
        """What the parts of its series differ in; empty where it is the whole."""
        return self.stack.apart if self.stack is not None else ()

    @property
    def part(self) -> tuple[str, ...]:
        """What tells it from the other parts of its series, such as "kernel H30"; empty where no such value does."""
        return what_it_has(self.stack.slices[0], self.apart) if self.stack is not None else ()

    @property
    def image_count(self) -> int:
        """Number of slices, or of files where they are not slices of a CT."""
        return len(self.stack.slices) if self.stack is not None else self.file_count

    @property
    def kernel(self) -> str:
        """The convolution kernel of the first slice."""
        return self.stack.slices[0].kernel if self.stack is not None else ""

    def __str__(self) -> str:
        mixed = (f"one of several {' and '.join(self.apart)}",) if self.apart else ()
        told = ", ".join((f"{self.image_count} slices", f"'{self.first.description}'", *(self.part or mixed)))
        return f"{self.key} ({told})"


@dataclass(frozen=True)
class Catalogue:
    """The series below ``path`` and the files that belong to none."""

    path: Path
    series: tuple[Series, ...]
    skipped: tuple[Skipped, ...]

    @property
    def usable(self) -> tuple[Series, ...]:
        """The series that can be read as a CT volume."""
        return tuple(series for series in self.series if series.is_usable)

    def may_mean_another(self, chosen: Series) -> bool:
        """Whether there is a scan that cannot be used and that has half as many slices as the ``chosen`` one, or more.

        Fewer are those that a scanner watches for contrast to come, and the like.
        """
        refused = (one for one in self.series if not one.is_usable and why_not_scan(one.first, CT_ONLY) is None)
        return any(2 * _declared_images(one) >= chosen.image_count for one in refused)

    def choose(self, series_uid: str | None = None) -> Series:
        """Return the wanted series, or the only usable one; raises `InputError` that lists the choice."""
        shown = printable(self.path)
        self.require_series()
        if series_uid is not None:
            return self._named(series_uid)
        if not self.usable:
            raise InputError(f"{shown} holds no usable CT series {self._why_none()}")
        if len(self.usable) > 1:
            raise SeveralSeriesError(
                f"{shown} holds {len(self.usable)} usable series; choose one by its UID (--series on the command "
                f"line): {_listed(self.usable)}"
            )
        return self.usable[0]

    def _why_none(self) -> str:
        """Say why no series can be used: by its own reasons, or as each file was given a series of its own."""
        alone = [one for one in self.series if one.stack is not None and one.image_count == one.file_count == 1]
        if len(alone) >= LEAST_SLICES:
            return (
                f"but {len(alone)} images that are each a series of its own, as of a program that gave each file "
                "another SeriesInstanceUID; export or anonymize the scan again so that its files share one"
            )
        reasons = "; ".join(f"{one.key}: {', '.join(one.problems)}" for one in self.series[:MOST_REASONS])
        return f"({reasons}); see `ronnaplan series`"

    def _named(self, series_uid: str) -> Series:
        named = [one for one in self.series if series_uid in (one.key, one.first.series_uid)]
        usable = [one for one in named if one.is_usable]
        if not named:
            raise InputError(
                f"{printable(self.path)} holds no series {printable(series_uid)}; there is {_listed(self.series)}"
            )
        if not usable:
            raise InputError(f"series {named[0]} is not a usable CT: {', '.join(named[0].problems)}")
        if len(usable) > 1:
            raise InputError(
                f"series {printable(series_uid)} holds {len(usable)} stacks; choose one: {_listed(usable)}"
            )
        return usable[0]

    def require_series(self, called: str = "") -> None:
        """Raise `InputError` if there is no series of any kind; ``called`` is told in the path's place."""
        if not self.series:
            raise InputError(
                f"{called or printable(self.path)} holds no DICOM series{self._why_empty()}; give a folder of CT images"
            )

    def _why_empty(self) -> str:
        if not self.skipped:
            return ""
        first = self.skipped[0]
        name = first.name.removeprefix(f"{self.path}{os.sep}")
        if len(self.skipped) == 1:
            return f" ({first.reason})" if self.path.is_file() else f" ({name}: {first.reason})"
        return f" ({len(self.skipped)} other files, such as {name}: {first.reason})"


def _listed(series: Iterable[Series]) -> str:
    shown = [str(one) for one in series]
    more = f" and {len(shown) - MOST_LISTED} more" if len(shown) > MOST_LISTED else ""
    return ", ".join(shown[:MOST_LISTED]) + more


def find_series(
    path: str | Path,
    limits: Limits = DEFAULT_LIMITS,
    *,
    kinds: Mapping[str, frozenset[str]] = CT_ONLY,
    progress: bool = False,
) -> Catalogue:
    """List the series in a folder (with all folders below), a zip archive, a DICOMDIR's folder or a single file.

    ``kinds`` says of what modality, and of which classes, a series is usable.
    Raises `InputError` if there is no such path or it is beyond the limits.
    """
    path = given_path(path)
    skipped: list[Skipped] = []
    blobs = list(blobs_below(folder_of_index(path), limits, skipped))
    return catalogue_of(path, blobs, limits, skipped, kinds=kinds, progress=progress)


def catalogue_of(
    path: Path,
    blobs: Iterable[Blob],
    limits: Limits,
    skipped: Sequence[Skipped] = (),
    *,
    kinds: Mapping[str, frozenset[str]] = CT_ONLY,
    progress: bool = False,
) -> Catalogue:
    """List the series in ``blobs``, which lie below ``path``; ``skipped`` are files that were left out before."""
    skipped = list(skipped)
    members: dict[str | None, list[Instance]] = defaultdict(list)
    listed: dict[str, set[str]] = defaultdict(set)
    ordered = sorted(blobs, key=lambda blob: blob.name)
    for blob in advancing(ordered, len(ordered), progress, "reading headers"):
        instance = read_instance(blob, limits, skipped)
        if instance is not None:
            members[instance.series_uid].append(instance)
        elif is_index(blob):
            for uid, images in listed_images(blob, limits).items():
                listed[uid] |= images
    series = [
        part for uid, found in members.items() for part in _parts(found, kinds, listed.get(uid or "", set()))
    ]
    return Catalogue(path, tuple(series), tuple(skipped))


def folder_of_index(path: Path) -> Path:
    """Return the folder that a DICOMDIR file indexes: the files are found by walking, not by the index."""
    return path.parent if path.name.upper() in INDEX_NAMES and path.is_file() else path


def read_instance(blob: Blob, limits: Limits, skipped: list[Skipped]) -> Instance | None:
    """Return the facts of one file, or note why it was left out."""
    try:
        instance = instance_from_header(blob, read_header(blob, limits))
    except NotDicomError as error:
        skipped.append(Skipped(blob.name, why_no_dicom(blob) or str(error), is_failed_copy(blob)))
    except DamagedError as error:
        skipped.append(Skipped(blob.name, error.with_remedy("copy it again"), True))
    else:
        if instance.series_uid is not None and instance.sop_class != DICOMDIR_CLASS:
            return instance
        if tags.FILE_SET_ID in instance.elements or instance.sop_class not in _SCANS:
            skipped.append(Skipped(blob.name, "it is an index or belongs to no series", False))
        else:
            skipped.append(Skipped(blob.name, "it names no series, as if it were cut; copy it again", True))
    return None


def _parts(instances: list[Instance], kinds: Mapping[str, frozenset[str]], listed: Set[str]) -> list[Series]:
    """Return one series, or one for each stack in it; files that cannot be part of a stack form an entry too.

    ``listed`` are the UIDs of the images that an index beside them lists.
    """
    uid = instances[0].series_uid or ""
    images: list[SliceImage] = []
    outside: dict[str, list[Instance]] = defaultdict(list)
    damaged: dict[str, list[Instance]] = defaultdict(list)
    for instance in instances:
        reason = why_not_scan(instance, kinds)
        if reason is not None:
            outside[reason].append(instance)
            continue
        try:
            images.extend(images_of(instance))
        except DamagedError as error:
            damaged[error.with_remedy("export it again")].append(instance)
    cut = without_cut_copies(damaged, [image.instance for image in images])
    broken = tuple(f"{_counted(files, len(instances))}: {reason}" for reason, files in damaged.items())
    told = (f"{_counted(cut, len(instances))}: {CUT_COPY}",) if cut else ()
    stacks = stacks_of(images)
    if cut:
        stacks = [stack.flagged(VolumeFlag.UNREADABLE_FILES) for stack in stacks]
    if any(instance.pixels is not None for files in outside.values() for instance in files):
        stacks = [stack.flagged(VolumeFlag.IMAGES_LEFT_OUT) for stack in stacks]
    if lacks_a_file(instances) or listed - {one.sop_uid for one in instances}:
        stacks = [stack.flagged(VolumeFlag.MISSING_SLICE) for stack in stacks]
    found: list[tuple[Instance, int, Stack | None, tuple[str, ...]]] = [
        (stack.slices[0].instance, len(stack.slices), stack, (*_problem(stack), *broken)) for stack in stacks
    ]
    if broken and not found:
        found.append((next(iter(damaged.values()))[0], len(instances), None, broken))
    found += [(files[0], len(files), None, (reason,)) for reason, files in outside.items()]
    return [
        Series(uid if len(found) == 1 else f"{uid}#{number}", first, count, stack, problems, told)
        for number, (first, count, stack, problems) in enumerate(found, start=1)
    ]


def _counted(files: list[Instance], total: int) -> str:
    """Say how many of a series' files are meant, and, unless it is all, name the first: it may be copied again."""
    counted = f"{len(files)} of {total} files"
    if len(files) == total:
        return counted
    return f"{counted} ({'' if len(files) == 1 else 'the first is '}{files[0].blob.name})"


def _declared_images(series: Series) -> int:
    """Return how many images a series has, or would have if its files were not damaged."""
    pixels = series.first.pixels if series.stack is None else None
    return series.image_count * (1 if pixels is None else pixels.frames)


def _problem(stack: Stack) -> tuple[str, ...]:
    return () if stack.problem is None else (stack.problem,)
