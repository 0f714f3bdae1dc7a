"""Read + localize, against SimpleITK merely reading the same series (files in the page cache, one run).

    python -m benchmarks.pipeline [FOLDER --diameter MM]

Without a folder a head with 11.5 mm markers is rendered: 190 slices of 512 x 512.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from phantoms.fast import render
from phantoms.library import demo_head
from phantoms.output import write_phantom
from phantoms.stack import axial_stack
from ronnaplan import localize, read_ct
from ronnaplan.report.tables import align

REPEATS = 5


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
        measure(make_series(Path(folder) / "ct"), arguments.diameter)


def make_series(folder: Path) -> Path:
    """Render the demo head as 190 slices of 512 x 512 and write it, uncompressed."""
    scene = demo_head()
    stack = axial_stack(start_mm=-72.0, stop_mm=117.0, spacing_mm=1.0, field_of_view_mm=250.0)
    write_phantom(folder, scene, stack, render(scene, stack, noise_hu=15.0, seed=1))
    return folder


def measure(folder: Path, diameter_mm: float) -> None:
    """Print the best of `REPEATS` times of each step and its ratio to SimpleITK's reading."""
    volume = read_ct(folder)
    found = localize(volume, diameter_mm=diameter_mm)
    print(f"{volume.voxels_hu.shape} voxels, {len(found)} markers of {diameter_mm:g} mm found")
    times = {
        "SimpleITK: list and read": best(lambda: read_with_simpleitk(folder)),
        "ronnaplan: read": best(lambda: read_ct(folder)),
        "ronnaplan: localize": best(lambda: localize(volume, diameter_mm=diameter_mm)),
        "ronnaplan: read + localize": best(lambda: localize(read_ct(folder), diameter_mm=diameter_mm)),
    }
    reference = times["SimpleITK: list and read"]
    rows = [[name, f"{seconds:.3f}", f"{seconds / reference:.2f}"] for name, seconds in times.items()]
    print(align([["", "s", "ratio"], *rows]))


def best(action: Callable[[], object]) -> float:
    """Shortest of a few runs, in seconds: the least disturbed one."""
    times = []
    for _ in range(REPEATS):
        start = time.perf_counter()
        action()
        times.append(time.perf_counter() - start)
    return min(times)


def read_with_simpleitk(folder: Path) -> object:
    """List the folder's first series and read it."""
    import SimpleITK as sitk

    reader = sitk.ImageSeriesReader()
    reader.SetFileNames(reader.GetGDCMSeriesFileNames(str(folder)))
    return reader.Execute()


if __name__ == "__main__":
    main()
