"""The scanner: detector rows are measured, corrected, combined to slices and reconstructed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from tqdm import tqdm

from phantoms.beam import Beam, check_kilovolts, tube_beam
from phantoms.errors import PhantomError
from phantoms.projection import Detector, Matter, transmission
from phantoms.rays import pack
from phantoms.reconstruction import UPSAMPLING, WaterCorrection, back_project, filter_projections, kernel
from phantoms.scene import Scene
from phantoms.solids import FloatArray
from phantoms.stack import SliceStack

SCAN_RADIUS_MM = 350.0
"""Half the bore: what lies farther from the middle of a slice is not seen."""
TALLEST_ROW_MM = 0.65
"""Detector rows are at most this high at the centre of rotation; thicker slices combine several rows."""
PHOTONS_PER_MM2 = 1.0e6
"""Quanta per mm2 of detector and view at dose 1 and 720 views; see `docs/phantoms.md` for the noise it gives."""
SCATTER_WIDTH_MM = 60.0
"""Standard deviation of the scatter kernel along the detector."""
EXTENDED_LIMIT_HU = 31743.0
"""Top of the extended scale: 16 bits with an intercept of -1024."""


@dataclass(frozen=True)
class Scanner:
    """How a scene is measured and reconstructed; where the slices lie is a `SliceStack`."""

    kernel: str = "standard"
    dose: float = 1.0
    """1 is a usual head scan, 7.5 HU in 1 mm standard slices of a 200 mm water disc; 0 leaves all noise out."""
    kilovolts: float = 120.0
    views: int = 720
    bin_mm: float = 0.5
    electronic_noise: float = 8.0
    """Standard deviation added to each reading, in quanta."""
    scatter: float = 0.0
    """Strength of scattered radiation; 0.02 is a usual clinical residue."""
    extended_scale: bool = False
    """Whether values above 3071 HU are kept."""

    @property
    def range_hu(self) -> tuple[float, float]:
        """Lowest and highest value that is stored."""
        return -1024.0, EXTENDED_LIMIT_HU if self.extended_scale else 3071.0

    def __post_init__(self) -> None:
        kernel(self.kernel)
        check_kilovolts(self.kilovolts)
        checks = (
            ("dose", self.dose, self.dose >= 0, "zero or more"),
            ("number of views", self.views, self.views >= 16, "16 or more"),
            ("detector element in mm", self.bin_mm, 0.05 <= self.bin_mm <= 5, "0.05 to 5"),
            ("electronic noise", self.electronic_noise, self.electronic_noise >= 0, "zero or more"),
            ("scatter", self.scatter, 0 <= self.scatter < 1, "0 to 1"),
        )
        for name, value, good, expected in checks:
            if not good:
                raise PhantomError(f"the scanner's {name} is {value}; expected {expected}")


def scan(
    scene: Scene, stack: SliceStack, scanner: Scanner | None = None, *, seed: int = 0, progress: bool = False
) -> NDArray[np.int16]:
    """Return the images (K, rows, columns) of ``scene`` in HU, clipped as the scanner clips."""
    scanner = scanner or Scanner()
    result = np.empty((len(stack), stack.rows, stack.columns), dtype=np.int16)
    slices = enumerate(scan_hu(scene, stack, scanner, seed=seed))
    for k, image in tqdm(slices, total=len(stack), desc="scanning", unit="slice", disable=not progress):
        result[k] = np.round(np.clip(image, *scanner.range_hu))
    return result


def scan_hu(scene: Scene, stack: SliceStack, scanner: Scanner, *, seed: int = 0) -> Iterator[NDArray[np.float32]]:
    """Yield the images (rows, columns) one by one, in HU, neither rounded nor clipped."""
    scene.check()
    measurement = _Measurement(scene, stack, scanner, seed)
    shape = kernel(scanner.kernel)
    first_mm, step_mm = -(measurement.bins - 1) / 2 * scanner.bin_mm, scanner.bin_mm / UPSAMPLING
    for plan in _plan_rows(stack):
        water_mm = measurement.combined(plan)
        image = np.zeros((stack.rows, stack.columns), dtype=np.float32)
        filtered = filter_projections(water_mm, scanner.bin_mm, shape)
        back_project(filtered, measurement.angles, first_mm, step_mm, stack.aside_mm, stack.pixel_mm, image)
        yield 1000 * (image - 1)


@dataclass(frozen=True)
class _Row:
    """One detector row: the middle of its plane, and a number (by place along the normal) that seeds its noise."""

    center_mm: tuple[float, float, float]
    number: int


def _plan_rows(stack: SliceStack) -> list[list[_Row]]:
    """Return the rows that each slice combines; rows at the same place are shared between slices."""
    count = rows_per_slice(stack)
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

    def __init__(self, scene: Scene, stack: SliceStack, scanner: Scanner, seed: int) -> None:
        self._stack, self._scanner, self._seed = stack, scanner, seed
        beam = tube_beam(scanner.kilovolts)
        self._solids = pack([part.solid for part in scene.parts])
        self._matter = _matter(scene, beam)
        self._water = WaterCorrection(beam)
        self._kept: dict[_Row, FloatArray] = {}
        self._row_mm = stack.thickness_mm / rows_per_slice(stack)
        self._axes = np.array([stack.column_direction, stack.row_direction, stack.normal])
        self.angles = np.pi * np.arange(scanner.views) / scanner.views
        self.bins = 2 * int(np.ceil(_half_width(scene, stack) / scanner.bin_mm)) + 1

    def combined(self, plan: list[_Row]) -> FloatArray:
        """Return the projections (V, U) of one slice in mm of water."""
        missing = [row for row in plan if row not in self._kept]
        fresh = zip(missing, self._measured(missing), strict=True) if missing else ()
        self._kept = {row: kept for row, kept in self._kept.items() if row in plan} | dict(fresh)
        total = np.zeros((len(self.angles), self.bins))
        for row in plan:
            total += self._kept[row]
        return total / len(plan)

    def _measured(self, rows: list[_Row]) -> list[FloatArray]:
        signal = np.empty((len(rows), len(self.angles), self.bins), dtype=np.float32)
        detector = Detector(self._scanner.bin_mm, self._row_mm, 2, SCAN_RADIUS_MM)
        planes = np.array([row.center_mm for row in rows])
        transmission(self._solids, self._matter, detector, planes, self._axes, self.angles, signal)
        return [self._in_water(signal[n].astype(np.float64), row) for n, row in enumerate(rows)]

    def _in_water(self, signal: FloatArray, row: _Row) -> FloatArray:
        scanner = self._scanner
        if scanner.scatter:
            signal = signal + _scattered(signal, scanner.scatter, scanner.bin_mm)
        if scanner.dose:
            area = scanner.bin_mm * self._row_mm * 720 / scanner.views
            quanta = PHOTONS_PER_MM2 * scanner.dose * area
            generator = np.random.default_rng([self._seed, row.number + 2**31])
            counts = generator.poisson(quanta * signal) + scanner.electronic_noise * generator.standard_normal(
                signal.shape
            )
            # As on real scanners, readings are raised to the electronic noise, or their logarithms would run away.
            signal = np.maximum(counts, max(1.0, scanner.electronic_noise)) / quanta
        return self._water(-np.log(np.maximum(signal, 1e-12)))


def _matter(scene: Scene, beam: Beam) -> Matter:
    names = tuple(sorted({part.material for part in scene.parts}))
    return Matter(
        np.array([names.index(part.material) for part in scene.parts], dtype=np.int64),
        beam.attenuation_per_mm(names),
        beam.weights,
    )


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


def _scattered(signal: FloatArray, strength: float, bin_mm: float) -> FloatArray:
    """Return scatter as a broad blur of ``I log(1/I)`` (Ohnesorge et al., Eur Radiol 9:563, 1999)."""
    source = -signal * np.log(np.maximum(signal, 1e-12))
    blurred: FloatArray = ndimage.gaussian_filter1d(source, SCATTER_WIDTH_MM / bin_mm, axis=1, mode="constant")
    return strength * blurred
