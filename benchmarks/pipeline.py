"""Read + localize, against SimpleITK merely reading the same series (files in the page cache, one run).

    python -m benchmarks.pipeline [FOLDER --diameter MM]

Without a folder three heads are rendered: 190 slices of 512 x 512 with 11.5 mm markers, 310 slices of 0.6 mm with 3 mm
balls, and 1,000 slices of 0.2 mm. Extra memory is what localizing needs beyond the volume that was read, at its peak,
in a fresh process. The stages show where the time goes, beside the roofline: what moving a stage's bytes once takes at
the memory's speed, measured in the same run.
"""

from __future__ import annotations

import argparse
import math
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from phantoms.fast import render
from phantoms.library import demo_head, patient
from phantoms.output import write_phantom
from phantoms.scene import Scene
from phantoms.stack import axial_stack
from ronnaplan import CTVolume, localize, read_ct
from ronnaplan.errors import RefusedError
from ronnaplan.localization.build import SOLID
from ronnaplan.localization.examine import examine
from ronnaplan.localization.judge.accept import MIN_COVERAGE
from ronnaplan.localization.scanner.scan import Scan
from ronnaplan.localization.search.coarse import coarse_voxel_mm, coarsen
from ronnaplan.localization.search.detect import detect
from ronnaplan.localization.search.look import surface_shares
from ronnaplan.localization.size import common_diameter
from ronnaplan.report.tables import align

REPEATS = 9

TOP_MM = 117.0
"""Height of the uppermost slice."""

MEASURE_MEMORY = """
import ctypes, re, sys
from pathlib import Path
from ronnaplan import localize, read_ct

def memory(name):
    return 1024 * int(re.search(name + r":\\s+(\\d+)", Path("/proc/self/status").read_text())[1])

volume, diameter_mm = read_ct(sys.argv[1]), float(sys.argv[2])
localize(volume, diameter_mm=diameter_mm)
ctypes.CDLL("libc.so.6").malloc_trim(0)
Path("/proc/self/clear_refs").write_text("5")
before = memory("VmRSS")
localize(volume, diameter_mm=diameter_mm)
print((memory("VmHWM") - before) / volume.voxels_hu.nbytes)
"""
"""What the fresh process runs: once to load the code, then what it freed is returned, and then it is measured."""


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", nargs="?", type=Path)
    parser.add_argument("--diameter", type=float, default=11.5, metavar="MM")
    arguments = parser.parse_args()
    if arguments.folder:
        measure(arguments.folder, arguments.diameter)
        return
    with tempfile.TemporaryDirectory() as folder:
        measure(make_series(Path(folder) / "large", demo_head(), slices=190, spacing_mm=1.0), 11.5)
        measure(make_series(Path(folder) / "small", patient(8, "titanium 3"), slices=310, spacing_mm=0.6), 3.0)
        measure(make_series(Path(folder) / "long", demo_head(), slices=1000, spacing_mm=0.2), 11.5)


def make_series(folder: Path, scene: Scene, *, slices: int, spacing_mm: float) -> Path:
    """Render ``scene`` in slices of 512 x 512 up to above the head and write them, uncompressed."""
    start_mm = TOP_MM - (slices - 1) * spacing_mm
    stack = axial_stack(start_mm=start_mm, stop_mm=TOP_MM, spacing_mm=spacing_mm, field_of_view_mm=250.0)
    write_phantom(folder, scene, stack, render(scene, stack, noise_hu=15.0, seed=1))
    return folder


def measure(folder: Path, diameter_mm: float) -> None:
    """Print the best of `REPEATS` times of each step and its ratio to SimpleITK's reading, then the stages."""
    volume = read_ct(folder)
    found = localize(volume, diameter_mm=diameter_mm)
    print(f"{volume.voxels_hu.shape} voxels, {len(found)} markers of {diameter_mm:g} mm found")
    two = (diameter_mm, 11.5 if diameter_mm != 11.5 else 8.0)
    times = best_of_each(
        {
            "SimpleITK: list and read": lambda: read_with_simpleitk(folder),
            "ronnaplan: read": lambda: read_ct(folder),
            "ronnaplan: localize": lambda: localize(volume, diameter_mm=diameter_mm),
            "ronnaplan: read + localize": lambda: localize(read_ct(folder), diameter_mm=diameter_mm),
            f"the same, {two[0]:g} and {two[1]:g} mm": lambda: localize(read_ct(folder), diameter_mm=two),
            "the same, --diameter auto": lambda: localize_any(read_ct(folder)),
        }
    )
    reference = times["SimpleITK: list and read"]
    rows = [[name, f"{seconds:.3f}", f"{seconds / reference:.2f}"] for name, seconds in times.items()]
    print(align([["", "s", "ratio"], *rows]))
    print(f"extra memory: {extra_memory(folder, diameter_mm):.2f} of the voxels\n")
    print(align([["stage", "s", "MB moved", "s at the memory's speed"], *stages(volume, diameter_mm)]))
    print(flush=True)


def localize_any(volume: CTVolume) -> object:
    """Find the commonest balls of a scan, whatever their size; None where the scale's end hides it, as with metal."""
    try:
        return localize(volume, diameter_mm=common_diameter(volume))
    except RefusedError:
        return None


def stages(volume: CTVolume, diameter_mm: float) -> list[list[str]]:
    """Return a row for each stage of localizing: its time, the bytes that it moves at least, and these bytes' time."""
    scan = Scan(volume)
    coarse = coarsen(volume, coarse_voxel_mm(diameter_mm)).voxels_hu
    seen = detect(volume, diameter_mm)
    thickness_mm = scan.thickness_mm(seen)
    coarsening = best(lambda: coarsen(volume, coarse_voxel_mm(diameter_mm)))
    detecting = best(lambda: detect(volume, diameter_mm))
    looking = best(lambda: surface_shares(volume, seen, diameter_mm, SOLID, thickness_mm, MIN_COVERAGE))
    examining = best(lambda: examine(scan, (diameter_mm,)))
    taken = {
        "average to coarse voxels": (coarsening, volume.voxels_hu.nbytes + coarse.nbytes),
        "vote and find peaks": (detecting - coarsening, 2 * coarse.nbytes),
        f"glance at {len(seen)} places": (looking, 0),
        "fit and judge": (examining - detecting - looking, 0),
    }
    speed = memory_speed()
    return [
        [name, f"{max(seconds, 0.0):.3f}", f"{moved / 1e6:.0f}", f"{moved / speed:.3f}"]
        for name, (seconds, moved) in taken.items()
    ]


def memory_speed() -> float:
    """Bytes a second that one core copies, read and written."""
    source = np.ones(1 << 26)
    target = np.empty_like(source)
    return 2 * source.nbytes / best(lambda: np.copyto(target, source))


def extra_memory(folder: Path, diameter_mm: float) -> float:
    """Peak memory of localizing beyond that of having read, as a share of the voxels', in a fresh process."""
    command = [sys.executable, "-c", MEASURE_MEMORY, str(folder), str(diameter_mm)]
    return float(subprocess.run(command, check=True, capture_output=True, text=True).stdout)


def best_of_each(actions: Mapping[str, Callable[[], object]]) -> dict[str, float]:
    """Shortest of a few runs of each of ``actions``, in seconds: the least disturbed one.

    They take turns, so that a machine whose speed wavers disturbs all of them alike.
    """
    times = dict.fromkeys(actions, math.inf)
    for _ in range(REPEATS):
        for name, action in actions.items():
            times[name] = min(times[name], timed(action))
    return times


def best(action: Callable[[], object]) -> float:
    """Shortest of a few runs, in seconds."""
    return min(timed(action) for _ in range(REPEATS))


def timed(action: Callable[[], object]) -> float:
    """How many seconds it takes."""
    start = time.perf_counter()
    action()
    return time.perf_counter() - start


def read_with_simpleitk(folder: Path) -> object:
    """List the folder's first series and read it."""
    import SimpleITK as sitk

    reader = sitk.ImageSeriesReader()
    reader.SetFileNames(reader.GetGDCMSeriesFileNames(str(folder)))
    return reader.Execute()


if __name__ == "__main__":
    main()
