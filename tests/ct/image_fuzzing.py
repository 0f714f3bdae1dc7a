"""NIfTI, NRRD and MetaImage files with a few changes: each is refused, or read as its own header says.

The header is read here a second time, by the letter of its format and as short as these seeds allow, down to the
value of every voxel.
"""

from __future__ import annotations

import gzip
import random
import re
import struct
import tempfile
import zlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import SimpleITK

from ronnaplan.ct import CTVolume, read_ct
from tests.ct.fuzzing import LIMITS, SLICES, TOLERANCE_MM
from tests.ct.makers import pattern
from tests.fuzz.border import Border, WrongValueError
from tests.fuzz.mutations import ANYWHERE, NUMBERS, Mutation, mutate

RAS_TO_LPS = np.array([[-1.0], [-1.0], [1.0]])
FLOATS = (0.0, -1.0, 0.5, 7.0, 1e-30, 1e30, -1e30, 3e38, float("nan"), float("inf"), float("-inf"))
LINES = {
    ".nrrd": (
        *(b'space units: "cm" "cm" "cm"', b'space units: "mm" "mm" "mm"', b"spacings: 1 1 1", b"space: RAS"),
        *(b"byte skip: 4", b"byte skip: -1", b"line skip: 1", b"old max: 7", b"modality:=MR", b"data file: other"),
        *(b"endian: big", b"type: ushort", b"sizes: 10 8 3", b"dimension: 2", b"sample units: Gy", b"# words"),
    ),
    ".mha": (
        *(b"DistanceUnits = cm", b"DistanceUnits = mm", b"Modality = MET_MOD_MR", b"Position = 1 2 3"),
        *(b"Orientation = 1 0 0 0 1 0 0 0 1", b"HeaderSize = 4", b"HeaderSize = -1", b"CompressedData = True"),
        *(b"ElementToIntensityFunctionSlope = 2", b"ElementToIntensityFunctionOffset = -1000", b"Any = thing"),
        *(b"BinaryDataByteOrderMSB = True", b"ElementByteOrderMSB = True", b"NDims = 4", b"BinaryData = False"),
    ),
}
"""Lines that a writer might add to a header."""


def change_number(data: bytearray, chance: random.Random) -> None:
    """Replace a whole number of a text header by any other text."""
    end = min(len(data), 1400)
    found = list(re.finditer(rb"-?\d[\d.e+-]*", bytes(data[:end])))
    if found:
        match = chance.choice(found)
        data[match.start() : match.end()] = chance.choice(NUMBERS)


def set_float(data: bytearray, chance: random.Random) -> None:
    """Write a remarkable float at one of the places where NIfTI-1 keeps its floats."""
    at = chance.choice([*range(76, 124, 4), *range(256, 328, 4)])
    if at + 4 <= len(data):
        struct.pack_into("<f", data, at, chance.choice(FLOATS))


def set_code(data: bytearray, chance: random.Random) -> None:
    """Write another code where NIfTI-1 keeps its dimensions, types, units and spaces."""
    at = chance.choice([*range(40, 56, 2), 70, 72, 123, 252, 254])
    if at + 2 <= len(data):
        struct.pack_into("<h", data, at, chance.choice((-1, 0, 1, 2, 3, 4, 5, 8, 16, 64, 256, 512, 10, 32767)))


def add_line(data: bytearray, chance: random.Random) -> None:
    """Add a line to a text header."""
    lines = LINES[".nrrd" if data.startswith(b"NRRD") else ".mha"]
    ends = [match.start() for match in re.finditer(rb"\n", bytes(data[:1000]))][:9]
    if ends:
        at = chance.choice(ends)
        data[at:at] = b"\n" + chance.choice(lines)


TEXT: Sequence[Mutation] = (*ANYWHERE, *(change_number, add_line) * 3)
BINARY: Sequence[Mutation] = (*ANYWHERE, *(set_float, set_code) * 3)


class ImageBorder(Border):
    """An image file of each format, with one to three changes."""

    inputs_in_tests = 1500

    def __init__(self) -> None:
        self.files = seeds()

    def check_seeds(self, folder: Path) -> None:
        for kind in self.files:
            assert self.feed((kind.split()[0], self.files[kind]), folder) == "read"

    def hostile(self, chance: random.Random) -> tuple[str, Any]:
        kind = chance.choice(list(self.files))
        suffix = kind.split()[0]
        packed = suffix == ".nii.gz" and chance.random() < 0.8
        content = bytearray(gzip.decompress(self.files[kind]) if packed else self.files[kind])
        mutate(content, BINARY if suffix.startswith(".nii") else TEXT, chance)
        return kind, (suffix, gzip.compress(content, 1) if packed else bytes(content))

    def feed(self, given: Any, folder: Path) -> str:
        suffix, content = given
        path = folder / f"image{suffix}"
        path.unlink(missing_ok=True)  # what is written over is first brought to the disk
        path.write_bytes(content)
        return check(read_ct(path, limits=LIMITS), suffix, content)


def seeds() -> dict[str, bytes]:
    """Return a small valid image of each kind, by suffix and what is special."""
    image = SimpleITK.GetImageFromArray(np.stack([pattern(k) for k in range(SLICES)]))
    image.SetSpacing((0.75, 0.5, 2.0))
    image.SetOrigin((-10.0, -20.0, 30.0))
    image.SetDirection((0.8, -0.6, 0.0, 0.6, 0.8, 0.0, 0.0, 0.0, 1.0))
    made = {}
    with tempfile.TemporaryDirectory() as folder:
        for suffix in (".nii", ".nii.gz", ".nrrd", ".mha"):
            for packed in (False, True):
                path = Path(folder) / f"image{suffix}"
                SimpleITK.WriteImage(image, str(path), useCompression=packed)
                made[suffix + " packed" * packed] = path.read_bytes()
    del made[".nii packed"], made[".nii.gz packed"]
    qform = bytearray(made[".nii"])
    struct.pack_into("<hh", qform, 252, 1, 0)
    return made | {".nii by qform": bytes(qform)}


class OpenError(Exception):
    """The header leaves something open, so that the file must be refused."""


def check(volume: CTVolume, suffix: str, content: bytes) -> str:
    """Compare places and values with those of the file's own header; raises `WrongValueError`."""
    try:
        lps_from_index, stored = READERS[suffix](content)
    except OpenError as error:
        raise WrongValueError(f"read, although {error}") from error
    except (ValueError, KeyError, IndexError, TypeError, OSError, struct.error, zlib.error, EOFError):
        return "read, unverified"
    count, rows, columns = volume.voxels_hu.shape
    for k, j, i in [(0, 0, 0), (count - 1, rows - 1, 0), (count - 1, 0, columns - 1)]:
        ours = volume.grid.positions_mm(np.array([k, j, i], dtype=float))
        either = [lps_from_index @ [i, j, number, 1.0] for number in (k, count - 1 - k)]
        if min(np.abs(ours - place).max() for place in either) > TOLERANCE_MM:
            raise WrongValueError(f"voxel {(k, j, i)} at {ours.tolist()}, its header says {either}")
    values = volume.voxels_hu.astype(np.float32)
    if volume.padding_hu is None and not any(np.array_equal(values, each) for each in (stored, stored[::-1])):
        raise WrongValueError("its values are not those in the file")
    return "read"


def _open_if(holds: bool, what: str) -> None:
    if holds:
        raise OpenError(what)


def _scaled(content: bytes, dtype: str, shape: tuple[int, ...], slope: float, intercept: float) -> Any:
    stored = np.frombuffer(content, dtype).reshape(shape).astype(np.float64)
    return (stored * slope + intercept).astype(np.float32)


def _nifti(content: bytes) -> Any:
    order = "<" if 1 <= struct.unpack_from("<h", content, 40)[0] <= 7 else ">"

    def field(form: str, at: int) -> Any:
        found = struct.unpack_from(order + form, content, at)
        return np.array(found, dtype=float) if len(found) > 1 else found[0]

    qform, sform, sizes, offset = field("h", 252), field("h", 254), field("3f", 80), field("f", 108)
    slope, intercept = field("2f", 112)
    _open_if(not (sizes > 0).all() or not np.isfinite(sizes).all(), "its voxel sizes are no sizes")
    _open_if(content[123] & 7 not in (0, 2), "it is not in mm")
    _open_if(not np.isfinite([slope, intercept]).all(), "its scale is no number")
    if slope == 0:
        slope, intercept = 1, 0
    kind = {2: "u1", 4: "i2", 8: "i4", 16: "f4", 64: "f8", 256: "i1", 512: "u2", 768: "u4"}[field("h", 70)]
    shape = tuple(int(n) for n in field("3h", 42)[::-1])
    values = _scaled(content[int(offset) :], order + kind, shape, slope, intercept)
    if sform > 0:
        rows = field("12f", 280).reshape(3, 4)
        _open_if(not np.isfinite(rows).all(), "its sform holds no numbers")
        return rows * RAS_TO_LPS, values
    _open_if(qform <= 0, "it gives no orientation")
    b, c, d = field("3f", 256)
    _open_if(not b * b + c * c + d * d <= 1 + 1e-6, "its quaternion is none")
    a = max(0.0, 1 - (b * b + c * c + d * d)) ** 0.5
    turn = np.array(
        [
            [a * a + b * b - c * c - d * d, 2 * (b * c - a * d), 2 * (b * d + a * c)],
            [2 * (b * c + a * d), a * a + c * c - b * b - d * d, 2 * (c * d - a * b)],
            [2 * (b * d - a * c), 2 * (c * d + a * b), a * a + d * d - c * c - b * b],
        ]
    )
    steps = turn * sizes * [1, 1, -1 if field("f", 76) < 0 else 1]
    _open_if(not np.isfinite(field("3f", 268)).all(), "its offset is no place")
    return np.column_stack([steps, field("3f", 268)]) * RAS_TO_LPS, values


def _nrrd(content: bytes) -> Any:
    header, _, voxels = content.partition(b"\n\n")
    lines = [line for line in header.decode("latin-1").split("\n")[1:] if not line.startswith("#")]
    pairs = [line.split(":", 1) for line in lines]
    _open_if(not all(key.isascii() for key, _ in pairs), "other readers may know another blank")
    fields = {key.strip().lower(): value.strip() for key, value in pairs}
    _open_if(len(fields) < len(pairs), "it gives a field twice")
    _open_if(set(re.findall(r"\w+", fields.get("space units", "mm"))) != {"mm"}, "it is not in mm")
    _open_if("spacings" in fields or "old max" in fields or fields.get("modality", "=CT") != "=CT", "it says so")
    vectors = [
        [float(x) for x in each.split(",")]
        for each in re.findall(r"\(([^)]*)\)", fields["space directions"] + fields["space origin"])
    ]
    signs = {"left-posterior-superior": (1, 1, 1), "right-anterior-superior": (-1, -1, 1)}[fields["space"]]
    kind = {"short": "i2", "ushort": "u2"}[fields["type"]]
    order = {"little": "<", "big": ">"}[fields["endian"]]
    if fields["encoding"] == "gzip":
        voxels = gzip.decompress(voxels)
    skip = int(fields.get("byte skip", "0"))
    shape = tuple(int(n) for n in fields["sizes"].split()[::-1])
    start = len(voxels) - 2 * int(np.prod(shape)) if skip < 0 else skip
    values = _scaled(voxels[start:], order + kind, shape, 1, 0)
    return np.array(vectors).T * np.array(signs)[:, np.newaxis], values


META_NAMES = (
    *("NDims", "DimSize", "ElementType", "ElementSpacing", "ElementDataFile", "CompressedData", "HeaderSize"),
    *("ElementToIntensityFunctionSlope", "ElementToIntensityFunctionOffset", "DistanceUnits", "Modality"),
    *("BinaryData", "CenterOfRotation", "ObjectType"),
)


def _meta(content: bytes) -> Any:
    header, found, voxels = content.partition(b"ElementDataFile = LOCAL\n")
    if not found:
        raise ValueError("the voxels are elsewhere")
    pairs = [line.split("=", 1) for line in header.decode("latin-1").split("\n") if "=" in line]
    same = {
        "Position": "Offset",
        "Orientation": "TransformMatrix",
        "ElementByteOrderMSB": "BinaryDataByteOrderMSB",
    }
    fields: dict[str, list[str]] = {}
    known = {each.lower(): each for each in (*META_NAMES, *same, *same.values())}
    for key, value in pairs:
        _open_if(not key.isascii(), "other readers may know another blank")
        name = same.get(key.strip(), key.strip())
        _open_if(known.get(name.lower(), name) != name, f"{name} may be meant to be heard")
        _open_if(fields.get(name, value.split()) != value.split(), f"it gives {name} twice")
        fields[name] = value.split()
    _open_if(fields.get("DistanceUnits", ["mm"]) != ["mm"], "it is not in mm")
    _open_if(fields.get("Modality", ["MET_MOD_CT"]) != ["MET_MOD_CT"], "it is no CT")
    matrix = np.array(fields["TransformMatrix"], dtype=float).reshape(3, 3).T
    steps = matrix * np.array(fields["ElementSpacing"], dtype=float)
    if fields["CompressedData"] == ["True"]:
        voxels = zlib.decompress(voxels)
    kind = {"MET_SHORT": "i2", "MET_USHORT": "u2"}[fields["ElementType"][0]]
    order = {"True": ">", "False": "<"}[fields["BinaryDataByteOrderMSB"][0]]
    shape = tuple(int(n) for n in fields["DimSize"][::-1])
    skip = int(fields.get("HeaderSize", ["0"])[0])
    start = len(voxels) - 2 * int(np.prod(shape)) if skip < 0 else skip
    slope = float(fields.get("ElementToIntensityFunctionSlope", ["1"])[0])
    intercept = float(fields.get("ElementToIntensityFunctionOffset", ["0"])[0])
    values = _scaled(voxels[start:], order + kind, shape, slope, intercept)
    return np.column_stack([steps, np.array(fields["Offset"], dtype=float)]), values


READERS: dict[str, Callable[[bytes], Any]] = {
    ".nii": _nifti,
    ".nii.gz": lambda content: _nifti(gzip.decompress(content)),
    ".nrrd": _nrrd,
    ".mha": _meta,
}
