"""From a path to a `CTVolume`: choose the series, check that it can be held, read its slices in parallel.

1. The files below the path are listed (`folders`, `archives`), and the header of each is read (`header`, `slices`).
2. Those of a series become images (`frames`), and these stacks of slices on a `grid` (`stack`); what tells them apart,
   or doubts them, is told (`apart`, `copies`, `derived`, `rounded`). `catalogue` does both, and one series is chosen.
3. The slices' pixels are decoded (`pixels`, `codecs`) into one array of HU, and their scale is doubted (`scale`).

NIfTI, NRRD and MetaImage files are read by `images`.
"""

from __future__ import annotations

import logging
import os
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from ronnaplan.ct.catalogue import Catalogue, Series, find_series
from ronnaplan.ct.files import DamagedError, given_path
from ronnaplan.ct.flags import VolumeFlag, Voxels
from ronnaplan.ct.images import is_image_file, read_image
from ronnaplan.ct.limits import DEFAULT_LIMITS, GIB, Limits
from ronnaplan.ct.no_dicom import is_inner_archive
from ronnaplan.ct.pixels import (
    DoesNotFitError,
    has_bits_above,
    in_int16,
    may_be_int16,
    may_be_unsigned,
    read_slice,
)
from ronnaplan.ct.progress import Progress, advancing
from ronnaplan.ct.scale import AIR_ABOVE_HU, doubts_of_scale, unmeasured_hu
from ronnaplan.ct.scratch import Scratch, one_by_one
from ronnaplan.ct.slices import CT_ONLY, CT_OR_MR, SliceImage
from ronnaplan.ct.volume import CTVolume, SeriesSource
from ronnaplan.errors import InputError
from ronnaplan.threads import cores, in_threads

LOG = logging.getLogger(__name__)

UNREPRESENTABLE_PADDING_HU: Final = -32768.0
"""Stands for padding whose own rescaled value is beyond int16."""
MOST_THREADS: Final = 8
MOST_AT_ONCE: Final = 8
LEAST_RUNS: Final = 4
"""At most so many threads read. Each is handed so many slices at most, and at least so many times some: to hand out
each slice by itself takes as long as to read it."""


def read_ct(
    path: str | os.PathLike[str],
    series_uid: str | None = None,
    *,
    limits: Limits = DEFAULT_LIMITS,
    progress: bool = False,
    scratch: Scratch | None = None,
) -> CTVolume:
    """Read the CT series at ``path``: a DICOM folder, file or zip archive, or a NIfTI, NRRD or MetaImage file.

    ``series_uid`` chooses among several usable series (a key as listed by `find_series`); with
    ``progress`` a long read shows a bar on standard error. Voxels are HU, places LPS mm, each slice exactly
    where its file puts it; those of DICOM lie in ``scratch``, where it has room. Raises `InputError`, which names the
    series to choose from or the reason.
    """
    return _read(path, series_uid, limits, CT_ONLY, progress, scratch)


def read_other_image(path: str | os.PathLike[str], *, progress: bool = False) -> CTVolume:
    """Read what is looked at beside a CT: the same as `read_ct`, and series of MR images too.

    The values of an MR have no unit: nothing is to be measured in it. Raises `InputError`.
    """
    return _read(path, None, DEFAULT_LIMITS, CT_OR_MR, progress)


def _read(
    path: str | os.PathLike[str],
    series_uid: str | None,
    limits: Limits,
    kinds: Mapping[str, frozenset[str]],
    progress: bool,
    scratch: Scratch | None = None,
) -> CTVolume:
    path = given_path(path)
    if is_image_file(path) and path.is_file():
        volume = read_image(path, limits, kinds)
        # Image files do not declare which value stands where nothing was measured.
        return _judged(replace(volume, padding_hu=_mark_unmeasured_corners(volume.voxels_hu, None)))
    found = find_series(path, limits, kinds=kinds, progress=progress)
    return read_found(found, series_uid, limits, progress=progress, scratch=scratch)


def read_found(
    found: Catalogue,
    series_uid: str | None = None,
    limits: Limits = DEFAULT_LIMITS,
    *,
    progress: bool = False,
    scratch: Scratch | None = None,
) -> CTVolume:
    """Read one of the series that were ``found``; raises `InputError` like `read_ct`."""
    series = found.choose(series_uid)
    folder = series.first.blob.name.rpartition("/")[0]
    beside = []
    if any(
        one.is_trouble or (is_inner_archive(one) and one.name.rpartition("/")[0] == folder)
        for one in found.skipped
    ):
        beside.append(VolumeFlag.UNREADABLE_FILES)
    if series_uid is None and found.may_mean_another(series):
        beside.append(VolumeFlag.ONLY_USABLE)
    return read_series(series, limits, beside=beside, progress=progress, scratch=scratch)


def _judged(volume: CTVolume) -> CTVolume:
    """Flag values of a CT that cannot be HU of something in air, and tell the log what was read."""
    is_ct = volume.source.modality == "CT"
    doubts = doubts_of_scale(volume.voxels_hu, volume.padding_hu) if is_ct else ()
    volume = replace(volume, flags=(*volume.flags, *doubts)) if doubts else volume
    LOG.info("read %r of series %s", volume, volume.source.series_instance_uid)
    for flag in volume.flags:
        LOG.info("the scan is to be doubted: %s", flag)
    return volume


def read_series(
    series: Series,
    limits: Limits = DEFAULT_LIMITS,
    *,
    beside: Sequence[VolumeFlag] = (),
    progress: bool = False,
    scratch: Scratch | None = None,
) -> CTVolume:
    """Read a series that `find_series` or `catalogue_of` listed; ``beside`` is what else lies there tells against it.

    Raises `InputError` like `read_ct`.
    """
    stack = series.stack
    if stack is None or stack.grid is None:  # `choose` lets none pass
        raise InputError(f"series {series} is not a usable CT: {', '.join(series.problems)}")
    slices = stack.slices
    padding_hu = _padding_hu(slices)
    voxels = _voxels(slices, padding_hu, limits, progress, scratch)
    padding_hu = _mark_unmeasured_corners(voxels, padding_hu)
    first = slices[0].instance
    source = SeriesSource(
        study_instance_uid=first.study_uid,
        series_instance_uid=first.series_uid,
        frame_of_reference_uid=first.frame_of_reference_uid,
        modality=first.modality,
        description=first.description,
        kernel=slices[0].kernel,
    )
    flags = tuple(dict.fromkeys((*stack.flags, *beside)))
    if first.modality == "CT" and _has_doubtful_sign(slices, voxels, padding_hu, limits):
        flags = (*flags, VolumeFlag.SIGN)
    return _judged(CTVolume(voxels, stack.grid, source, padding_hu, flags))


def _voxels(
    slices: Sequence[SliceImage],
    padding_hu: float | None,
    limits: Limits,
    progress: bool,
    scratch: Scratch | None,
) -> Voxels:
    if all(may_be_int16(image) for image in slices):
        try:
            return _filled(slices, np.dtype(np.int16), padding_hu, limits, progress, scratch)
        except DoesNotFitError:
            pass  # an extended scale: read again, the first array is free by now
    return _filled(slices, np.dtype(np.float32), padding_hu, limits, progress, scratch)


def _filled(
    slices: Sequence[SliceImage],
    dtype: np.dtype[np.int16] | np.dtype[np.float32],
    padding_hu: float | None,
    limits: Limits,
    progress: bool,
    scratch: Scratch | None,
) -> Voxels:
    pixels = slices[0].pixels
    voxels = _allocated((len(slices), pixels.rows, pixels.columns), dtype, limits, scratch)

    def fill(k: int) -> None:
        try:
            read_slice(slices[k], voxels[k], padding_hu, limits)
        except DamagedError as error:
            raise InputError(f"{slices[k].name} cannot be read: {error.with_remedy('copy it again')}") from error

    with warnings.catch_warnings():  # here, because filters belong to the process, not to a thread
        warnings.simplefilter("ignore")  # what pydicom's decoders find odd in a stream that they can read
        in_parallel(fill, len(slices), progress)
    return voxels


def _allocated(
    shape: tuple[int, int, int],
    dtype: np.dtype[np.int16] | np.dtype[np.float32],
    limits: Limits,
    scratch: Scratch | None,
) -> Voxels:
    needed = int(np.prod(shape, dtype=object)) * dtype.itemsize
    if needed > limits.volume_bytes:
        raise InputError(
            f"the volume needs {needed / GIB:.1f} GiB but the limit is {limits.volume_bytes / GIB:.1f} GiB; "
            "choose a smaller series or raise the limit"
        )
    if scratch is not None:
        try:
            return np.ndarray(shape, dtype, scratch.take(needed))
        except OSError as error:
            LOG.warning("the voxels take memory, since the disk has no room for them: %s", error)
    try:
        return np.empty(shape, dtype)
    except MemoryError as error:
        raise InputError(
            f"the volume needs {needed / GIB:.1f} GiB of memory, more than there is; choose a smaller series"
        ) from error


def in_parallel(work: Callable[[int], None], count: int, progress: Progress) -> None:
    """Call ``work`` for 0..count-1 in threads; the first error, or Ctrl-C, drops what has not begun."""
    at_once = max(min(count // (LEAST_RUNS * min(cores(), MOST_THREADS)), MOST_AT_ONCE), 1)
    runs = [range(first, min(first + at_once, count)) for first in range(0, count, at_once)]

    def work_off(run: range) -> range:
        for number in run:
            work(number)
        return run

    done = (number for run in in_threads(work_off, runs, MOST_THREADS) for number in run)
    for _ in advancing(done, count, progress, "reading slices"):
        pass


def _has_doubtful_sign(
    slices: Sequence[SliceImage], voxels: Voxels, padding_hu: float | None, limits: Limits
) -> bool:
    """Whether values far below air's are negative only because the header calls unsigned pixels signed, as it seems."""
    if not all(has_bits_above(image.pixels) for image in slices):
        return False
    for image, plane in zip(slices, one_by_one(voxels), strict=True):
        far_below = plane[plane < AIR_ABOVE_HU]
        if (far_below != padding_hu).any():
            return may_be_unsigned(image, limits)  # as the scanner does it in one slice, it does in all
    return False


def _padding_hu(slices: Sequence[SliceImage]) -> float | None:
    """Return the one value that padding takes: the first declared padding in HU, if int16 holds it."""
    for image in slices:
        if image.pixels.padding is not None:
            value = image.pixels.padding[0] * image.slope + image.intercept
            return value if in_int16(value) and value.is_integer() else UNREPRESENTABLE_PADDING_HU
    return None


def _mark_unmeasured_corners(voxels: Voxels, padding_hu: float | None) -> float | None:
    """Return the value that padding has: ``padding_hu``, where the file declares it, else what its corners show.

    Where they show another than the declared one, ``voxels`` that have it get the declared one.
    """
    value = unmeasured_hu(voxels)
    if value is None or padding_hu is None or value == padding_hu:
        return padding_hu if value is None else value
    for plane in voxels:
        plane[plane == value] = padding_hu
    return padding_hu
