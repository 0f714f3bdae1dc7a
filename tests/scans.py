"""Scans for the tests, straight from the phantom renderer (which shares no code with what is tested)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from phantoms.fast import render
from phantoms.scene import Part, Scene
from phantoms.solids import sphere
from phantoms.stack import SliceStack, axial_stack
from ronnaplan.ct import CTVolume, SeriesSource, SliceGrid
from ronnaplan.ct.volume import Voxels
from ronnaplan.geometry import FloatArray


def scan(
    scene: Scene, stack: SliceStack, *, blur_mm: float = 0.5, noise_hu: float = 10.0, seed: int = 1
) -> CTVolume:
    """Render ``scene`` and lay the voxels on the grid that a reader would give them."""
    return on_grid(render(scene, stack, blur_mm=blur_mm, noise_hu=noise_hu, seed=seed), stack)


def on_grid(images: NDArray[np.int16], stack: SliceStack) -> CTVolume:
    """Lay rendered voxels (K, rows, columns) on the grid that a reader would give them."""
    order = np.argsort(stack.positions_mm)
    grid = SliceGrid(
        stack.origins_mm[order],
        stack.row_direction * stack.pixel_mm,
        stack.column_direction * stack.pixel_mm,
        stack.thickness_mm,
    )
    return CTVolume(np.asarray(images, dtype=np.int16)[order], grid, SeriesSource(frame_of_reference_uid="1.2.3"))


def balls(
    centers_mm: list[tuple[float, float, float]], diameter_mm: float = 11.5, material: str = "acrylic"
) -> Scene:
    """Balls in air."""
    return Scene(tuple(Part(sphere(center, diameter_mm), material) for center in centers_mm))


def small_stack(**options: object) -> SliceStack:
    """A slab that holds a few balls: 64 mm wide, 44 mm high, 0.5 mm pixels, 1 mm slices."""
    settings: dict[str, object] = {"start_mm": -22, "stop_mm": 22, "matrix": 128, "field_of_view_mm": 64}
    return axial_stack(**{**settings, **options})  # type: ignore[arg-type]


def with_slices(volume: CTVolume, places: FloatArray, voxels_hu: Voxels, thickness_mm: float) -> CTVolume:
    """Lay voxels (K, rows, columns) on slices at fractional indices ``places`` (K,) of a scan; the header says so."""
    gap_mm = volume.grid.typical_gap_mm
    origins_mm = volume.grid.origins_mm[0] + places[:, np.newaxis] * gap_mm * volume.grid.normal
    grid = replace(volume.grid, origins_mm=origins_mm, thickness_mm=thickness_mm)
    return replace(volume, voxels_hu=voxels_hu, grid=grid)


def offsets_mm(volume: CTVolume, origin_mm: FloatArray) -> FloatArray:
    """How far each voxel lies from a point, along x, y and z (3, K, rows, columns)."""
    indices = np.moveaxis(np.indices(volume.voxels_hu.shape), 0, -1).reshape(-1, 3).astype(np.float64)
    offsets: FloatArray = (volume.grid.positions_mm(indices) - origin_mm).T.reshape(3, *volume.voxels_hu.shape)
    return offsets


def bent(still: CTVolume, harmonic: str, by_mm: float) -> CTVolume:
    """Return a scan that one turn made, each of whose views saw all displaced, by a ``harmonic`` of its direction.

    Within the slices in the direction of view's normal (``third cos``, ``fifth sin``), or across them (``across cos``).
    """
    grid = still.grid
    steps = (grid.typical_gap_mm, grid.row_spacing_mm, grid.column_spacing_mm)
    across, down, along = np.meshgrid(
        *(fft.fftfreq(size, step) for size, step in zip(still.voxels_hu.shape, steps, strict=True)), indexing="ij"
    )
    order, wave = harmonic.split()
    turned = {"third": 3, "fifth": 5, "across": 2}[order] * np.arctan2(down, along)
    far_mm = by_mm * (np.cos(turned) if wave == "cos" else np.sin(turned))
    frequency = across if order == "across" else np.hypot(down, along)
    spectrum = fft.fftn(still.voxels_hu.astype(np.float64)) * np.exp(-2j * np.pi * frequency * far_mm)
    return replace(still, voxels_hu=np.asarray(fft.ifftn(spectrum).real, dtype=np.float32))


def two_sizes() -> Scene:
    """Return four balls of 9 mm, and three of 6 mm beside them."""
    many = balls([(x, y, 0.0) for x in (-16.0, 0.0) for y in (-8.0, 8.0)], 9.0)
    return many + balls([(16.0, y, 0.0) for y in (-14.0, 0.0, 14.0)], 6.0)
