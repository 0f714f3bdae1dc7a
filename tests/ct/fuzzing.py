"""Feeds mutated CT files to the reader and checks every answer against pydicom.

    python -m tests.ct.fuzzing --count 100000 --seed 1

Each input is a small valid series of one of the kinds of `SEEDS` with one to three mutations of its bytes. It
must be refused with a `RonnaplanError` or read so that each slice lies where pydicom says that its file puts it.
Anything else, or more than `SLOWEST_S`, is a failure; the process that reads is a child, so that a crash in a
decoder is seen too.
"""

from __future__ import annotations

import argparse
import io
import multiprocessing
import random
import re
import resource
import signal
import struct
import sys
import tempfile
import time
import traceback
import warnings
import zipfile
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pydicom
from pydicom.dataset import Dataset, FileDataset
from pydicom.uid import UID

from ronnaplan.ct import CTVolume, Limits, read_ct
from ronnaplan.errors import RonnaplanError
from tests.ct.makers import compress, dataset, enhanced, pattern, save

SLOWEST_S = 5.0
TOLERANCE_MM = 0.05
MEMORY_BYTES = 6 << 30
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
IMAGES = (".nii", ".nrrd", ".mha")
UNCOMPRESSED = ("explicit", "implicit", "big endian", "deflated")
Files = list[bytes]


def seeds() -> dict[str, Files]:
    """Return the valid series that are mutated, each as the bytes of its files."""
    made = {name: [_slice(k, syntax) for k in range(SLICES)] for name, syntax in SYNTAXES.items()}
    made["enhanced"] = [_bytes(enhanced(SLICES))]
    made["zip"] = [_zipped(made["explicit"])]
    made |= {suffix: [_image(suffix)] for suffix in IMAGES}
    return made


def _zipped(files: Files) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for k, content in enumerate(files):
            archive.writestr(f"study/{k}", content)
    return stream.getvalue()


def _image(suffix: str) -> bytes:
    import SimpleITK

    image = SimpleITK.GetImageFromArray(np.stack([pattern(k) for k in range(SLICES)]))
    image.SetSpacing((0.75, 0.5, 2.0))
    image.SetOrigin((-10.0, -20.0, 30.0))
    image.SetDirection((0.8, -0.6, 0.0, 0.6, 0.8, 0.0, 0.0, 0.0, 1.0))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"image{suffix}"
        SimpleITK.WriteImage(image, str(path))
        return path.read_bytes()


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


# --- mutations -------------------------------------------------------------------------------------------------

INTERESTING = (0, 1, 2, 7, 0x7F, 0xFF, 0x7FFF, 0x8000, 0xFFFE, 0xFFFF, 0x7FFFFFFF, 0xFFFFFFFE, 0xFFFFFFFF)
NUMBERS = (
    b"0",
    b"-0",
    b"1e30",
    b"nan",
    b"inf",
    b"-1",
    b"1e-9",
    b"",
    b"\\",
    b"0.5",
    b"99999",
    b"1_0",
    b"+5",
    b" 3",
)


def _flip(data: bytearray, chance: random.Random) -> None:
    for _ in range(chance.choice((1, 1, 1, 2, 8))):
        data[chance.randrange(len(data))] ^= 1 << chance.randrange(8)


def _flip_header(data: bytearray, chance: random.Random) -> None:
    data[chance.randrange(min(len(data), 1400))] = chance.randrange(256)


def _set_number(data: bytearray, chance: random.Random) -> None:
    at, form = chance.randrange(len(data) - 4), chance.choice(("<H", ">H", "<L", ">L"))
    value = chance.choice(INTERESTING) & (0xFFFF if form[1] == "H" else 0xFFFFFFFF)
    data[at : at + struct.calcsize(form)] = struct.pack(form, value)


def _change_digit(data: bytearray, chance: random.Random) -> None:
    digits = [at for at in range(132, min(len(data), 1400)) if 0x30 <= data[at] <= 0x39]
    if digits:
        data[chance.choice(digits)] = chance.choice(b"0123456789.-+eE\\ ")


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


def _truncate(data: bytearray, chance: random.Random) -> None:
    del data[chance.randrange(len(data)) :]


def _delete(data: bytearray, chance: random.Random) -> None:
    at = chance.randrange(len(data))
    del data[at : at + chance.choice((1, 2, 8, 64))]


def _repeat(data: bytearray, chance: random.Random) -> None:
    at, count = chance.randrange(len(data)), chance.choice((2, 8, 64, 300))
    data[at:at] = data[at : at + count]


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


MUTATIONS: Sequence[Callable[[bytearray, random.Random], None]] = (
    _flip,
    _flip,
    _flip_header,
    _flip_header,
    _set_number,
    _set_number,
    _change_digit,
    _change_digit,
    _change_text,
    _truncate,
    _delete,
    _repeat,
    _swap_syntax,
    _nest,
)


def mutated(series: dict[str, Files], number: int, seed: int) -> tuple[str, Files]:
    """Return the kind and the files of input ``number``: the same for the same seed."""
    chance = random.Random(f"{seed}/{number}")
    kind = chance.choice(list(series))
    files = [bytearray(content) for content in series[kind]]
    for _ in range(chance.choice((1, 1, 2, 3))):
        target = chance.choice(files)
        if len(target) > 8:
            chance.choice(MUTATIONS)(target, chance)
    return kind, [bytes(content) for content in files]


# --- the oracle ------------------------------------------------------------------------------------------------


class WrongGeometryError(AssertionError):
    """A volume was returned that disagrees with pydicom."""


def check(volume: CTVolume, path: Path) -> str:
    """Compare a volume with what pydicom reads from the same files; raises `WrongGeometryError`."""
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
            raise WrongGeometryError(f"slice {k} at {origin.tolist()} to {last.tolist()}, pydicom has {places}")
    if not (np.diff(volume.grid.slice_positions_mm) > 0).all():
        raise WrongGeometryError("the slices are not in ascending order")
    return "read"


def check_image(volume: CTVolume, path: Path) -> str:
    """Compare a volume with the affine map in the file's own header, read here by the letter of its format."""
    try:
        lps_from_index = OWN_HEADERS[path.suffix](path.read_bytes())
    except (ValueError, KeyError, IndexError, struct.error):
        return "read, unverified"
    count, rows, columns = volume.voxels_hu.shape
    for k, j, i in [(0, 0, 0), (count - 1, rows - 1, 0), (count - 1, 0, columns - 1)]:
        ours = volume.grid.positions_mm(np.array([k, j, i], dtype=float))
        either = [lps_from_index @ [i, j, number, 1.0] for number in (k, count - 1 - k)]
        if min(np.abs(ours - place).max() for place in either) > TOLERANCE_MM:
            raise WrongGeometryError(f"voxel {(k, j, i)} at {ours.tolist()}, its header says {either}")
    return "read"


def _nifti(content: bytes) -> Any:
    order = "<" if 1 <= struct.unpack_from("<h", content, 40)[0] <= 7 else ">"
    if struct.unpack_from(order + "h", content, 254)[0] <= 0:
        raise ValueError("the matrix read here is not in force")
    rows = np.array(struct.unpack_from(order + "12f", content, 280), dtype=float).reshape(3, 4)
    return rows * [[-1.0], [-1.0], [1.0]]


def _nrrd(content: bytes) -> Any:
    header = content.split(b"\n\n")[0].decode("latin-1")
    vectors = [[float(x) for x in each.split(",")] for each in re.findall(r"\(([^)]*)\)", header)]
    signs = {"left-posterior-superior": (1, 1, 1), "right-anterior-superior": (-1, -1, 1)}
    found = re.search(r"^space: *(.*)$", header, re.MULTILINE)
    return np.array(vectors).T * np.array(signs[found.group(1).strip() if found else ""])[:, np.newaxis]


def _meta(content: bytes) -> Any:
    lines = [line.split("=", 1) for line in content[:2000].decode("latin-1").split("\n") if "=" in line]
    fields = {key.strip(): value.split() for key, value in lines}
    matrix = np.array(fields["TransformMatrix"], dtype=float).reshape(3, 3).T
    steps = matrix * np.array(fields["ElementSpacing"], dtype=float)
    return np.column_stack([steps, np.array(fields["Offset"], dtype=float)])


OWN_HEADERS: dict[str, Callable[[bytes], Any]] = {".nii": _nifti, ".nrrd": _nrrd, ".mha": _meta}


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


# --- running ---------------------------------------------------------------------------------------------------


class SlowError(Exception):
    """Reading took longer than `SLOWEST_S`."""


def _too_slow(*_: object) -> None:
    raise SlowError


def _written(kind: str, files: Files, folder: Path) -> Path:
    """Write the files of one input into the emptied ``folder``; return what to read."""
    for old in folder.iterdir():
        old.unlink()
    for k, content in enumerate(files):
        (folder / f"{k}{kind if kind in IMAGES else ''}").write_bytes(content)
    return folder if len(files) > 1 or kind not in (*IMAGES, "zip") else next(folder.iterdir())


def read_all(series: dict[str, Files], folder: Path) -> None:
    """Read every seed as it is: all must be sound, and what is compiled at first use is compiled by then."""
    for kind, files in series.items():
        read_ct(_written(kind, files, folder), limits=LIMITS)


def try_one(series: dict[str, Files], number: int, seed: int, folder: Path) -> tuple[str, str]:
    """Read one input; return its kind and what became of it, a failure starting with ``FAILED``."""
    kind, files = mutated(series, number, seed)
    path = _written(kind, files, folder)
    started = time.monotonic()
    try:
        volume = read_ct(path, limits=LIMITS)
    except RonnaplanError as error:
        if "\n" in str(error) or not str(error).isprintable():
            return kind, f"FAILED: a message that is not one printable line: {error!r}"
        outcome = "refused"
    except Exception:
        return kind, "FAILED: " + traceback.format_exc()
    else:
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                outcome = check_image(volume, path) if kind in IMAGES else check(volume, path)
        except WrongGeometryError as error:
            return kind, f"FAILED: {error}"
    took = time.monotonic() - started
    return (kind, outcome) if took < SLOWEST_S else (kind, f"FAILED: took {took:.1f} s")


def _work(series: dict[str, Files], first: int, count: int, seed: int, results: Any) -> None:
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
    signal.signal(signal.SIGALRM, _too_slow)
    with tempfile.TemporaryDirectory() as folder:
        read_all(series, Path(folder))
        for number in range(first, first + count):
            results.put((number, "begun", ""))
            signal.setitimer(signal.ITIMER_REAL, 2 * SLOWEST_S)
            kind, outcome = try_one(series, number, seed, Path(folder))
            signal.setitimer(signal.ITIMER_REAL, 0)
            results.put((number, kind, outcome))
    results.put((first + count, "", "all done"))


def run(count: int, seed: int) -> int:
    """Try ``count`` inputs in a child process, begun anew after a crash; print and return the failures."""
    import queue

    outcomes: Counter[tuple[str, str]] = Counter()
    failures: list[str] = []
    series = seeds()
    number = 0
    while number < count:
        results: Any = multiprocessing.Queue()
        child = multiprocessing.Process(target=_work, args=(series, number, count - number, seed, results))
        child.start()
        last = time.monotonic()
        while number < count:
            try:
                at, kind, outcome = results.get(timeout=1.0)
            except queue.Empty:
                if child.is_alive() and time.monotonic() - last < 6 * SLOWEST_S:
                    continue
                child.kill()
                failures.append(f"input {number}: crashed or hung (exit status {child.exitcode})")
                outcomes["?", "FAILED"] += 1
                number += 1
                break
            last = time.monotonic()
            if kind == "begun" or outcome == "all done":
                number = at
                continue
            number = at + 1
            failed = outcome.startswith("FAILED")
            outcomes[kind, "FAILED" if failed else outcome] += 1
            if failed:
                failures.append(f"input {at} ({kind}): {outcome}")
                print(failures[-1], file=sys.stderr)
            if number % 5000 == 0:
                print(f"{number} tried, {len(failures)} failures", file=sys.stderr)
        child.join(timeout=10)
    _report(outcomes, failures)
    return len(failures)


def _report(outcomes: Counter[tuple[str, str]], failures: list[str]) -> None:
    columns = ("refused", "read", "read, unverified", "FAILED")
    print(f"{'kind':18}" + "".join(f"{name:>18}" for name in columns))
    kinds = sorted({kind for kind, _ in outcomes})
    for kind in kinds:
        print(f"{kind:18}" + "".join(f"{outcomes[kind, name]:18}" for name in columns))
    totals = [sum(outcomes[kind, name] for kind in kinds) for name in columns]
    print(f"{'all':18}" + "".join(f"{total:18}" for total in totals))
    for failure in failures[:20]:
        print(failure)


def main() -> int:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--count", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    return 1 if run(arguments.count, arguments.seed) else 0


if __name__ == "__main__":
    sys.exit(main())
