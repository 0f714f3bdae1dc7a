"""What each voxel averages of a scene: neither blur nor noise.

Each pixel is sampled by a fine raster of lines along the slice normal; along these, what each slice averages
over its thickness is exact (closed form).
"""

from __future__ import annotations

import numpy as np

from phantoms.compiled import compiled, parallel_range
from phantoms.materials import material
from phantoms.profiles import Profile
from phantoms.rays import PackedSolids, pack, put_unit, put_unit_place, unit_interval, visible_segments
from phantoms.scene import Scene
from phantoms.solids import FloatArray
from phantoms.stack import SliceStack

RASTER_MM = 0.15
"""Finest in-plane distance between sampling lines; keeps a 3 mm ball's centroid within a micrometre."""

PROFILE_STEPS = 512
"""Steps in the table of a slice profile; a Gaussian is then right to a few millionths."""

AIR_HU = -1000.0


def average_hu(scene: Scene, stack: SliceStack, profile: Profile | None = None) -> FloatArray:
    """Return each voxel's average (K, rows, columns) of the materials' nominal HU, without blur and noise.

    ``profile`` is what a slice weighs along its normal; None is a box of the slice thickness.
    """
    profile = profile or Profile("box", stack.thickness_mm)
    areas = profile.cumulative(np.linspace(-profile.reach_mm, profile.reach_mm, PROFILE_STEPS + 1))
    packed = pack([part.solid for part in scene.parts])
    contrasts = np.array([material(part.material).nominal_hu - AIR_HU for part in scene.parts])
    images = np.zeros((len(stack), stack.rows, stack.columns))
    corners = stack.origins_mm
    in_plane = np.column_stack([corners @ stack.column_direction, corners @ stack.row_direction]).round(6)
    for start in np.unique(in_plane, axis=0):
        members = np.flatnonzero((in_plane == start).all(axis=1))
        members = members[np.argsort(stack.positions_mm[members])]
        cube = np.zeros((stack.rows, stack.columns, len(members)))
        _average(
            packed,
            contrasts,
            corners[members[0]],
            stack.column_direction * stack.pixel_mm,
            stack.row_direction * stack.pixel_mm,
            stack.normal,
            stack.positions_mm[members] - stack.positions_mm[members[0]],
            profile.reach_mm,
            areas,
            int(np.ceil(stack.pixel_mm / RASTER_MM)),
            cube,
        )
        images[members] = np.moveaxis(cube, 2, 0)
    return images + AIR_HU


@compiled(parallel=True)
def _average(
    packed: PackedSolids,
    contrasts: FloatArray,
    corner: FloatArray,
    column_step: FloatArray,
    row_step: FloatArray,
    normal: FloatArray,
    positions: FloatArray,
    reach: float,
    areas: FloatArray,
    raster: int,
    cube: FloatArray,
) -> None:
    """Add the average contrast of every voxel to ``cube`` (rows, columns, K); positions ascend from ``corner``."""
    for row in parallel_range(len(cube)):
        _average_row(
            packed,
            contrasts,
            corner + row * row_step,
            column_step,
            row_step,
            normal,
            positions,
            reach,
            areas,
            raster,
            cube[row],
        )


@compiled()
def _average_row(
    packed: PackedSolids,
    contrasts: FloatArray,
    corner: FloatArray,
    column_step: FloatArray,
    row_step: FloatArray,
    normal: FloatArray,
    positions: FloatArray,
    reach: float,
    areas: FloatArray,
    raster: int,
    voxels: FloatArray,
) -> None:
    """Add to the voxels (columns, K) of one image row of every slice."""
    count = len(packed.shapes)
    starts, stops, parts = np.empty(count), np.empty(count), np.empty(count, dtype=np.int64)
    edges, owners = np.empty(2 * count), np.empty(2 * count, dtype=np.int64)
    directions, o = np.empty((count, 3)), np.empty(3)
    for n in range(count):
        put_unit(packed.unit_from_world[n], normal, directions[n])
    lowest, highest = positions[0] - reach, positions[-1] + reach
    for place in range(len(voxels) * raster * raster):
        column, sample = place // (raster * raster), place % (raster * raster)
        v, u = (sample // raster + 0.5) / raster - 0.5, column + (sample % raster + 0.5) / raster - 0.5
        origin = corner + v * row_step + u * column_step
        hits = 0
        for n in range(count):
            if _passes_near(packed.centers_mm[n], packed.radii_mm[n], origin, normal, lowest, highest):
                d = directions[n]
                put_unit_place(packed.unit_from_world[n], origin, o)
                t0, t1 = unit_interval(packed.shapes[n], o[0], o[1], o[2], d[0], d[1], d[2], packed.top_ratios[n])
                if t1 > t0:
                    starts[hits], stops[hits], parts[hits] = t0, t1, n
                    hits += 1
        for s in range(visible_segments(starts, stops, hits, edges, owners)):
            if owners[s] >= 0:
                weight = contrasts[parts[owners[s]]] / (raster * raster)
                _deposit(voxels[column], positions, reach, areas, edges[s], edges[s + 1], weight)


@compiled()
def _passes_near(
    center: FloatArray, radius: float, origin: FloatArray, direction: FloatArray, lowest: float, highest: float
) -> bool:
    """Whether a ray along a unit ``direction`` meets the ball about a solid between ``lowest`` and ``highest``."""
    along, distance = 0.0, 0.0
    for axis in range(3):
        offset = center[axis] - origin[axis]
        along += offset * direction[axis]
        distance += offset * offset
    if along + radius < lowest or along - radius > highest:
        return False
    return distance - along * along <= radius * radius


@compiled()
def _deposit(
    voxels: FloatArray,
    positions: FloatArray,
    reach: float,
    areas: FloatArray,
    start: float,
    stop: float,
    weight: float,
) -> None:
    """Share the segment ``start`` to ``stop`` among the slices that see it; most see nothing else."""
    first, last = np.searchsorted(positions, start - reach), np.searchsorted(positions, stop + reach)
    inside = min(np.searchsorted(positions, start + reach), last)
    beyond = max(np.searchsorted(positions, stop - reach), inside)
    whole = _area(areas, reach, reach) - _area(areas, reach, -reach)
    for k in range(first, last):
        seen = whole
        if not inside <= k < beyond:
            seen = _area(areas, reach, stop - positions[k]) - _area(areas, reach, start - positions[k])
        voxels[k] += weight * seen


@compiled()
def _area(areas: FloatArray, reach: float, offset: float) -> float:
    """Return the area of a profile below ``offset`` from its middle, from a table over ``-reach`` to ``reach``."""
    place = min(max((offset / reach + 1) * 0.5, 0.0), 1.0) * (len(areas) - 1)
    n = min(int(place), len(areas) - 2)
    area: float = areas[n] + (place - n) * (areas[n + 1] - areas[n])
    return area
