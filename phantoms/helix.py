"""A helical scanner: a tube and rows of detectors that turn about a patient who moves through."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from tqdm import tqdm

from phantoms.helix_reconstruction import Geometry, back_project_cone_weighted, back_project_interpolated
from phantoms.helix_settings import HelixSettings
from phantoms.helix_turns import HalfTurns, Orbit, Readings
from phantoms.machine import Images
from phantoms.motion import Span
from phantoms.profiles import Profile
from phantoms.scene import Scene
from phantoms.solids import FloatArray, Vector
from phantoms.stack import SliceStack

THIN = 1.3
"""Slices up to this many row heights are reconstructed as thin as the rows allow; thicker ones are averaged."""
PLANES_PER_ROW = 2.0
"""Planes that are averaged to a thick slice, per row height."""
SLAB_MM = 16.0
"""Slices are reconstructed together within so much of the axis."""


@dataclass(frozen=True)
class Helix(HelixSettings):
    """A helical scanner."""

    def profile(self, stack: SliceStack) -> Profile:
        """Return a Gaussian as wide, at half maximum, as the profile at the axis of rotation."""
        offsets = np.linspace(-3, 3, 2401) * max(self.row_mm, stack.thickness_mm)
        area = _native_profile(self, offsets)
        step = offsets[1] - offsets[0]
        planes = _planes(self, stack.thickness_mm)
        area = sum((np.interp(offsets - plane, offsets, area) for plane in planes), np.zeros_like(area))
        inside = np.flatnonzero(area >= area.max() / 2)
        left, right = inside[0], inside[-1]
        half = area.max() / 2
        low = (area[left] - half) / (area[left] - area[left - 1])
        high = (area[right] - half) / (area[right] - area[right + 1])
        return Profile("gaussian", float((right - left + low + high) * step))

    def seen_during(self, place_mm: Vector, radius_mm: float, stack: SliceStack) -> Span:
        """Return from when to when, in parts of the scan, a ball in the scene is in the beam."""
        position, half = float(np.asarray(place_mm) @ stack.normal), self.rows * self.row_mm / 2 + radius_mm
        first, last = self.times(np.array([position - half, position + half]))
        return float(first), float(last)

    def reconstruct(
        self, scene: Scene, stacks: Sequence[SliceStack], *, seed: int = 0, progress: bool = False
    ) -> list[Images]:
        """Return the images of each stack; the scene is measured once."""
        scene.check()
        orbit = Orbit.about(stacks)
        turns = HalfTurns(scene, self, orbit, stacks, seed)
        results = [np.zeros((len(s), s.rows, s.columns), dtype=np.float32) for s in stacks]
        slabs = sorted(_slabs(orbit, stacks).items())
        for _, slab in tqdm(slabs, "scanning", unit="slab", disable=not progress):
            heights = np.concatenate([orbit.heights_mm(stacks[number])[members] for number, members in slab])
            margin = max(stacks[number].thickness_mm for number, _ in slab) / 2
            part = turns.seeing(float(heights.min()) - margin, float(heights.max()) + margin)
            data = turns.stacked(part)
            for number, members in slab:
                places = orbit.heights_mm(stacks[number])[members]
                results[number][members] = self._slab(stacks[number], places, turns, data, part.start)
        return results

    def _slab(
        self, stack: SliceStack, heights_mm: FloatArray, turns: HalfTurns, data: Readings, first: int
    ) -> Images:
        planes = _planes(self, stack.thickness_mm)
        places = (heights_mm[:, np.newaxis] + planes).ravel()
        order = np.argsort(places, kind="stable")
        geometry = Geometry(
            self.source_mm,
            self.feed_mm,
            self.row_mm,
            turns.first_t_mm,
            turns.step_t_mm,
            np.radians(self.start_deg),
        )
        corner = np.array([stack.aside_mm[0], stack.aside_mm[1]])
        corner = corner - (np.array([stack.columns, stack.rows]) - 1) / 2 * stack.pixel_mm
        cube = np.zeros((stack.rows, stack.columns, len(places)), dtype=np.float32)
        if self.method == "WFBP":
            back_project_cone_weighted(data, first, geometry, places[order], corner, stack.pixel_mm, cube)
        else:
            whole = self.method == "360LI"
            back_project_interpolated(data, first, geometry, whole, places[order], corner, stack.pixel_mm, cube)
        images = np.empty((len(places), stack.rows, stack.columns), dtype=np.float32)
        images[order] = np.moveaxis(cube, 2, 0)
        averaged = images.reshape(len(heights_mm), len(planes), stack.rows, stack.columns).mean(axis=1)
        return np.asarray(1000 * (averaged - 1))


def _planes(scanner: Helix, thickness_mm: float) -> FloatArray:
    """Return the offsets of the planes whose mean is a slice."""
    if scanner.method != "WFBP" or thickness_mm <= THIN * scanner.row_mm:
        return np.zeros(1)
    count = int(np.ceil(PLANES_PER_ROW * thickness_mm / scanner.row_mm))
    return ((np.arange(count) + 0.5) / count - 0.5) * thickness_mm


def _slabs(orbit: Orbit, stacks: Sequence[SliceStack]) -> dict[int, list[tuple[int, list[int]]]]:
    """Return stacks and slices of everything that is reconstructed together, by slab."""
    slabs: dict[int, dict[int, list[int]]] = {}
    for number, stack in enumerate(stacks):
        for k, height in enumerate(orbit.heights_mm(stack)):
            slabs.setdefault(int(np.floor(height / SLAB_MM)), {}).setdefault(number, []).append(k)
    return {slab: list(members.items()) for slab, members in slabs.items()}


def _native_profile(scanner: Helix, offsets_mm: FloatArray) -> FloatArray:
    """Return what a slice at 0 sees, at the axis, of a thin disc at each offset, averaged over all directions.

    A row sees a box of its own height, smoothed by the focal spot; between rows (or turns) it is interpolated
    linearly. WFBP interpolates between neighbouring rows, the others between the samples that are nearest.
    """
    height, count = scanner.row_mm, scanner.rows
    shadow = scanner.spot_mm[1] * scanner.detector_mm / (scanner.source_mm + scanner.detector_mm)
    total = np.zeros_like(offsets_mm)
    phases = (np.arange(240) + 0.5) / 240
    for phase in phases:
        if scanner.method == "WFBP":
            samples = (np.arange(-3, 4) + phase) * height
        else:
            share = 2 if scanner.method == "180LI" else 1
            turns = (np.arange(-6, 7) + phase) * scanner.feed_mm / share
            samples = (turns[:, np.newaxis] + (np.arange(count) - (count - 1) / 2) * height).ravel()
        above, below = samples[samples > 0].min(), samples[samples <= 0].max()
        weight = above / (above - below)
        for place, share_of in ((below, weight), (above, 1 - weight)):
            total += share_of * _box_of_boxes(offsets_mm - place, height, shadow)
    return total / len(phases)


def _box_of_boxes(offsets_mm: FloatArray, one_mm: float, other_mm: float) -> FloatArray:
    """Return the convolution of two boxes of unit area."""
    inner, outer = abs(one_mm - other_mm) / 2, (one_mm + other_mm) / 2
    flank = np.clip((outer - np.abs(offsets_mm)) / max(outer - inner, 1e-9), 0.0, 1.0)
    return flank / max(one_mm, other_mm)
