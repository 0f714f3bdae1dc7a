"""Distances from a path to a vessel drawn as a label map: error against the closed form, by shape and voxel size.

    python -m benchmarks.labels [--cases N]

Beside the smooth surface: the voxels themselves (boxes), and what is stated as the least distance.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable

import numpy as np
from scipy.spatial.transform import Rotation

from ronnaplan.ct import CTVolume, SliceGrid
from ronnaplan.geometry import FloatArray
from ronnaplan.planning import Head, Instrument, Trajectory
from ronnaplan.planning.obstacles import Kind, Voxels
from ronnaplan.planning.sampling import Scan
from ronnaplan.planning.segments import box_distance

COUNT = 48
"""Voxels a side of the grid about the place that is nearest to the path."""

BEND = 10.0
"""Radius of a bent tube's axis, in radii of the tube."""

NEEDLE = Instrument("needle", 0.2, 150.0)

CASES = [
    ("tube", 1.5, (0.5, 0.5, 0.5)),
    ("bent tube", 1.5, (0.5, 0.5, 0.5)),
    ("sphere", 2.5, (0.5, 0.5, 0.5)),
    ("tube", 2.5, (0.5, 0.5, 1.0)),
    ("tube", 3.0, (1.0, 1.0, 1.0)),
    ("bent tube", 3.0, (1.0, 1.0, 1.0)),
    ("tube", 1.5, (1.0, 1.0, 1.0)),
    ("tube along the grid", 1.5, (0.5, 0.5, 0.5)),
    ("tube along the grid", 3.0, (0.5, 0.5, 0.5)),
]


def solid(shape: str, radius: float, axis: FloatArray, towards: FloatArray) -> Callable[[FloatArray], FloatArray]:
    """Return the signed distance to a vessel through the origin along ``axis``."""
    if shape == "sphere":
        return lambda p: np.asarray(np.linalg.norm(p, axis=-1) - radius)
    if shape != "bent tube":
        return lambda p: np.asarray(np.linalg.norm(np.cross(p, axis), axis=-1) - radius)
    centre, square = BEND * radius * towards, np.cross(axis, towards)

    def bent(p: FloatArray) -> FloatArray:
        along = (p - centre) @ square
        out = np.linalg.norm(p - centre - along[..., np.newaxis] * square, axis=-1)
        return np.asarray(np.hypot(out - BEND * radius, along) - radius)

    return bent


def errors(
    shape: str, radius: float, spacing: tuple[float, float, float], generator: np.random.Generator
) -> list[float]:
    """Return for a random path: is it smooth, and smooth, least and box distance less the closed form."""
    axis, towards, other = Rotation.random(rng=generator).as_matrix()
    if "grid" in shape:
        axis, towards, other = np.roll(np.eye(3), int(generator.integers(3)), axis=0)
    angle = generator.uniform(0.0, 2.0 * np.pi)
    aside = np.cos(angle) * towards + np.sin(angle) * other
    way = 0.8 * np.cross(axis, aside) + generator.choice([-0.6, 0.6]) * axis
    middle = (radius + generator.uniform(1.0, 5.0)) * aside
    vessel = solid(shape, radius, axis, towards)
    along = np.linspace(-25.0, 25.0, 50001)[:, np.newaxis]
    true = float(vessel(middle + along * way).min())
    step = np.diag(spacing)
    corner = radius * aside + generator.uniform(-0.5, 0.5, 3) * spacing - (COUNT - 1) / 2 * np.array(spacing)
    grid = SliceGrid(corner + np.arange(COUNT)[:, np.newaxis] * step[2], step[1], step[0], spacing[2])
    volume = CTVolume(np.zeros((COUNT, COUNT, COUNT), dtype=np.int16), grid)
    head = Head(volume, Scan.of(volume), np.zeros((1, 1, 1), dtype=np.bool_), 1)
    index = np.moveaxis(np.indices(volume.voxels_hu.shape), 0, -1).astype(np.float64)
    label = Voxels.of(Kind.NO_GO, "vessel", vessel(grid.positions_mm(index)) < 0, head)
    path = Trajectory("A", middle - 25.0 * way, middle + 25.0 * way, volume.frame, NEEDLE)
    found = label.clearance(path, head)
    assert found is not None
    ends = label.axes @ path.entry_mm, label.axes @ path.target_mm
    boxes, _ = box_distance(*ends, label.low_mm, label.high_mm)
    least = found.at_least_mm + NEEDLE.radius_mm
    return [found.smooth, found.distance_mm - true, least - true, float(boxes) - true]


def main(cases: int) -> None:
    """Print one row a vessel."""
    print(f"{cases} paths each, 1 to 5 mm from the vessel; distance less closed form, mm")
    print(f"{'vessel':21}{'radius':>7}{'voxels':>15}{'smooth':>8}{'RMS':>7}{'90 %':>7}{'most':>7}", end="")
    print(f"{'least: mean':>13}{'highest':>9}{'boxes: lowest':>15}{'highest':>9}")
    for shape, radius, spacing in CASES:
        generator = np.random.default_rng(5)
        smooth, error, least, boxes = np.array([errors(shape, radius, spacing, generator) for _ in range(cases)]).T
        off = np.abs(error)
        voxels = " x ".join(f"{size:g}" for size in spacing)
        print(f"{shape:21}{radius:7.1f}{voxels:>15}{100 * smooth.mean():7.0f}%", end="")
        print(f"{np.sqrt((off**2).mean()):7.3f}{np.quantile(off, 0.9):7.3f}{off.max():7.3f}", end="")
        print(f"{least.mean():13.3f}{least.max():9.3f}{boxes.min():15.3f}{boxes.max():9.3f}", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=60)
    main(parser.parse_args().cases)
