"""Planning: candidate paths a second against a plain NumPy ray loop, and marker placement against other spreads.

    python -m benchmarks.planning [speed|placement] [--cases N]

The placement part draws random heads, targets,
entries and tracker sides; its expected errors are confirmed by simulated scans and readings that go through
`match_points` and `register_points`.
"""

from __future__ import annotations

import argparse
import os
import time

import numpy as np
from scipy.ndimage import map_coordinates
from scipy.spatial.transform import Rotation

from phantoms.anatomy import SCALP_SEMI_AXES_MM, head
from phantoms.fast import render
from phantoms.stack import axial_stack
from ronnaplan.correspondence import match_points
from ronnaplan.ct import CTVolume, SliceGrid
from ronnaplan.geometry import FloatArray
from ronnaplan.planning import Head, Limits, place_markers, propose
from ronnaplan.planning.candidates import Field, cast, spread_directions
from ronnaplan.planning.layers import STEP_MM
from ronnaplan.planning.obstacles import metal
from ronnaplan.planning.placement import expected_tre_mm, scattered_layout
from ronnaplan.planning.sites import PlacementRules, Sites, allowed_sites, even_layout, surface_sites
from ronnaplan.registration import register_points

SPEED_PATHS = 20_000
LOOP_PATHS = 300
REGISTRATIONS = 200


def scanned_head() -> Head:
    """A head of 512 x 512 x 180 voxels."""
    stack = axial_stack(start_mm=-70, stop_mm=109, spacing_mm=1.0, matrix=512, field_of_view_mm=250.0)
    images = render(head(), stack, seed=3)
    grid = SliceGrid(
        stack.origins_mm, stack.row_direction * stack.pixel_mm, stack.column_direction * stack.pixel_mm, 1.0
    )
    return Head.of(CTVolume(images, grid))


def speed() -> None:
    """Print candidate paths a second: compiled on all cores, and one at a time with NumPy and SciPy."""
    ready = scanned_head()
    target, outward = np.array([15.0, -10.0, 25.0]), spread_directions(SPEED_PATHS)
    field = Field.of([metal(ready)], ready)
    cast(ready, target, outward[:64], field)
    start = time.perf_counter()
    cast(ready, target, outward, field)
    compiled = SPEED_PATHS / (time.perf_counter() - start)
    start = time.perf_counter()
    found = propose(target, ready, Limits(greatest_skull_angle_deg=30.0), obstacles=[metal(ready)])
    whole = time.perf_counter() - start
    start = time.perf_counter()
    for direction in outward[:: SPEED_PATHS // LOOP_PATHS]:
        _plain_path(ready, target, direction)
    plain = LOOP_PATHS / (time.perf_counter() - start)
    print(f"{os.cpu_count()} cores; 512 x 512 x 180 voxels, steps of {STEP_MM} mm")
    print(f"{'':34}{'paths a second':>16}{'ratio':>8}")
    print(f"{'ronnaplan (scalp, skull, angle, ..)':34}{compiled:16.0f}{compiled / plain:8.1f}")
    print(f"{'NumPy ray loop (scalp, skull)':34}{plain:16.0f}{1.0:8.1f}")
    print(f"{SPEED_PATHS} ways scored and {len(found.best)} entries proposed and measured in {whole:.2f} s")


def _plain_path(ready: Head, target: FloatArray, direction: FloatArray) -> tuple[float, float, float]:
    """The same search for scalp, outer and inner table, with SciPy's interpolation and NumPy's searches."""
    reach = np.arange(0.0, 150.0, STEP_MM)
    index = ready.volume.grid.indices(target + reach[:, np.newaxis] * direction)
    values = map_coordinates(ready.volume.voxels_hu, index.T, output=np.float64, order=1, cval=-1024.0)
    tissue, bone = np.flatnonzero(values > -450.0), np.flatnonzero(values > 300.0)
    scalp = float(reach[tissue[-1]]) if tissue.size else np.nan
    return scalp, float(reach[bone[-1]]) if bone.size else np.nan, float(reach[bone[0]]) if bone.size else np.nan


def placement(cases: int) -> None:
    """Print by how much placement lowers the largest expected TRE, and that the expectation is met."""
    generator = np.random.default_rng(2024)
    gains: dict[str, list[float]] = {"even (Fibonacci)": [], "farthest points": [], "random": []}
    met: dict[str, list[float]] = {"placed": [], "even": []}
    refused = {"placed": 0, "even": 0}
    seconds: list[float] = []
    while len(seconds) < cases:
        sites, targets, entries, rules, count = _case(generator)
        allowed = allowed_sites(sites, rules, entries)
        centers = allowed.centers_mm(rules.height_mm)
        scattered = [scattered_layout(centers, count, rules.least_apart_mm, generator) for _ in range(20)]
        if any(one is None for one in scattered):
            continue
        start = time.perf_counter()
        placed = place_markers(sites, targets, count, rules, entries)
        seconds.append(time.perf_counter() - start)
        random = np.mean([_largest(centers[one], targets, rules) for one in scattered if one is not None])
        far = _largest(centers[_farthest(centers, count)], targets, rules)
        for name, other in (
            ("even (Fibonacci)", placed.even_tre_mm),
            ("farthest points", far),
            ("random", random),
        ):
            gains[name].append(100.0 * (1.0 - placed.largest_tre_mm / float(other)))
        even = centers[even_layout(allowed, count, generator)]
        for name, markers in (("placed", placed.centers_mm), ("even", even)):
            ratio, lost = _met(markers, targets, rules, generator)
            met[name].append(ratio)
            refused[name] += lost
    print(f"{cases} random cases: 4 to 8 markers, 1 to 4 targets; {np.mean(seconds):.2f} s a placement")
    print(f"{'largest expected TRE lower than':34}{'mean %':>8}{'median':>8}{'least':>8}{'most':>8}")
    for name, gain in gains.items():
        numbers = (np.mean(gain), np.median(gain), np.min(gain), np.max(gain))
        print(f"{name:34}" + "".join(f"{number:8.1f}" for number in numbers))
    print(f"simulated error over expected error, {REGISTRATIONS} registrations a case (1 is exact)")
    for name, ratios in met.items():
        spread = (np.mean(ratios), np.std(ratios))
        print(f"{name:34}{spread[0]:8.3f} +- {spread[1]:.3f}; {refused[name]} of {cases * REGISTRATIONS} refused")


def _case(generator: np.random.Generator) -> tuple[Sites, FloatArray, FloatArray, PlacementRules, int]:
    """A head's scalp, targets in the brain, entries above them, and a tracker on some side."""
    axes = np.array(SCALP_SEMI_AXES_MM) * generator.uniform(0.88, 1.05, 3)
    directions = spread_directions(3000)
    points = directions / np.linalg.norm(directions / axes, axis=1, keepdims=True)
    sites = surface_sites(points[points[:, 2] > -20.0], np.zeros(3))
    count = int(generator.integers(1, 5))
    targets = generator.uniform([-40.0, -50.0, -15.0], [40.0, 50.0, 50.0], (count, 3))
    ways = generator.normal(size=(count, 3)) * [1, 1, 0.5] + [0, 0, 1.0]
    entries = np.array([_entry(target, way, axes) for target, way in zip(targets, ways, strict=True)])
    around = generator.uniform(0.0, 2.0 * np.pi)
    rules = PlacementRules(tracker=(float(np.cos(around)), float(np.sin(around)), 0.5), visible_deg=75.0)
    return sites, targets, entries, rules, int(generator.integers(4, 9))


def _entry(target: FloatArray, way: FloatArray, axes: FloatArray) -> FloatArray:
    p, d = target / axes, way / axes
    reach = (-(p @ d) + np.sqrt((p @ d) ** 2 - (d @ d) * (p @ p - 1.0))) / (d @ d)
    entry: FloatArray = target + reach * way
    return entry


def _largest(markers: FloatArray, targets: FloatArray, rules: PlacementRules) -> float:
    return float(expected_tre_mm(markers, targets, rules).max())


def _farthest(centers: FloatArray, count: int) -> list[int]:
    """Each in turn as far from the others as can be: spreads to the rim, harder to beat than an even lattice."""
    chosen = [int(np.linalg.norm(centers - centers.mean(axis=0), axis=1).argmax())]
    while len(chosen) < count:
        nearest = np.linalg.norm(centers[:, np.newaxis] - centers[chosen], axis=-1).min(axis=1)
        chosen.append(int(nearest.argmax()))
    return chosen


def _met(
    markers: FloatArray, targets: FloatArray, rules: PlacementRules, generator: np.random.Generator
) -> tuple[float, int]:
    """Return simulated over expected error at the worst target, and how many pairings were refused."""
    expected = expected_tre_mm(markers, targets, rules)
    worst = targets[expected.argmax()]
    squares, refused = [], 0
    for _ in range(REGISTRATIONS):
        turn, shift = Rotation.random(rng=generator).as_matrix(), generator.uniform(-500.0, 500.0, 3)
        ct = markers + rules.sigma_ct_mm * generator.standard_normal(markers.shape)
        order = generator.permutation(len(markers))
        ots = (markers @ turn.T + shift)[order] + rules.sigma_ots_mm * generator.standard_normal(markers.shape)
        pairing = match_points(ct, ots, expected=len(markers))
        if pairing.status != "unique":
            refused += 1
            continue
        found = register_points(ct[pairing.pairs[:, 0]], ots[pairing.pairs[:, 1]])
        error = found.transform[:3, :3] @ worst + found.transform[:3, 3] - turn @ worst - shift
        squares.append(float(error @ error))
    return float(np.sqrt(np.mean(squares)) / expected.max()), refused


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("part", nargs="?", choices=("speed", "placement"))
    parser.add_argument("--cases", type=int, default=100)
    options = parser.parse_args()
    if options.part != "placement":
        speed()
    if options.part != "speed":
        placement(options.cases)
