"""Time and peak memory of reading a CT series, against SimpleITK's series reader on the same files; image files, too.

    python -m benchmarks.reading [FOLDER] [--repeat 9]

Without a folder a head is rendered: 190 uncompressed slices of 512 x 512. Both readers are called in turn, after
one unmeasured round, so that all files are in the page cache.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from statistics import median

import SimpleITK

from benchmarks.pipeline import make_series
from phantoms.library import demo_head
from ronnaplan.ct import CTVolume, find_series, read_ct

GOAL = 1.2
MEMORY_GOAL = 1.3
IMAGE_GOAL = 1.5
"""Packed image files take as long as unpacking them, and ITK brings a faster zlib than Python's."""


def main() -> int:
    """Print the table; return 1 if a goal is missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", nargs="?", type=Path)
    parser.add_argument("--repeat", type=int, default=9)
    parser.add_argument("--memory-of", choices=["headers", "volume"], help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.memory_of:
        print(peak_bytes(arguments.folder, arguments.memory_of))
        return 0
    if arguments.folder is not None:
        return compare(arguments.folder, arguments.repeat)
    with tempfile.TemporaryDirectory() as folder:
        return compare(make_series(Path(folder) / "ct", demo_head(), slices=190, spacing_mm=1.0), arguments.repeat)


def compare(folder: Path, repeat: int) -> int:
    """Time both readers on ``folder`` in turn and print their ratio."""
    names = SimpleITK.ImageSeriesReader.GetGDCMSeriesFileNames(str(folder))
    volume = read_ct(folder)
    theirs = SimpleITK.GetArrayFromImage(with_simpleitk(folder))
    same = theirs.shape == volume.voxels_hu.shape and bool((theirs == volume.voxels_hu).all())
    times: dict[str, list[float]] = {"SimpleITK": [], "ronnaplan": [], "ronnaplan, headers only": []}
    for _ in range(repeat):
        times["SimpleITK"].append(seconds(lambda: with_simpleitk(folder)))
        times["ronnaplan"].append(seconds(lambda: read_ct(folder)))
        times["ronnaplan, headers only"].append(seconds(lambda: find_series(folder)))
    shape = " x ".join(str(size) for size in volume.voxels_hu.shape)
    print(f"{len(names)} files, {shape} voxels, {volume.voxels_hu.nbytes / 1e6:.0f} MB; the same values: {same}")
    print(f"{'reader':26}{'median s':>10}{'best s':>10}{'ratio':>8}")
    for name, taken in times.items():
        ratio = median(taken) / median(times["SimpleITK"])
        print(f"{name:26}{median(taken):10.3f}{min(taken):10.3f}{ratio:8.2f}")
    ratio = median(times["ronnaplan"]) / median(times["SimpleITK"])
    memory = added_memory(folder) / volume.voxels_hu.nbytes
    print(
        f"time ratio {ratio:.2f} (goal: at most {GOAL}); peak memory {memory:.2f} x voxels (at most {MEMORY_GOAL})"
    )
    print(f"{'image file':26}{'SimpleITK':>10}{'ronnaplan':>10}{'ratio':>8}")
    missed = compare_images(volume, repeat)
    return missed if ratio <= GOAL and memory <= MEMORY_GOAL else 1


def compare_images(volume: CTVolume, repeat: int) -> int:
    """Time both readers on the same voxels as image files, plain and packed; return 1 if a goal is missed."""
    image = SimpleITK.GetImageFromArray(volume.voxels_hu)
    ratios = []
    with tempfile.TemporaryDirectory() as folder:
        for suffix, packed in (
            (".nii", False),
            (".nii.gz", True),
            (".nrrd", False),
            (".nrrd", True),
            (".mha", True),
        ):
            path = Path(folder) / f"head{suffix}"
            SimpleITK.WriteImage(image, str(path), useCompression=packed)
            theirs, ours = [], []
            for _ in range(repeat):
                theirs.append(seconds(partial(_read_with_simpleitk, path)))
                ours.append(seconds(partial(read_ct, path)))
            ratios.append(median(ours) / median(theirs))
            name = f"{suffix}{', packed' if packed else ''}"
            print(f"{name:26}{median(theirs):10.3f}{median(ours):10.3f}{ratios[-1]:8.2f}")
    return 0 if max(ratios) <= IMAGE_GOAL else 1


def _read_with_simpleitk(path: Path) -> object:
    return SimpleITK.GetArrayFromImage(SimpleITK.ReadImage(str(path)))


def with_simpleitk(folder: Path) -> SimpleITK.Image:
    """Read the series as SimpleITK's documentation shows."""
    reader = SimpleITK.ImageSeriesReader()
    reader.SetFileNames(reader.GetGDCMSeriesFileNames(str(folder)))
    found: SimpleITK.Image = reader.Execute()
    return found


def seconds(work: Callable[[], object]) -> float:
    """Return how long ``work`` takes."""
    started = time.perf_counter()
    work()
    return time.perf_counter() - started


def added_memory(folder: Path) -> int:
    """Return by how much reading raises the peak memory of a fresh process above reading the headers only."""
    peaks = {}
    for what in ("headers", "volume"):
        command = [sys.executable, "-m", "benchmarks.reading", str(folder), "--memory-of", what]
        peaks[what] = int(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
    return peaks["volume"] - peaks["headers"]


def peak_bytes(folder: Path, what: str) -> int:
    """Return the peak memory of this process (Linux), after reading the headers or the volume."""
    find_series(folder)
    if what == "volume":
        read_ct(folder)
    status = Path("/proc/self/status").read_text()
    return int(status.split("VmHWM:")[1].split()[0]) * 1024


if __name__ == "__main__":
    sys.exit(main())
