"""The error to expect of a registration at every voxel of its scan, as an image file."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ronnaplan.ct import CTVolume, read_ct
from ronnaplan.ct.catalogue import find_series
from ronnaplan.ct.images import is_image_file
from ronnaplan.ct.reader import read_series
from ronnaplan.documents.fiducials import Source
from ronnaplan.documents.registration import RegistrationDocument
from ronnaplan.errors import UnwrittenError, UsageError

if TYPE_CHECKING:
    import SimpleITK as sitk

SUFFIXES = (".nii.gz", ".nii", ".nrrd", ".mha")
"""Kinds of image that are one file."""


def tre_image(document: RegistrationDocument, ct: str | os.PathLike[str] | None, name: str) -> bytes:
    """Return an image file of that ``name``: the RMS error in mm (float32) on the grid of the scan ``ct``.

    Raises `UsageError` without a scan or for another kind of file, and what `RegistrationDocument.tre_map` raises.
    """
    suffix = next((one for one in SUFFIXES if name.lower().endswith(one)), None)
    if suffix is None:
        raise UsageError(f"the map's file is '{name}'; expected a name that ends in {', '.join(SUFFIXES)}")
    if ct is None:
        raise UsageError("no scan was given for the map to lie on; name it with --ct")
    image = document.tre_map(_scan(ct, document.source)).to_sitk()
    with tempfile.TemporaryDirectory() as folder:
        made = Path(folder) / f"map{suffix}"
        _write_whole(image, made)
        return made.read_bytes()


def _write_whole(image: sitk.Image, path: Path) -> None:
    """Write an image file and read it back; raises `UnwrittenError` where it does not hold what was written.

    Of a disk that takes no more SimpleITK tells nothing when it writes NIfTI, nor when it reads what was cut; and where
    a program that it runs in has set a locale of decimal commas, as Qt does, it writes them into NRRD.
    """
    import SimpleITK as sitk

    try:
        sitk.WriteImage(image, str(path), useCompression=True)
        written = sitk.ReadImage(str(path))
        whole = np.array_equal(sitk.GetArrayViewFromImage(written), sitk.GetArrayViewFromImage(image))
    except RuntimeError as error:
        raise _unwritten(path) from error
    if not whole:
        raise _unwritten(path)


def _unwritten(path: Path) -> UnwrittenError:
    return UnwrittenError(
        f"{path} cannot be read back as it was written; make room on its disk, name another for temporary files by "
        "TMPDIR, or choose another kind of image"
    )


def _scan(path: str | os.PathLike[str], source: Source) -> CTVolume:
    """Return the scan at a path; of several series, or stacks of one, the one whose markers were registered."""
    if is_image_file(Path(path)):
        return read_ct(path, progress=True)
    found = find_series(os.fspath(path), progress=True)
    if len(found.usable) < 2:
        return read_series(found.choose(), progress=True)
    uid = source.series_instance_uid
    stacks = [one for one in found.usable if one.first.series_uid == uid]
    volumes = (read_series(one, progress=True) for one in stacks if len(stacks) > 1)
    same = (one for one in volumes if one.voxel_sha256 == source.voxel_sha256)
    return next(same, None) or read_series(found.choose(uid), progress=True)
