"""DICOM files with a few bytes changed: each is refused, or read where pydicom says that it lies."""

from __future__ import annotations

import io
import random
import struct
import tempfile
import warnings
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
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
PLAIN = [SYNTAXES[name] for name in UNCOMPRESSED]
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
    compressed = syntax not in PLAIN
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


US_TAGS = [(0x28, element) for element in (2, 0x10, 0x11, 0x100, 0x101, 0x102, 0x103, 0x120)]
DS_TAGS = [(0x20, 0x32), (0x20, 0x37), (0x28, 0x30), (0x28, 0x1052), (0x28, 0x1053)]
TEXTS = (b"1\\2", b"0\\0\\0", b"1\\0\\0\\0\\1\\0", b"0.5", b"-1024\\0", b"2", b"-1000", b"nan", b"")


def _element(data: bytearray, group: int, element: int) -> tuple[int, int, int] | None:
    """Return start, start of the value and end of a short element in explicit or implicit little endian."""
    start = data.find(struct.pack("<HH", group, element))
    if start < 0 or start + 8 > len(data):
        return None
    explicit = data[start + 4 : start + 6].isalpha()
    length = struct.unpack_from("<H", data, start + (6 if explicit else 4))[0]
    return start, start + 8, start + 8 + length


def _change_number(data: bytearray, chance: random.Random) -> None:
    """Give a 2-byte number another value."""
    found = _element(data, *chance.choice(US_TAGS))
    if found is not None and found[2] == found[1] + 2:
        struct.pack_into("<H", data, found[1], chance.choice((0, 1, 2, 3, 8, 11, 12, 15, 16, 64, 0xFFFF)))


def _change_decimals(data: bytearray, chance: random.Random) -> None:
    """Give a text of decimals another value, of any length."""
    found = _element(data, *chance.choice(DS_TAGS))
    if found is not None:
        start, value, end = found
        text = chance.choice(TEXTS)
        text += b" " * (len(text) % 2)
        struct.pack_into("<H", data, start + (6 if data[start + 4 : start + 6].isalpha() else 4), len(text))
        data[value:end] = text


def _drop_element(data: bytearray, chance: random.Random) -> None:
    """Leave out an element."""
    found = _element(data, *chance.choice(US_TAGS + DS_TAGS))
    if found is not None:
        del data[found[0] : found[2]]


def _repeat_element(data: bytearray, chance: random.Random) -> None:
    """Write an element twice, the second time perhaps with another last byte."""
    found = _element(data, *chance.choice(US_TAGS + DS_TAGS))
    if found is not None:
        again = data[found[0] : found[2]]
        again[-1] ^= chance.choice((0, 1, 4))
        data[found[0] : found[0]] = again


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


MUTATIONS: Sequence[Mutation] = (
    *ANYWHERE,
    *(_change_text, _swap_syntax, _nest),
    *(_change_number, _change_decimals, _drop_element, _repeat_element),
)


def check(volume: CTVolume, path: Path) -> str:
    """Compare a volume with what pydicom reads from the same files; raises `WrongValueError`."""
    images, unreadable = [], 0
    for content in _contents(path):
        try:
            images += _images(content)
        except Exception:
            unreadable += 1
    for k, values in enumerate(volume.voxels_hu):
        at_its_place = [image for image in images if _is_at(volume, k, image)]
        if not at_its_place and not unreadable:
            raise WrongValueError(f"slice {k} at {volume.grid.origins_mm[k].tolist()}, pydicom has {images}")
        if not any(image.values is None or _agree(values, image.values, volume) for image in at_its_place):
            if unreadable:
                return "read, unverified"
            raise WrongValueError(f"slice {k} holds other values than pydicom finds")
    if not (np.diff(volume.grid.slice_positions_mm) > 0).all():
        raise WrongValueError("the slices are not in ascending order")
    return "read"


@dataclass(frozen=True)
class _Image:
    """One image as pydicom reads it: first and last voxel (LPS mm), and HU (J, I) if it is not compressed."""

    size: tuple[int, int]
    first: Any
    last: Any
    values: Any


def _is_at(volume: CTVolume, k: int, image: _Image) -> bool:
    rows, columns = volume.voxels_hu.shape[1:]
    last = volume.grid.positions_mm(np.array([k, rows - 1.0, columns - 1.0]))
    apart = max(np.abs(image.first - volume.grid.origins_mm[k]).max(), np.abs(image.last - last).max())
    return image.size == (rows, columns) and bool(apart < TOLERANCE_MM)


def _agree(ours: Any, theirs: Any, volume: CTVolume) -> bool:
    if ours.shape != theirs.shape:
        return False
    measured = np.ones(ours.shape, bool) if volume.padding_hu is None else ours != volume.padding_hu
    return bool(np.allclose(ours[measured], theirs[measured], rtol=1e-6, atol=1e-3))


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


@lru_cache(maxsize=256)  # most files of an input are as they were
def _images(content: bytes) -> list[_Image]:
    made = pydicom.dcmread(io.BytesIO(content), force=True)
    stored = made.pixel_array if made.file_meta.TransferSyntaxUID in PLAIN else None
    if "PerFrameFunctionalGroupsSequence" not in made:
        return [_image(made, made, made, made, made, stored)]
    shared = made.SharedFunctionalGroupsSequence[0]

    def group(frame: Dataset, keyword: str) -> Dataset:
        found: Dataset = frame[keyword].value[0] if keyword in frame else shared[keyword].value[0]
        return found

    return [
        _image(
            made,
            group(frame, "PlanePositionSequence"),
            group(frame, "PlaneOrientationSequence"),
            group(frame, "PixelMeasuresSequence"),
            group(frame, "PixelValueTransformationSequence"),
            None if stored is None else stored[k],
        )
        for k, frame in enumerate(made.PerFrameFunctionalGroupsSequence)
    ]


def _image(
    image: Dataset, position: Dataset, orientation: Dataset, measures: Dataset, scale: Dataset, stored: Any
) -> _Image:
    first = np.array(position.ImagePositionPatient, dtype=float)
    directions = np.array(orientation.ImageOrientationPatient, dtype=float)
    row_spacing, column_spacing = (float(value) for value in measures.PixelSpacing)
    steps = directions[3:] * row_spacing * (image.Rows - 1), directions[:3] * column_spacing * (image.Columns - 1)
    values = None if stored is None else stored * float(scale.RescaleSlope) + float(scale.RescaleIntercept)
    return _Image((image.Rows, image.Columns), first, first + sum(steps), values)


class DicomBorder(Border):
    """Series of three slices in each kind of file, with one to three changes."""

    inputs_in_tests = 1500

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
        kind, files = given
        path = _written(kind, files, folder)
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
