"""Distances from a path to a vessel drawn as a label map: error against the closed form, by vessel and voxel size.

    python -m benchmarks.labels [--cases N]

Vessels of random shape, radius, place and direction, and paths 1 to 5 mm beside them. Beside the smooth surface: the
voxels themselves (boxes), and what is stated as the least distance, which must never be above the true one.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

from phantoms.vessels import SHAPES, random_vessel, straight
from ronnaplan.ct import CTVolume, SliceGrid
from ronnaplan.geometry import FloatArray
from ronnaplan.planning import Head, Instrument, Trajectory
from ronnaplan.planning.obstacles import Kind, Voxels
from ronnaplan.planning.sampling import SliceSampler
from ronnaplan.planning.segments import box_distance

COUNT = 48
"""Voxels a side of the grid about the place that is nearest to the path."""

NEEDLE = Instrument("needle", 0.2, 150.0)

ALONG = "along a grid axis"

SIZES = {
    "0.3": (0.3, 0.3, 0.3),
    "0.5": (0.5, 0.5, 0.5),
    "0.5 x 0.5 x 1": (0.5, 0.5, 1.0),
    "0.7": (0.7, 0.7, 0.7),
    "1": (1.0, 1.0, 1.0),
}
"""Voxels: columns, rows and slices apart, in mm."""

ROWS = [(shape, radii, size) for size in SIZES for radii in ((1.0, 2.0), (2.0, 5.0)) for shape in (*SHAPES, ALONG)]
"""Shape, range of the radius in mm, and voxels."""


def measure(shape: str, radius: float, spacing: FloatArray, generator: np.random.Generator) -> list[float]:
    """Return for a random path: is it smooth; smooth, least and box distance less the closed form; seconds."""
    way, distance = None, generator.uniform(1.0, 5.0)
    while way is None:
        axis = np.eye(3)[int(generator.integers(3))]
        vessel = straight(radius, axis, generator) if shape == ALONG else random_vessel(shape, radius, generator)
        way = vessel.path_beside(distance, generator)
    corner = generator.uniform(-0.5, 0.5, 3) * spacing - (COUNT - 1) / 2 * spacing
    step = np.diag(spacing)
    grid = SliceGrid(corner + np.arange(COUNT)[:, np.newaxis] * step[2], step[1], step[0], float(spacing[2]))
    volume = CTVolume(np.zeros((COUNT, COUNT, COUNT), dtype=np.int16), grid)
    head = Head(volume, SliceSampler.of(volume), np.zeros((1, 1, 1), dtype=np.bool_), 1)
    index = np.moveaxis(np.indices(volume.voxels_hu.shape), 0, -1).astype(np.float64)
    label = Voxels.of(Kind.NO_GO, "vessel", vessel.depth(grid.positions_mm(index)) < 0, head)
    middle = distance * vessel.normal
    reach = COUNT / 6 * spacing.min() * way  # no further: the grid cuts the vessel
    path = Trajectory("A", middle - reach, middle + reach, volume.frame, NEEDLE)
    start = time.process_time()
    found = label.clearance(path)
    spent = time.process_time() - start
    assert found is not None
    ends = label.axes @ path.entry_mm, label.axes @ path.target_mm
    boxes, _ = box_distance(*ends, label.low_mm, label.high_mm)
    least = found.at_least_mm + NEEDLE.radius_mm
    return [found.smooth, found.distance_mm - distance, least - distance, float(boxes) - distance, spent]


def main(cases: int, only: str) -> None:
    """Print one row for each size and shape of vessel and voxel."""
    print(f"{cases} paths each; distance less closed form, mm; CPU time of a path")
    print(f"{'voxels':15}{'radius':>8} {'vessel':18}{'smooth':>8}{'RMS':>7}{'95 %':>7}{'most':>7}", end="")
    print(f"{'least: mean':>13}{'highest':>9}{'boxes: lowest':>15}{'highest':>9}{'ms':>6}")
    for shape, radii, size in ROWS:
        if only and only != size:
            continue
        generator = np.random.default_rng(5)
        spacing = np.array(SIZES[size])
        found = np.array([measure(shape, generator.uniform(*radii), spacing, generator) for _ in range(cases)])
        smooth, error, least, boxes, spent = found.T
        off = np.abs(error)
        print(f"{size:15}{radii[0]:4.0f} - {radii[1]:1.0f} {shape:18}{100 * smooth.mean():7.0f}%", end="")
        print(f"{np.sqrt((off**2).mean()):7.3f}{np.quantile(off, 0.95):7.3f}{off.max():7.3f}", end="")
        print(f"{least.mean():13.3f}{least.max():9.3f}{boxes.min():15.3f}{boxes.max():9.3f}", end="")
        print(f"{1e3 * spent.mean():6.0f}", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=200)
    parser.add_argument("--voxels", choices=SIZES, help="these only")
    options = parser.parse_args()
    main(options.cases, options.voxels or "")
