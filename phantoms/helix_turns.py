"""What a helical scanner measures, half a turn at a time: readings, rebinned to parallel rays and filtered."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phantoms.beam import tube_beam
from phantoms.compiled import compiled, parallel_range
from phantoms.cone_rays import Panel, Views, cone_transmission
from phantoms.errors import PhantomError
from phantoms.helix_settings import HelixSettings
from phantoms.kernels import kernel
from phantoms.rays import pack
from phantoms.reconstruction import UPSAMPLING, WaterCorrection, filter_projections
from phantoms.scanner import PHOTONS_PER_MM2, SCAN_RADIUS_MM, matter, scattered
from phantoms.scene import Scene, surface
from phantoms.solids import FloatArray
from phantoms.stack import SliceStack

Readings = NDArray[np.float32]

RAY_MM = 0.45
"""Rays near a small solid are at most this far apart along a detector element's height."""
BOW_TIE_MM = 80.0
"""Radius of the water disc behind which the bow-tie filter evens out the beam."""
WATER_PER_MM = 0.02
"""Attenuation by which the bow-tie filter is shaped."""
MARGIN_MM = 3.0
"""Detector beyond the scene and the images, on either side."""


@dataclass(frozen=True)
class Orbit:
    """The axis of rotation: a place on it, and ``axes`` (3, 3): columns', rows' and its own direction."""

    center_mm: FloatArray
    axes: FloatArray

    @classmethod
    def about(cls, stacks: Sequence[SliceStack]) -> Orbit:
        """Return the axis square to all slices; raises `PhantomError` when there is none."""
        first = stacks[0]
        axes = np.array([first.column_direction, first.row_direction, first.normal])
        center = first.centers_mm[0] - (first.centers_mm[0] @ first.normal) * first.normal
        for stack in stacks:
            aside = (stack.centers_mm - center) @ axes[:2].T
            if np.abs(aside).max() > 1e-6 or not np.allclose(stack.normal, first.normal):
                raise PhantomError("a helix has one axis, square to all slices; scan without gantry tilt")
        return cls(center, axes)

    def heights_mm(self, stack: SliceStack) -> FloatArray:
        """Return the places (K,) of the slices along the axis."""
        return np.asarray(stack.centers_mm @ self.axes[2])


class HalfTurns:
    """Half turn k holds the parallel rays of the directions from k pi to (k + 1) pi; each is made when it is needed.

    A ray at direction ``a`` and distance ``t`` from the axis lies where ``-x sin a + y cos a = t``; the source is on
    the side of ``(cos a, sin a)``. The place of the tube is its angle times the feed of a turn over 2 pi.
    """

    def __init__(
        self, scene: Scene, scanner: HelixSettings, orbit: Orbit, stacks: Sequence[SliceStack], seed: int
    ) -> None:
        self._scanner, self._orbit, self._seed = scanner, orbit, seed
        beam = tube_beam(scanner.kilovolts)
        self._solids, self._matter = pack([part.solid for part in scene.parts]), matter(scene, beam)
        self._water = WaterCorrection(beam)
        self._half_width = _half_width(scene, orbit, stacks) + MARGIN_MM
        if self._half_width > 0.7 * scanner.source_mm:
            raise PhantomError(
                f"the scene is {2 * self._half_width:.0f} mm wide, too wide for the fan; make it smaller"
            )
        shift = 0.25 if scanner.quarter_offset else 0.0
        widest = self._half_width / np.sqrt(1 - (self._half_width / scanner.source_mm) ** 2)
        self._columns = 2 * int(np.ceil(widest / scanner.bin_mm)) + 1
        self._first_u_mm = (shift - (self._columns - 1) / 2) * scanner.bin_mm
        self._spots = 2 if scanner.flying_spot else 1
        self._samples = 2 * int(np.ceil(self._half_width / scanner.bin_mm)) + 1
        self._bin_t_mm = scanner.bin_mm / self._spots
        self._rebinned_first_mm = (shift - (self._samples - 1) / 2) * scanner.bin_mm - self._jump_mm(0)
        self.first_t_mm = self._rebinned_first_mm
        self.step_t_mm = self._bin_t_mm / UPSAMPLING
        self._read: dict[int, Readings] = {}
        self._made: dict[int, Readings] = {}

    def _jump_mm(self, spot: int) -> float:
        """Return how far the detector, scaled to the axis, is shifted against the central ray for one focal spot."""
        return 0.0 if self._spots == 1 else (0.25 - 0.5 * spot) * self._scanner.bin_mm

    def seeing(self, low_mm: float, high_mm: float) -> range:
        """Return the half turns with rays that pass between two places along the axis."""
        scanner = self._scanner
        fan = np.arcsin(self._half_width / scanner.source_mm) / np.pi
        reach = scanner.rows * scanner.row_mm / 2 * (1 + self._half_width / scanner.source_mm) + scanner.row_mm
        if scanner.method != "WFBP":
            reach = scanner.feed_mm + scanner.rows * scanner.row_mm
        first = (low_mm - reach) / (scanner.feed_mm / 2) - fan - 1
        last = (high_mm + reach) / (scanner.feed_mm / 2) + fan
        return range(int(np.floor(first)), int(np.ceil(last)) + 1)

    def stacked(self, part: range) -> Readings:
        """Return the half turns of ``part``: (k, direction, t, row); what lies before them is forgotten."""
        self._made = {k: made for k, made in self._made.items() if k >= part.start}
        self._read = {k: read for k, read in self._read.items() if k >= part.start - 1}
        for k in part:
            if k not in self._made:
                self._made[k] = self._filtered(k)
        return np.stack([self._made[k] for k in part])

    def _filtered(self, k: int) -> Readings:
        """Return half turn ``k`` (direction, t, row), rebinned and filtered."""
        scanner, half = self._scanner, self._scanner.views // 2
        for n in (k - 1, k, k + 1):
            if n not in self._read:
                self._read[n] = self._readings(n)
        around = np.concatenate([self._read[n] for n in (k - 1, k, k + 1)])
        parallel = np.zeros((self._spots, half, scanner.rows, self._samples), dtype=np.float32)
        for spot, one in enumerate(parallel):
            rebin(np.ascontiguousarray(around[spot :: self._spots]), *self._places(spot), self._spots, one)
        rows = np.moveaxis(parallel, 0, -1).reshape(half * scanner.rows, -1)
        filtered = filter_projections(rows, self._bin_t_mm, kernel(scanner.kernel)) * np.float32(scanner.rows)
        filtered = filtered.reshape(half, scanner.rows, -1)
        return np.ascontiguousarray(np.moveaxis(filtered, 1, 2))

    def _places(self, spot: int) -> tuple[FloatArray, FloatArray]:
        """Return for each parallel ray of one focal spot its column and its reading, from a direction's own reading."""
        scanner = self._scanner
        jump = self._jump_mm(spot)
        t = self._rebinned_first_mm + self._jump_mm(0) - jump + np.arange(self._samples) * scanner.bin_mm
        lead = self._lead_mm(spot)
        fan = np.arcsin(t / scanner.source_mm)
        for _ in range(4):
            fan = np.arcsin((t - lead * np.cos(fan)) / scanner.source_mm)
        column = (t / np.cos(fan) + jump - self._first_u_mm) / scanner.bin_mm
        # Readings of this spot start `spot` readings later and are `spots` readings apart.
        reading = (fan / (2 * np.pi) * scanner.views - spot) / self._spots
        return column, reading

    def _lead_mm(self, spot: int) -> float:
        """Return how far the focal spot is moved against the detector's shift, which is the smaller by the lever."""
        lever = (self._scanner.source_mm + self._scanner.detector_mm) / self._scanner.detector_mm
        return -self._jump_mm(spot) * lever

    def _readings(self, k: int) -> Readings:
        """Return the readings (view, column, row) of half a turn of the tube in mm of water."""
        scanner, half = self._scanner, self._scanner.views // 2
        numbers = k * half + np.arange(half)
        signal = np.empty((half, scanner.rows, self._columns), dtype=np.float32)
        panel = Panel(
            scanner.bin_mm,
            scanner.row_mm,
            self._first_u_mm,
            -(scanner.rows - 1) / 2 * scanner.row_mm,
            int(np.ceil(scanner.row_mm / RAY_MM)),
            SCAN_RADIUS_MM,
            *scanner.spot_mm,
        )
        cone_transmission(self._solids, self._matter, panel, self._views(numbers), signal)
        columns = self._first_u_mm + np.arange(self._columns) * scanner.bin_mm
        rows = (np.arange(scanner.rows) - (scanner.rows - 1) / 2) * scanner.row_mm
        for view, number in zip(signal, numbers, strict=True):
            self._as_read(view, int(number), columns)
        slant = np.hypot(scanner.source_mm, columns)
        cosine = slant / np.sqrt(slant**2 + rows[:, np.newaxis] ** 2)
        water_mm = self._water(-np.log(signal.astype(np.float64))) * cosine
        return np.ascontiguousarray(np.moveaxis(water_mm, 1, 2), dtype=np.float32)

    def _views(self, numbers: NDArray[np.int64]) -> Views:
        """Return tube and detector of each reading in LPS mm; the detector lies at the axis."""
        scanner, axes = self._scanner, self._orbit.axes
        turned = 2 * np.pi * numbers / scanner.views
        heights = turned / (2 * np.pi) * scanner.feed_mm
        angles = (turned + np.radians(scanner.start_deg))[:, np.newaxis]
        towards = np.cos(angles) * axes[0] + np.sin(angles) * axes[1]
        across = np.cos(angles) * axes[1] - np.sin(angles) * axes[0]
        spots = numbers % self._spots
        jumps = np.array([self._jump_mm(s) for s in range(self._spots)])[spots, np.newaxis]
        leads = np.array([self._lead_mm(s) for s in range(self._spots)])[spots, np.newaxis]
        axis = self._orbit.center_mm + heights[:, np.newaxis] * axes[2]
        up = np.tile(axes[2], (len(numbers), 1))
        still = Views(axis + scanner.source_mm * towards + leads * across, axis - jumps * across, across, up)
        return scanner.motion.seen(still, scanner.times(heights))

    def _as_read(self, view: Readings, number: int, columns_mm: NDArray[np.floating[Any]]) -> None:
        """Turn what arrives (row, column) into what the detector reads."""
        scanner = self._scanner
        if scanner.scatter:
            view += scattered(view.astype(np.float64), scanner.scatter, scanner.bin_mm).astype(np.float32)
        area = scanner.bin_mm * scanner.row_mm * 720 / scanner.views * scanner.pitch
        quanta = PHOTONS_PER_MM2 * scanner.dose * area * _bow_tie(columns_mm if scanner.bow_tie else None)
        scanner.as_read(view, quanta, self._seed, number + 2**31)
        np.maximum(view, np.float32(1e-10), out=view)


def _bow_tie(columns_mm: NDArray[np.floating[Any]] | None) -> FloatArray:
    """Return what the bow-tie filter lets pass in each column."""
    if columns_mm is None:
        return np.ones(1)
    shorter = BOW_TIE_MM - np.sqrt(np.maximum(BOW_TIE_MM**2 - columns_mm**2, 0.0))
    return np.asarray(np.exp(-2 * WATER_PER_MM * shorter))


def _half_width(scene: Scene, orbit: Orbit, stacks: Sequence[SliceStack]) -> float:
    """Return how far from the axis the images, and what stands at their height, reach."""
    heights = np.concatenate([orbit.heights_mm(stack) for stack in stacks])
    reach = 0.0
    for stack in stacks:
        edges = np.abs(stack.aside_mm) + stack.pixel_mm / 2 * np.array([stack.columns, stack.rows])
        reach = max(reach, float(np.linalg.norm(edges)))
    for part in scene.parts:
        points = (surface(part.solid) - orbit.center_mm) @ orbit.axes.T
        if len(points) == 0:
            return max(reach, SCAN_RADIUS_MM)
        if points[:, 2].min() < heights.max() + 20 and points[:, 2].max() > heights.min() - 20:
            reach = max(reach, float(np.linalg.norm(points[:, :2], axis=1).max()))
    return reach


@compiled(parallel=True)
def rebin(readings: Readings, column: FloatArray, reading: FloatArray, spots: int, parallel: Readings) -> None:
    """Fill ``parallel`` (D, row, T) from three half turns of ``readings`` (view, column, row) by cubic interpolation.

    Ray ``n`` of direction ``d`` lies in column ``column[n]`` of the reading ``d / spots + reading[n]`` after the
    first half turn.
    """
    directions, rows, samples = parallel.shape
    views, columns, _ = readings.shape
    for d in parallel_range(directions):
        line = np.zeros(rows, np.float32)
        for n in range(samples):
            place = views / 3 + d / spots + reading[n]
            first, start = int(np.floor(place)) - 1, int(np.floor(column[n])) - 1
            along, across = cubic(place - first - 1), cubic(column[n] - start - 1)
            line[:] = 0
            for i in range(4):
                for j in range(4):
                    weight = np.float32(along[i] * across[j])
                    line += weight * readings[first + i, min(max(start + j, 0), columns - 1)]
            for row in range(rows):
                parallel[d, row, n] = line[row]


@compiled()
def cubic(x: float) -> tuple[float, float, float, float]:
    """Return the weights of four neighbours for the place ``x`` (0 to 1) between the inner two (Lagrange)."""
    return (
        -x * (x - 1) * (x - 2) / 6,
        (x + 1) * (x - 1) * (x - 2) / 2,
        -(x + 1) * x * (x - 2) / 2,
        (x + 1) * x * (x - 1) / 6,
    )
