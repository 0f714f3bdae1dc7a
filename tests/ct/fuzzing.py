"""DICOM files with a few bytes changed: each is refused, or read where pydicom says that it lies."""

from __future__ import annotations

import io
import random
import tempfile
import warnings
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pydicom
from pydicom.dataset import Dataset, FileDataset
from pydicom.uid import UID

from ronnaplan.ct import CTVolume, Limits, read_ct
from tests.ct.makers import compress, dataset, enhanced, pattern, save
from tests.fuzz.border import Border, WrongValueError
from tests.fuzz.mutations import ANYWHERE, NUMBERS, Mutation, mutate

TOLERANCE_MM = 0.05
LIMITS = Limits(volume_bytes=64 << 20, file_bytes=64 << 20)
SLICES = 3
SYNTAXES = {
    "explicit": "1.2.840.10008.1.2.1",
    "implicit": "1.2.840.10008.1.2",
    "big endian": "1.2.840.10008.1.2.2",
    "deflated": "1.2.840.10008.1.2.1.99",
    "RLE": "1.2.840.10008.1.2.5",
    "JPEG lossless 57": "1.2.840.10008.1.2.4.57",
    "JPEG lossless 70": "1.2.840.10008.1.2.4.70",
    "JPEG-LS": "1.2.840.10008.1.2.4.80",
    "JPEG 2000": "1.2.840.10008.1.2.4.90",
}
UNCOMPRESSED = ("explicit", "implicit", "big endian", "deflated")
Files = list[bytes]


def seeds() -> dict[str, Files]:
    """Return the valid series that are mutated, each as the bytes of its files."""
    made = {name: [_slice(k, syntax) for k in range(SLICES)] for name, syntax in SYNTAXES.items()}
    made["enhanced"] = [_bytes(enhanced(SLICES))]
    made["zip"] = [_zipped(made["explicit"])]
    return made


def _zipped(files: Files) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for k, content in enumerate(files):
            archive.writestr(f"study/{k}", content)
    return stream.getvalue()


def _slice(k: int, syntax: str) -> bytes:
    compressed = syntax not in [SYNTAXES[name] for name in UNCOMPRESSED]
    made = dataset(k, stored=pattern(k, 64, 64) if compressed else None)
    made.PixelPaddingValue, made.GantryDetectorTilt = -2000, 0
    made.ReferencedImageSequence = [Dataset()]
    made.ReferencedImageSequence[0].ReferencedSOPInstanceUID = "1.2.3"
    if compressed:
        with tempfile.TemporaryDirectory() as folder:
            return _bytes(compress(made, syntax, Path(folder)))
    made.file_meta.TransferSyntaxUID = UID(syntax)
    return _bytes(made)


def _bytes(made: FileDataset) -> bytes:
    stream = io.BytesIO()
    save(made, stream)
    return stream.getvalue()


def _change_text(data: bytearray, chance: random.Random) -> None:
    """Overwrite a geometry or rescale element's text with a number of the same length."""
    for tag in chance.sample(
        (b"\x20\x00\x32\x00", b"\x20\x00\x37\x00", b"\x28\x00\x30\x00", b"\x28\x00\x53\x10"), 4
    ):
        at = data.find(tag)
        if at >= 0:
            start = at + 8 + chance.randrange(12)
            text = chance.choice(NUMBERS)
            data[start : start + len(text)] = text
            return


def _swap_syntax(data: bytearray, chance: random.Random) -> None:
    at = data.find(b"1.2.840.10008.1.2")
    if at >= 0:
        other = chance.choice(list(SYNTAXES.values())).encode()
        data[at : at + len(other)] = other


def _nest(data: bytearray, chance: random.Random) -> None:
    at = data.find(b"\x10\x00\x10\x00")
    if at >= 0:
        opening = b"\x09\x00\x01\x10SQ\0\0\xff\xff\xff\xff\xfe\xff\x00\xe0\xff\xff\xff\xff"
        data[at:at] = opening * chance.choice((1, 5, 40, 2000))


MUTATIONS: Sequence[Mutation] = (*ANYWHERE, _change_text, _swap_syntax, _nest)


def check(volume: CTVolume, path: Path) -> str:
    """Compare a volume with what pydicom reads from the same files; raises `WrongValueError`."""
    places, unreadable = [], 0
    for content in _contents(path):
        try:
            places += _places(content)
        except Exception:
            unreadable += 1
    shape = volume.voxels_hu.shape[1:]
    for k, origin in enumerate(volume.grid.origins_mm):
        last = volume.grid.positions_mm(np.array([k, shape[0] - 1.0, shape[1] - 1.0]))
        if not any(
            size == shape and max(np.abs(first - origin).max(), np.abs(end - last).max()) < TOLERANCE_MM
            for size, first, end in places
        ):
            if unreadable:
                return "read, unverified"
            raise WrongValueError(f"slice {k} at {origin.tolist()} to {last.tolist()}, pydicom has {places}")
    if not (np.diff(volume.grid.slice_positions_mm) > 0).all():
        raise WrongValueError("the slices are not in ascending order")
    return "read"


def _contents(path: Path) -> list[bytes]:
    if path.is_dir():
        return [each.read_bytes() for each in sorted(path.iterdir())]
    if zipfile.is_zipfile(path):
        with zipfile.ZipFile(path) as archive:
            return [content for name in archive.namelist() if (content := _member(archive, name)) is not None]
    return [path.read_bytes()]


def _member(archive: zipfile.ZipFile, name: str) -> bytes | None:
    try:
        return archive.read(name)
    except Exception:
        return None


def _places(content: bytes) -> list[tuple[tuple[int, int], Any, Any]]:
    """Return size, first and last voxel (LPS mm) of each image in a file, by pydicom."""
    made = pydicom.dcmread(io.BytesIO(content), force=True, stop_before_pixels=True)
    if "PerFrameFunctionalGroupsSequence" not in made:
        return [_place(made, made, made, made)]
    shared = made.SharedFunctionalGroupsSequence[0]

    def group(frame: Dataset, keyword: str) -> Dataset:
        return frame[keyword].value[0] if keyword in frame else shared[keyword].value[0]

    return [
        _place(
            made,
            group(frame, "PlanePositionSequence"),
            group(frame, "PlaneOrientationSequence"),
            group(frame, "PixelMeasuresSequence"),
        )
        for frame in made.PerFrameFunctionalGroupsSequence
    ]


def _place(
    image: Dataset, position: Dataset, orientation: Dataset, measures: Dataset
) -> tuple[tuple[int, int], Any, Any]:
    first = np.array(position.ImagePositionPatient, dtype=float)
    directions = np.array(orientation.ImageOrientationPatient, dtype=float)
    row_spacing, column_spacing = (float(value) for value in measures.PixelSpacing)
    end = (
        first
        + directions[3:] * row_spacing * (image.Rows - 1)
        + directions[:3] * column_spacing * (image.Columns - 1)
    )
    return (image.Rows, image.Columns), first, end


class DicomBorder(Border):
    """Series of three slices in each kind of file, with one to three changes."""

    inputs_in_tests = 4000

    def __init__(self) -> None:
        self.series = seeds()

    def check_seeds(self, folder: Path) -> None:
        for given in self.series.items():
            assert self.feed(given, folder) == "read"

    def hostile(self, chance: random.Random) -> tuple[str, Any]:
        kind = chance.choice(list(self.series))
        files = [bytearray(content) for content in self.series[kind]]
        mutate(chance.choice(files), MUTATIONS, chance)
        return kind, (kind, [bytes(content) for content in files])

    def feed(self, given: Any, folder: Path) -> str:
        path = _written(*given, folder)
        volume = read_ct(path, limits=LIMITS)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of pydicom, which reads what is broken
            return check(volume, path)


def _written(kind: str, files: Files, folder: Path) -> Path:
    """Write the files of one input into the emptied ``folder``; return what to read."""
    for old in folder.iterdir():
        old.unlink()
    for k, content in enumerate(files):
        (folder / str(k)).write_bytes(content)
    return next(folder.iterdir()) if kind == "zip" else folder
