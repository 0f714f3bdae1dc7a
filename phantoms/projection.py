"""Transmission of a polychromatic parallel beam through a scene, by exact path lengths."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from phantoms.compiled import compiled, parallel_range
from phantoms.rays import PackedSolids, to_unit, unit_interval, visible_segments
from phantoms.solids import FloatArray, Shape

IntArray = NDArray[np.int64]

_BALL = int(Shape.BALL)
THIN_RAY = 20.0
"""A ball this many times larger than a ray's height is crossed by a line; a smaller one is averaged exactly."""


class Matter(NamedTuple):
    """What the beam meets: each solid's row of ``attenuation`` (M, B) per mm, and the beam's ``weights`` (B,).

    ``fine`` (N,) tells which solids are looked at closely where the sampling of rays can vary.
    """

    material_of: IntArray
    attenuation: FloatArray
    weights: FloatArray
    fine: NDArray[np.bool_]


class Detector(NamedTuple):
    """Elements ``bin_mm`` wide and ``row_mm`` high, each sampled by ``samples`` squared rays.

    Only what lies within ``bore_mm`` of the plane's center is seen.
    """

    bin_mm: float
    row_mm: float
    samples: int
    bore_mm: float


class _Crossings(NamedTuple):
    """The intervals of all rays of one view at one height: ray ``r`` has ``counts[r]`` of them."""

    counts: IntArray
    starts_mm: FloatArray
    """(rays, solids)"""
    stops_mm: FloatArray
    solids: IntArray


@compiled(parallel=True)
def transmission(
    solids: PackedSolids,
    matter: Matter,
    detector: Detector,
    planes: FloatArray,
    axes: FloatArray,
    angles: FloatArray,
    signal: NDArray[np.float32],
) -> None:
    """Fill ``signal`` (R, V, U) with the fraction of the beam that arrives.

    ``planes`` (R, V, 3) are the centers of the detector rows' planes in each view; the rows of ``axes`` (R, V, 3, 3)
    are the column, row and normal directions. Over one element intensities, not logarithms, are averaged, as in a
    real detector.
    """
    rows, views, _ = signal.shape
    for job in parallel_range(rows * views):
        row, view = job // views, job % views
        _measure_view(
            solids, matter, detector, planes[row, view], axes[row, view], angles[view], signal[row, view]
        )


@compiled()
def _measure_view(
    solids: PackedSolids,
    matter: Matter,
    detector: Detector,
    plane: FloatArray,
    axes: FloatArray,
    angle: float,
    signal: NDArray[np.float32],
) -> None:
    """Fill one view (U,) of one detector row."""
    view = np.empty((3, 3))
    view[0] = np.cos(angle) * axes[0] + np.sin(angle) * axes[1]
    view[1] = np.cos(angle) * axes[1] - np.sin(angle) * axes[0]
    view[2] = axes[2]
    samples = detector.samples
    rays, parts = len(signal) * samples, len(matter.material_of)
    crossings = _Crossings(
        np.empty(rays, np.int64),
        np.empty((rays, parts)),
        np.empty((rays, parts)),
        np.empty((rays, parts), np.int64),
    )
    arriving = np.zeros(rays)
    for sample in range(samples):
        height = ((sample + 0.5) / samples - 0.5) * detector.row_mm
        crossings.counts[:] = 0
        for n in range(parts):
            _cross(solids, n, detector, plane + height * axes[2], view, crossings)
        _add_arriving(matter, crossings, arriving)
    for u in range(len(signal)):
        signal[u] = arriving[u * samples : (u + 1) * samples].sum() / samples**2


@compiled()
def _cross(
    solids: PackedSolids, n: int, detector: Detector, plane: FloatArray, view: FloatArray, crossings: _Crossings
) -> None:
    """Add one solid's interval to every ray that it may shadow; the rows of ``view`` are across, along, normal."""
    offset = solids.centers_mm[n] - plane
    aside, above = np.sum(offset * view[0]), np.sum(offset * view[2])
    half_height = 0.5 * detector.row_mm / detector.samples
    height = max(0.0, abs(above) - half_height)
    if height >= solids.radii_mm[n]:
        return
    reach = np.sqrt(solids.radii_mm[n] ** 2 - height * height)
    spacing, rays = detector.bin_mm / detector.samples, len(crossings.counts)
    first = max(0.0, np.ceil((aside - reach) / spacing + (rays - 1) / 2))
    last = min(rays - 1.0, np.floor((aside + reach) / spacing + (rays - 1) / 2))
    affine = solids.unit_from_world[n]
    a, d, m = to_unit(affine, view[0]), to_unit(affine, view[1]), to_unit(affine, view[2])
    o = to_unit(affine, plane) + affine[:, 3]
    shape, ratio = solids.shapes[n], solids.top_ratios[n]
    for ray in range(int(first), int(last) + 1):
        place = (ray - (rays - 1) / 2) * spacing
        ox, oy, oz = o[0] + place * a[0], o[1] + place * a[1], o[2] + place * a[2]
        if shape == _BALL:
            t0, t1 = _ball_interval(ox, oy, oz, d[0], d[1], d[2], m[0], m[1], m[2], half_height)
        else:
            t0, t1 = unit_interval(shape, ox, oy, oz, d[0], d[1], d[2], ratio)
        limit = np.sqrt(max(0.0, detector.bore_mm**2 - place * place))
        t0, t1 = max(t0, -limit), min(t1, limit)
        if t1 > t0:
            k = crossings.counts[ray]
            crossings.starts_mm[ray, k] = t0
            crossings.stops_mm[ray, k] = t1
            crossings.solids[ray, k] = n
            crossings.counts[ray] += 1


@compiled()
def _ball_interval(
    ox: float,
    oy: float,
    oz: float,
    dx: float,
    dy: float,
    dz: float,
    mx: float,
    my: float,
    mz: float,
    half_height: float,
) -> tuple[float, float]:
    """Return the interval of a flat ray, ``half_height`` to either side along ``m``, inside the unit ball.

    The half chord at height z is sqrt(q(z)) / a with q(z) = (S^2 - (z - z0)^2) A, so its average is closed-form.
    """
    a = dx * dx + dy * dy + dz * dz
    b0 = ox * dx + oy * dy + oz * dz
    b1 = mx * dx + my * dy + mz * dz
    c1 = ox * mx + oy * my + oz * mz
    curvature = a * (mx * mx + my * my + mz * mz) - b1 * b1
    center = (b0 * b1 - a * c1) / curvature
    at_zero = b0 * b0 - a * (ox * ox + oy * oy + oz * oz - 1)
    peak = at_zero + curvature * center * center
    if peak <= 0:
        return 1.0, 0.0
    reach = np.sqrt(peak / curvature)
    low, high = max(-half_height, center - reach), min(half_height, center + reach)
    if low >= high:
        return 1.0, 0.0
    if reach > THIN_RAY * half_height and abs(center) < 0.7 * reach:
        half = np.sqrt(at_zero) / a
        return -b0 / a - half, -b0 / a + half
    area = _under_circle(high - center, reach) - _under_circle(low - center, reach)
    half = np.sqrt(curvature) * area / (2 * half_height * a)
    middle = -(b0 + b1 * 0.5 * (low + high)) / a
    return middle - half, middle + half


@compiled()
def _under_circle(x: float, radius: float) -> float:
    """Integral of ``sqrt(radius^2 - x^2)`` from 0 to ``x``."""
    ratio = min(1.0, max(-1.0, x / radius))
    area: float = 0.5 * radius * radius * (ratio * np.sqrt(1 - ratio * ratio) + np.arcsin(ratio))
    return area


@compiled()
def _add_arriving(matter: Matter, crossings: _Crossings, arriving: FloatArray) -> None:
    """Add to ``arriving`` (rays,) the fraction of the beam that passes what each ray crosses."""
    parts, (materials, energies) = len(matter.material_of), matter.attenuation.shape
    edges, owners = np.empty(2 * parts), np.empty(2 * parts, np.int64)
    lengths, touched, depths = np.zeros(materials), np.empty(materials, np.int64), np.empty(energies)
    material_of, attenuation, weights = matter.material_of, matter.attenuation, matter.weights
    for ray in range(len(arriving)):
        count = crossings.counts[ray]
        if count == 0:
            arriving[ray] += 1.0
            continue
        kinds = 0
        for s in range(visible_segments(crossings.starts_mm[ray], crossings.stops_mm[ray], count, edges, owners)):
            if owners[s] >= 0 and edges[s + 1] > edges[s]:
                kind = material_of[crossings.solids[ray, owners[s]]]
                if lengths[kind] == 0.0:
                    touched[kinds] = kind
                    kinds += 1
                lengths[kind] += edges[s + 1] - edges[s]
        depths[:] = 0.0
        for n in range(kinds):
            kind = touched[n]
            for b in range(energies):
                depths[b] += attenuation[kind, b] * lengths[kind]
            lengths[kind] = 0.0
        for b in range(energies):
            arriving[ray] += weights[b] * exp_minus(depths[b])


@compiled()
def exp_minus(depth: float) -> float:
    """Return ``exp(-depth)`` to 1e-7 or better, in a form that the compiler turns into vector instructions."""
    x = min(depth, 700.0) / 1024
    y: float = 1 - x * (1 - x * (0.5 - x * (1 / 6 - x / 24)))
    for _ in range(10):
        y *= y
    result: float = y
    return result
