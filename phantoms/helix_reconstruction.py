"""Back-projection of helical scans: filtered parallel rays of half turns become voxels."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from phantoms.compiled import compiled, parallel_range
from phantoms.solids import FloatArray

FULL_WEIGHT = 0.7
"""Part of the detector's height, from its middle, whose rays count in full; farther out they count less and less."""


class Geometry(NamedTuple):
    """Lengths in mm at the axis of rotation; samples of a direction lie at ``first_t + n step_t``."""

    source_mm: float
    feed_mm: float
    row_mm: float
    first_t_mm: float
    step_t_mm: float
    start_rad: float


class _Ray(NamedTuple):
    """The ray of one half turn through a line of voxels: where its samples and its source are."""

    sample: float
    height_mm: float
    """Of the source."""
    cosine: float
    """Of its angle to the central ray."""
    along_mm: float
    """How far the voxels are from the axis towards the source."""


@compiled()
def _ray(geometry: Geometry, k: int, angle: float, t: float, along: float) -> _Ray:
    """Return the ray of direction ``angle`` (0 to pi) of half turn ``k``; odd half turns see it from the other side."""
    sign = 1.0 if k % 2 == 0 else -1.0
    sine = sign * t / geometry.source_mm
    turned = k * np.pi + angle + np.arcsin(sine)
    return _Ray(
        (sign * t - geometry.first_t_mm) / geometry.step_t_mm,
        geometry.feed_mm * turned / (2 * np.pi),
        np.sqrt(1 - sine * sine),
        sign * along,
    )


@compiled(parallel=True)
def back_project_cone_weighted(
    data: NDArray[np.float32],
    first: int,
    geometry: Geometry,
    heights: FloatArray,
    corner: FloatArray,
    pixel_mm: float,
    cube: NDArray[np.float32],
) -> None:
    """Fill ``cube`` (rows, columns, Z) at the ascending ``heights`` (Z,) by weighted filtered back-projection.

    ``data`` (K, D, T, R) are half turns from ``first`` on. Of all rays of one direction (and its opposite) through a
    voxel the mean is taken, weighed by how near they are to the detector's middle row (Stierstorfer et al., Phys Med
    Biol 49:2209, 2004, Eqs. 16 to 20; a cubic falls off where they use a squared cosine).
    """
    lines, columns, planes = cube.shape
    turns, directions, samples, rows = data.shape
    for job in parallel_range(lines * columns):
        x, y = corner[0] + (job % columns) * pixel_mm, corner[1] + (job // columns) * pixel_mm
        total, part, weights = np.zeros(planes), np.zeros(planes), np.zeros(planes)
        line = np.empty(rows, np.float32)
        for d in range(directions):
            angle = np.pi * d / directions
            c, s = np.cos(angle + geometry.start_rad), np.sin(angle + geometry.start_rad)
            part[:] = 0.0
            weights[:] = 0.0
            for n in range(turns):
                ray = _ray(geometry, first + n, angle, y * c - x * s, x * c + y * s)
                i = int(np.floor(ray.sample))
                if not 0 <= i < samples - 1:
                    continue
                source = geometry.source_mm
                scale = source / ray.cosine / (source * ray.cosine - ray.along_mm) / geometry.row_mm
                low = np.searchsorted(heights, ray.height_mm - 0.5 * rows / scale)
                high = np.searchsorted(heights, ray.height_mm + 0.5 * rows / scale)
                if low == high:
                    continue
                share = np.float32(ray.sample - i)
                before, after = data[n, d, i], data[n, d, i + 1]
                for r in range(rows):
                    line[r] = before[r] + share * (after[r] - before[r])
                for z in range(low, high):
                    q = (heights[z] - ray.height_mm) * scale
                    x1 = min((1 - abs(q) / (0.5 * rows)) / (1 - FULL_WEIGHT), 1.0)
                    weight = x1 * x1 * (3 - 2 * x1)
                    place = min(max(q + 0.5 * (rows - 1), 0.0), rows - 1.000001)
                    r = int(place)
                    part[z] += weight * (line[r] + (place - r) * (line[r + 1] - line[r]))
                    weights[z] += weight
            for z in range(planes):
                total[z] += part[z] / max(weights[z], 1e-9)
        for z in range(planes):
            cube[job // columns, job % columns, z] = total[z]


@compiled(parallel=True)
def back_project_interpolated(
    data: NDArray[np.float32],
    first: int,
    geometry: Geometry,
    whole_turns: bool,
    heights: FloatArray,
    corner: FloatArray,
    pixel_mm: float,
    cube: NDArray[np.float32],
) -> None:
    """Fill ``cube`` (rows, columns, Z) at the ascending ``heights`` (Z,) by linear interpolation along the axis.

    Every row is taken to measure the plane in which it meets the axis. Of each direction the nearest sample on
    either side of a slice counts, out of those of whole turns (360LI), or also of the opposite rays (180LI; Kalender
    & Polacin, Med Phys 18:910, 1991; for several rows Hu, Med Phys 26:5, 1999).
    """
    lines, columns, _ = cube.shape
    turns, directions, samples, rows = data.shape
    sides = 2 if whole_turns else 1
    for job in parallel_range(lines * columns):
        x, y = corner[0] + (job % columns) * pixel_mm, corner[1] + (job // columns) * pixel_mm
        places, values = np.empty(turns * rows), np.empty(turns * rows)
        for d in range(directions):
            angle = np.pi * d / directions
            c, s = np.cos(angle + geometry.start_rad), np.sin(angle + geometry.start_rad)
            for side in range(sides):
                count = 0
                for n in range(turns):
                    if whole_turns and n % 2 != side:
                        continue
                    ray = _ray(geometry, first + n, angle, y * c - x * s, x * c + y * s)
                    i = int(np.floor(ray.sample))
                    if not 0 <= i < samples - 1:
                        continue
                    share = ray.sample - i
                    for r in range(rows):
                        height = ray.height_mm + (r - 0.5 * (rows - 1)) * geometry.row_mm * ray.cosine**2
                        value = data[n, d, i, r] + share * (data[n, d, i + 1, r] - data[n, d, i, r])
                        _insert(places, values, count, height, value)
                        count += 1
                _add_interpolated(places, values, count, heights, sides, cube[job // columns, job % columns])


@compiled()
def _insert(places: FloatArray, values: FloatArray, count: int, place: float, value: float) -> None:
    """Keep the samples in ascending order of their places."""
    n = count
    while n > 0 and places[n - 1] > place:
        places[n], values[n] = places[n - 1], values[n - 1]
        n -= 1
    places[n], values[n] = place, value


@compiled()
def _add_interpolated(
    places: FloatArray,
    values: FloatArray,
    count: int,
    heights: FloatArray,
    sides: int,
    line: NDArray[np.float32],
) -> None:
    """Add to ``line`` (Z,) what lies between the samples at each of the ``heights``."""
    n = 0
    for z in range(len(heights)):
        while n < count - 2 and places[n + 1] <= heights[z]:
            n += 1
        gap = places[n + 1] - places[n]
        share = (heights[z] - places[n]) / gap if gap > 1e-9 else 0.5
        line[z] += np.float32((values[n] + share * (values[n + 1] - values[n])) / sides)
