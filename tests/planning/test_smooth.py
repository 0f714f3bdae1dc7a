"""The distance to a vessel that is known only as a label map equals the closed form, or says that it is not known."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from phantoms.vessels import SHAPES, Vessel, random_vessel, straight
from ronnaplan.ct import CTVolume, SliceGrid
from ronnaplan.geometry import FloatArray
from ronnaplan.planning import Head, Instrument, Trajectory
from ronnaplan.planning.obstacles import Clearance, Kind, Voxels
from ronnaplan.planning.sampling import SliceSampler
from tests.long import few_or_all

Solid = Callable[[FloatArray], FloatArray]
"""Below zero inside, at LPS places (..., 3)."""

TURN = Rotation.from_euler("xyz", [12, -15, 25], degrees=True).as_matrix()
THIN = Instrument("needle", 0.2, 150.0)


def grid_about(place: FloatArray, kind: str, count: int = 48, voxel_mm: float = 0.5) -> SliceGrid:
    """A stack of ``count`` slices of 0.5 mm voxels about ``place``; "flat": slices twice as far apart."""
    turn = TURN if kind == "oblique" else np.eye(3)
    gap = 2.0 * voxel_mm if kind == "flat" else voxel_mm
    step = gap * turn[:, 2] + (0.4 * voxel_mm * turn[:, 1] if kind == "tilted" else 0.0)
    middle = (count - 1) / 2
    corner = place - middle * (step + voxel_mm * turn[:, 0] + voxel_mm * turn[:, 1])
    origins = corner + np.arange(count)[:, np.newaxis] * step
    return SliceGrid(origins, voxel_mm * turn[:, 1], voxel_mm * turn[:, 0], gap)


def head_on(grid: SliceGrid, count: int = 48) -> Head:
    volume = CTVolume(np.zeros((count, count, count), dtype=np.int16), grid)
    return Head(volume, SliceSampler.of(volume), np.zeros((1, 1, 1), dtype=np.bool_), 1)


def measured(mask: NDArray[np.bool_], head: Head, start: FloatArray, stop: FloatArray) -> Clearance:
    label = Voxels.of(Kind.NO_GO, "vessel", mask, head)
    found = label.clearance(Trajectory("A", start, stop, head.volume.frame, THIN))
    assert found is not None
    return found


def drawn(solid: Solid, head: Head) -> NDArray[np.bool_]:
    index = np.moveaxis(np.indices(head.volume.voxels_hu.shape), 0, -1).astype(np.float64)
    mask: NDArray[np.bool_] = solid(head.volume.grid.positions_mm(index)) < 0
    return mask


def tube(axis: FloatArray, radius: float) -> Solid:
    return lambda p: np.linalg.norm(np.cross(p, axis), axis=-1) - radius


def beside(vessel: Vessel, distance: float, grid: SliceGrid, generator: np.random.Generator) -> Clearance:
    """Draw a vessel and measure a path at a distance from it that is known."""
    way = vessel.path_beside(distance, generator)
    while way is None:
        way = vessel.path_beside(distance, generator)
    head, middle = head_on(grid), distance * vessel.normal
    reach = 7.0 * grid.column_spacing_mm * way
    return measured(drawn(vessel.depth, head), head, middle - reach, middle + reach)


@few_or_all("cases", 1, 5)
@pytest.mark.parametrize("grid", ["even", "flat", "oblique", "tilted"])
@pytest.mark.parametrize("shape", SHAPES)
def test_distance_to_a_vessel_anyhow_in_the_scan_equals_its_closed_form(shape: str, grid: str, cases: int) -> None:
    """Vessels 4 to 10 mm wide in voxels of 0.5 mm (flat: slices 1 mm apart), paths 1 to 5 mm beside them."""
    generator = np.random.default_rng(11)
    for _ in range(cases):
        vessel = random_vessel(shape, generator.uniform(2.0, 5.0), generator)
        distance = generator.uniform(1.0, 5.0)
        found = beside(vessel, distance, grid_about(generator.uniform(-0.5, 0.5, 3), grid), generator)
        assert found.smooth
        assert found.distance_mm == pytest.approx(distance, abs=0.05)
        assert found.clearance_mm == pytest.approx(found.distance_mm - 0.1, abs=1e-12)
        assert distance - 0.2 < found.at_least_mm + 0.1 <= distance


@few_or_all("cases", 8, 16)
@pytest.mark.parametrize("voxel_mm", [0.5, 1.0])
def test_at_least_is_never_above_the_true_distance(voxel_mm: float, cases: int) -> None:
    """Where voxels are too coarse, the vessel thin, or along a grid axis, so that the wall is not told, too."""
    generator = np.random.default_rng(12)
    for n in range(cases):
        radius, distance = generator.uniform(0.8, 4.0), generator.uniform(1.0, 5.0)
        axis = np.eye(3)[n % 3]
        vessel = (
            straight(radius, axis, generator) if n % 4 == 3 else random_vessel(SHAPES[n % 4], radius, generator)
        )
        grid = grid_about(generator.uniform(-0.5, 0.5, 3) * voxel_mm, "even", voxel_mm=voxel_mm)
        assert beside(vessel, distance, grid, generator).at_least_mm + 0.1 <= distance


def test_the_distance_follows_grid_and_path_when_both_are_moved() -> None:
    solid = tube(np.array([0.6, 0.48, 0.64]), 1.6)
    here = head_on(grid_about(np.zeros(3), "even"))
    mask = drawn(solid, here)
    start, stop = np.array([-20.0, -3.0, 4.0]), np.array([20.0, -2.0, 5.0])
    shift = np.array([4.0, -70.0, 31.0])
    grid = here.volume.grid
    moved = SliceGrid(grid.origins_mm @ TURN.T + shift, TURN @ grid.row_step_mm, TURN @ grid.column_step_mm, 0.5)
    first = measured(mask, here, start, stop)
    second = measured(mask, head_on(moved), TURN @ start + shift, TURN @ stop + shift)
    assert first.smooth
    assert second.distance_mm == pytest.approx(first.distance_mm, abs=2e-3)
    assert second.at_least_mm == pytest.approx(first.at_least_mm, abs=2e-3)
    assert second.depth_mm == pytest.approx(first.depth_mm, abs=0.2)


def blocks() -> dict[str, tuple[slice, slice, slice]]:
    one = slice(24, 25)
    return {
        "a single voxel": (one, one, one),
        "a row of voxels": (one, one, slice(10, 38)),
        "a box": (slice(20, 29), slice(18, 31), slice(15, 33)),
        "a label that the grid cuts": (slice(0, 48), slice(20, 25), slice(20, 25)),
    }


@pytest.mark.parametrize("what", blocks())
def test_where_no_smooth_surface_is_known_the_voxels_count_and_the_next_center_is_the_bound(what: str) -> None:
    """A path beside a face: exact to the voxels, and half a voxel nearer is what the label does not exclude."""
    mask = np.zeros((48, 48, 48), dtype=np.bool_)
    mask[blocks()[what]] = True
    head = head_on(grid_about(np.zeros(3), "even"))
    _, j, i = np.argwhere(mask).max(axis=0)
    k = 46 if "cuts" in what else 24
    face = head.volume.grid.positions_mm(np.array([k, 24.0, i])) + np.array([3.25, 0, 0])
    face[1] = head.volume.grid.positions_mm(np.array([0.0, j, 0.0]))[1] - 0.1
    found = measured(mask, head, face - np.array([0, 1.0, 0]), face + np.array([0, 1.0, 0]))
    assert not found.smooth
    assert found.distance_mm == pytest.approx(3.0, abs=1e-6)
    assert found.at_least_mm == pytest.approx(3.0 - 0.25 - 0.1, abs=1e-6)


def test_of_two_vessels_the_nearer_counts_and_a_path_through_one_meets_it() -> None:
    axis = np.array([0.0, 0.6, 0.8])
    near, far = tube(axis, 1.6), tube(axis, 1.6)
    head = head_on(grid_about(np.zeros(3), "oblique"))
    mask = drawn(lambda p: np.minimum(near(p - [-3.4, 0, 0]), far(p - [3.6, 0, 0])), head)
    way = np.cross(axis, [1.0, 0, 0])
    between = measured(mask, head, -30 * way, 30 * way)
    assert between.distance_mm == pytest.approx(3.4 - 1.6, abs=0.05)
    through = measured(mask, head, -30 * way + [3.6, 0, 0], 30 * way + [3.6, 0, 0])
    assert through.distance_mm == 0.0
    assert through.crosses


def test_a_path_beside_a_vessel_all_along_it_keeps_its_distance() -> None:
    axis = np.array([0.48, 0.6, 0.64])
    head = head_on(grid_about(np.zeros(3), "even"))
    aside = 5.0 * np.cross(axis, [0.0, 0, 1.0]) / np.hypot(0.48, 0.6)
    found = measured(drawn(tube(axis, 1.6), head), head, aside - 5 * axis, aside + 5 * axis)
    assert found.smooth
    assert found.distance_mm == pytest.approx(3.4, abs=0.05)
