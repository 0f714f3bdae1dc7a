"""The scanner: detector rows are measured, corrected, combined to slices and reconstructed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from tqdm import tqdm

from phantoms.attenuation import Matter
from phantoms.beam import Beam, tube_beam
from phantoms.errors import PhantomError
from phantoms.kernels import kernel
from phantoms.machine import Images, Machine
from phantoms.materials import material
from phantoms.motion import Span
from phantoms.projection import Detector, transmission
from phantoms.rays import pack
from phantoms.reconstruction import UPSAMPLING, WaterCorrection, back_project, filter_projections
from phantoms.scene import Scene
from phantoms.solids import FloatArray, Vector
from phantoms.stack import SliceStack

SCAN_RADIUS_MM = 350.0
"""Half the bore: what lies farther from the middle of a slice is not seen."""
TALLEST_ROW_MM = 0.65
"""Detector rows are at most this high at the center of rotation; thicker slices combine several rows."""
PHOTONS_PER_MM2 = 1.0e6
"""Quanta per mm2 of detector and view at dose 1 and 720 views; see `docs/phantoms.md` for the noise it gives."""
SCATTER_WIDTH_MM = 60.0
"""Standard deviation of the scatter kernel along the detector."""
FINE_MM, NEAR_MM, DENSE_G_CM3 = 25.0, 20.0, 2.6
"""Parts within a ball of this radius are looked at closely if so near to a marker or decoy, or so dense (metal)."""
TURN_MM = 20.0
"""What one turn measures along the table; all rows of it at the same time."""
SAME_PLACE_MM = 1e-6
"""Slices whose centers differ by less lie in one plane."""


@dataclass(frozen=True)
class Scanner(Machine):
    """An axial scanner: detector rows in the slices' own planes, parallel rays."""

    views: int = 720
    bin_mm: float = 0.5
    one_row: bool = False
    """Slices are one detector row each, as tall as they are: what it receives is summed before the logarithm."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self._check(
            ("number of views", self.views, self.views >= 16, "16 or more"),
            ("detector element in mm", self.bin_mm, 0.05 <= self.bin_mm <= 5, "0.05 to 5"),
        )

    def times(self, position_mm: float) -> FloatArray:
        """Return when each view (V,) of a row at a place along the normal is measured: turn after turn."""
        turn, turns = self._turn(position_mm)
        return (turn + np.arange(self.views) / self.views) / turns

    def seen_during(self, place_mm: Vector, radius_mm: float, stack: SliceStack) -> Span:
        """Return from when to when, in parts of the scan, a ball in the scene is in the beam."""
        position = float(np.asarray(place_mm) @ stack.normal)
        (first, turns), (last, _) = self._turn(position - radius_mm), self._turn(position + radius_mm)
        return first / turns, (last + 1) / turns

    def _turn(self, position_mm: float) -> tuple[int, int]:
        """Return in which turn a place along the normal is measured, and how many turns there are."""
        low, high = self.scanned_mm
        turns = max(1, round((high - low) / TURN_MM))
        return int(np.clip((position_mm - low) / max(high - low, 1e-9) * turns, 0, turns - 1)), turns

    def reconstruct(
        self, scene: Scene, stacks: Sequence[SliceStack], *, seed: int = 0, progress: bool = False
    ) -> list[Images]:
        """Return the images of each stack; those of one plane come from one measurement."""
        scene.check()
        if len({(s.thickness_mm, s.tilt_deg, *s.normal) for s in stacks}) != 1:
            raise PhantomError(
                "the slices to be scanned together differ in thickness or direction; scan them apart"
            )
        results = [np.zeros((len(s), s.rows, s.columns), dtype=np.float32) for s in stacks]
        longest = max(stacks, key=len)
        count = rows_per_slice(longest)
        whole = replace(longest, centers_mm=_planes(stacks))
        measurement = _Measurement(scene, stacks, longest.thickness_mm / count, self, seed)
        shape = kernel(self.kernel)
        first_mm, step_mm = -(measurement.bins - 1) / 2 * self.bin_mm, self.bin_mm / UPSAMPLING
        planned = zip(whole.centers_mm, _plan_rows(whole, count), strict=True)
        for center, plan in tqdm(planned, "scanning", len(whole), unit="slice", disable=not progress):
            filtered = filter_projections(measurement.combined(plan), self.bin_mm, shape)
            for stack, images in zip(stacks, results, strict=True):
                for k in np.flatnonzero(np.abs(stack.centers_mm - center).max(axis=1) < SAME_PLACE_MM):
                    back_project(
                        filtered, measurement.angles, first_mm, step_mm, stack.aside_mm, stack.pixel_mm, images[k]
                    )
        return [1000 * (images - 1) for images in results]


def _planes(stacks: Sequence[SliceStack]) -> FloatArray:
    """Return the centers (K, 3) of all slices, each plane once, in ascending order along the normal."""
    centers = np.concatenate([stack.centers_mm for stack in stacks])
    _, kept = np.unique(np.round(centers / SAME_PLACE_MM).astype(np.int64), axis=0, return_index=True)
    centers = centers[kept]
    return centers[np.argsort(centers @ stacks[0].normal)]


@dataclass(frozen=True)
class _Row:
    """One detector row: the middle of its plane, and a number (by place along the normal) that seeds its noise."""

    center_mm: tuple[float, float, float]
    number: int


def _plan_rows(stack: SliceStack, count: int) -> list[list[_Row]]:
    """Return the ``count`` rows that each slice combines; rows at the same place are shared between slices."""
    offsets = ((np.arange(count) + 0.5) / count - 0.5) * stack.thickness_mm
    plans = []
    for center in stack.centers_mm:
        middles = np.round(center + offsets[:, np.newaxis] * stack.normal, 6)
        numbers = np.round(middles @ stack.normal * 1000).astype(int)
        plans.append([_Row((m[0], m[1], m[2]), int(n)) for m, n in zip(middles, numbers, strict=True)])
    return plans


def rows_per_slice(stack: SliceStack) -> int:
    """Return into how many detector rows a slice is divided; if possible so that neighbours share rows."""
    fewest = int(np.ceil(stack.thickness_mm / TALLEST_ROW_MM - 1e-9))
    gaps = np.abs(np.diff(stack.positions_mm))
    for count in range(fewest, 2 * fewest + 1):
        steps = gaps * count / stack.thickness_mm
        if np.abs(steps - np.round(steps)).max(initial=0.0) < 1e-6:
            return count
    return fewest


class _Measurement:
    """Measures detector rows when a slice needs them and keeps each for the slices that share it."""

    def __init__(
        self, scene: Scene, stacks: Sequence[SliceStack], row_mm: float, scanner: Scanner, seed: int
    ) -> None:
        self._scanner, self._seed = scanner, seed
        beam = tube_beam(scanner.kilovolts)
        self._solids = pack([part.solid for part in scene.parts])
        self._matter = matter(scene, beam)
        self._water = WaterCorrection(beam)
        self._kept: dict[_Row, FloatArray] = {}
        self._row_mm = row_mm
        self._axes = np.array([stacks[0].column_direction, stacks[0].row_direction, stacks[0].normal])
        self.angles = np.pi * np.arange(scanner.views) / scanner.views
        half_width = max(_half_width(scene, stack) for stack in stacks)
        self.bins = 2 * int(np.ceil(half_width / scanner.bin_mm)) + 1

    def combined(self, plan: list[_Row]) -> FloatArray:
        """Return the projections (V, U) of one slice in mm of water."""
        missing = [row for row in plan if row not in self._kept]
        fresh = zip(missing, self._measured(missing), strict=True) if missing else ()
        self._kept = {row: kept for row, kept in self._kept.items() if row in plan} | dict(fresh)
        total = np.zeros((len(self.angles), self.bins))
        for row in plan:
            total += self._kept[row]
        middle = plan[len(plan) // 2]
        return self._in_water(total / len(plan), middle, len(plan)) if self._scanner.one_row else total / len(plan)

    def _measured(self, rows: list[_Row]) -> list[FloatArray]:
        signal = np.empty((len(rows), len(self.angles), self.bins), dtype=np.float32)
        detector = Detector(self._scanner.bin_mm, self._row_mm, 2, SCAN_RADIUS_MM)
        centers = np.repeat(np.array([row.center_mm for row in rows])[:, np.newaxis], len(self.angles), axis=1)
        times = np.array([self._scanner.times(np.array(row.center_mm) @ self._axes[2]) for row in rows])
        planes, axes = self._scanner.motion.frames(centers, self._axes, times)
        transmission(self._solids, self._matter, detector, planes, axes, self.angles, signal)
        arrived = [signal[n].astype(np.float64) for n in range(len(rows))]
        if self._scanner.one_row:
            return arrived
        return [self._in_water(one, row) for one, row in zip(arrived, rows, strict=True)]

    def _in_water(self, signal: FloatArray, row: _Row, tall: int = 1) -> FloatArray:
        scanner = self._scanner
        if scanner.scatter:
            signal = signal + scattered(signal, scanner.scatter, scanner.bin_mm)
        quanta = PHOTONS_PER_MM2 * scanner.dose * scanner.bin_mm * tall * self._row_mm * 720 / scanner.views
        scanner.as_read(signal, quanta, self._seed, row.number + 2**31)
        return self._water(-np.log(np.maximum(signal, 1e-12)))


def matter(scene: Scene, beam: Beam) -> Matter:
    """Return what the parts of ``scene`` do to ``beam``."""
    names = tuple(sorted({part.material for part in scene.parts}))
    return Matter(
        np.array([names.index(part.material) for part in scene.parts], dtype=np.int64),
        beam.attenuation_per_mm(names),
        beam.weights,
        _looked_at_closely(scene),
    )


def _looked_at_closely(scene: Scene) -> NDArray[np.bool_]:
    """Tell which parts are small, and dense or near a marker or decoy: what must not be seen by single rays."""
    places = [one.center_mm for one in scene.markers] + [one.center_mm for one in scene.decoys]
    fine = []
    for part in scene.parts:
        gaps = [np.linalg.norm(place - part.solid.center_mm) - part.solid.radius_mm for place in places]
        matters = material(part.material).density_g_cm3 > DENSE_G_CM3 or min(gaps, default=0.0) < NEAR_MM
        fine.append(part.solid.radius_mm < FINE_MM and matters and not part.yields)
    return np.array(fine)


def _half_width(scene: Scene, stack: SliceStack) -> float:
    """Return how far the detector must reach so that the scene is never truncated and the image is covered."""
    edges = np.abs(stack.aside_mm) + stack.pixel_mm / 2 * np.array([stack.columns, stack.rows])
    corner = float(np.linalg.norm(edges))
    farthest = corner
    for center in (stack.centers_mm[0], stack.centers_mm[-1]):
        for part in scene.parts:
            offset = part.solid.center_mm - center
            in_plane = np.linalg.norm(offset - (offset @ stack.normal) * stack.normal)
            farthest = max(farthest, float(in_plane) + part.solid.radius_mm)
    return float(min(farthest, max(SCAN_RADIUS_MM, corner))) + 2.0


def scattered(signal: FloatArray, strength: float, bin_mm: float) -> FloatArray:
    """Return scatter as a broad blur of ``I log(1/I)`` (Ohnesorge et al., Eur Radiol 9:563, 1999)."""
    source = -signal * np.log(np.maximum(signal, 1e-12))
    blurred: FloatArray = ndimage.gaussian_filter1d(source, SCATTER_WIDTH_MM / bin_mm, axis=1, mode="constant")
    return strength * blurred
