"""The image-domain renderer: exact partial volume, a blur and coloured noise; seconds for a whole head.

Each pixel is sampled by a fine raster of lines along the slice normal; along these, what each slice averages
over its thickness is exact (closed form). No reconstruction takes place, so there are no streaks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage
from tqdm import tqdm

from phantoms.compiled import compiled, parallel_range
from phantoms.errors import PhantomError
from phantoms.machine import Images, Machine
from phantoms.materials import material
from phantoms.profiles import Profile, Shape
from phantoms.rays import PackedSolids, pack, to_unit, unit_interval, visible_segments
from phantoms.scene import Scene
from phantoms.solids import FloatArray
from phantoms.stack import SliceStack

RASTER_MM = 0.15
"""Finest in-plane distance between sampling lines; keeps a 3 mm ball's centroid within a micrometre."""

PROFILE_STEPS = 512
"""Steps in the table of a slice profile; a Gaussian is then right to a few millionths."""

AIR_HU = -1000.0

KERNEL_BLUR_MM = {
    "very soft": 0.96,
    "soft": 0.64,
    "smooth": 0.54,
    "standard": 0.47,
    "detail": 0.36,
    "bone": 0.30,
    "edge": 0.30,
    "strong edge": 0.27,
}
"""Gaussian blur that resembles each kernel (it cannot overshoot)."""
KERNEL_NOISE_HU = {
    "very soft": 2.5,
    "soft": 4.6,
    "smooth": 6.0,
    "standard": 7.5,
    "detail": 11.7,
    "bone": 21.0,
    "edge": 26.6,
    "strong edge": 52.5,
}
"""Noise of each kernel at dose 1 in 1 mm slices, as measured in a 200 mm water disc on the full scanner."""


@dataclass(frozen=True)
class Renderer(Machine):
    """The fast renderer as a scanner: its kernels are Gaussian, its profile is of any shape and width."""

    shape: Shape = "box"
    broadening: float = 1.0
    """Full width at half maximum of the slice profile over the nominal slice thickness."""

    def profile(self, stack: SliceStack) -> Profile:
        """Return the profile that was asked for."""
        return Profile(self.shape, self.broadening * stack.thickness_mm)

    def reconstruct(
        self, scene: Scene, stacks: Sequence[SliceStack], *, seed: int = 0, progress: bool = False
    ) -> list[Images]:
        """Return the images of each stack; their noise is independent."""
        if self.motion.moves:
            raise PhantomError("the fast renderer knows no time; scan what moves with another scanner")
        return [
            render_hu(
                scene,
                stack,
                profile=self.profile(stack),
                blur_mm=KERNEL_BLUR_MM[self.kernel],
                noise_hu=KERNEL_NOISE_HU[self.kernel] / np.sqrt(self.dose * stack.thickness_mm)
                if self.dose
                else 0.0,
                seed=seed + n,
            )
            for n, stack in enumerate(tqdm(stacks, "rendering", unit="stack", disable=not progress))
        ]


def like(machine: Machine, stack: SliceStack) -> Renderer:
    """Return the renderer that resembles a scanner: its kernel, dose and slice profile."""
    profile = machine.profile(stack)
    return Renderer(
        kernel=machine.kernel,
        dose=machine.dose,
        kilovolts=machine.kilovolts,
        extended_scale=machine.extended_scale,
        motion=machine.motion,
        shape=profile.shape,
        broadening=profile.fwhm_mm / stack.thickness_mm,
    )


def render(
    scene: Scene,
    stack: SliceStack,
    *,
    blur_mm: float = 0.5,
    noise_hu: float = 10.0,
    seed: int = 0,
    profile: Profile | None = None,
) -> NDArray[np.int16]:
    """Return the images of `render_hu` as they are stored: whole HU in 12 bits."""
    images = render_hu(scene, stack, blur_mm=blur_mm, noise_hu=noise_hu, seed=seed, profile=profile)
    return np.round(np.clip(images, -1024.0, 3071.0)).astype(np.int16)


def render_hu(
    scene: Scene,
    stack: SliceStack,
    *,
    blur_mm: float,
    noise_hu: float,
    seed: int = 0,
    profile: Profile | None = None,
) -> FloatArray:
    """Return the images (K, rows, columns) of ``scene`` in HU, neither rounded nor clipped.

    ``blur_mm`` is the standard deviation of the in-plane Gaussian point spread; ``noise_hu`` that of the noise,
    whose spectrum rises and falls like that of filtered back-projection; slices are independent. ``profile`` is
    what a slice weighs along its normal; None is a box of the slice thickness.
    """
    scene.check()
    images = average_hu(scene, stack, profile)
    generator = np.random.default_rng(seed)
    for k, image in enumerate(images):
        blurred = ndimage.gaussian_filter(image, blur_mm / stack.pixel_mm, mode="nearest") if blur_mm else image
        images[k] = blurred + noise_hu * textured_noise(generator, blurred.shape, stack.pixel_mm)
    return images


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
    for place in range(len(voxels) * raster * raster):
        column, sample = place // (raster * raster), place % (raster * raster)
        v, u = (sample // raster + 0.5) / raster - 0.5, column + (sample % raster + 0.5) / raster - 0.5
        origin = corner + v * row_step + u * column_step
        hits = 0
        for n in range(count):
            if _passes_near(packed.centers_mm[n], packed.radii_mm[n], origin, normal):
                t0, t1 = _interval(packed, n, origin, normal)
                if t1 > t0:
                    starts[hits], stops[hits], parts[hits] = t0, t1, n
                    hits += 1
        for s in range(visible_segments(starts, stops, hits, edges, owners)):
            if owners[s] >= 0:
                weight = contrasts[parts[owners[s]]] / (raster * raster)
                _deposit(voxels[column], positions, reach, areas, edges[s], edges[s + 1], weight)


@compiled()
def _interval(packed: PackedSolids, n: int, origin: FloatArray, normal: FloatArray) -> tuple[float, float]:
    affine = packed.unit_from_world[n]
    o, d = to_unit(affine, origin) + affine[:, 3], to_unit(affine, normal)
    return unit_interval(packed.shapes[n], o[0], o[1], o[2], d[0], d[1], d[2], packed.top_ratios[n])


@compiled()
def _passes_near(center: FloatArray, radius: float, origin: FloatArray, direction: FloatArray) -> bool:
    """Whether a ray along a unit ``direction`` meets the ball about a solid."""
    along, distance = 0.0, 0.0
    for axis in range(3):
        offset = center[axis] - origin[axis]
        along += offset * direction[axis]
        distance += offset * offset
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
    """Share the segment ``start`` to ``stop`` among the slices that see it."""
    first = np.searchsorted(positions, start - reach)
    for k in range(first, len(positions)):
        if positions[k] - reach >= stop:
            break
        seen = _area(areas, reach, stop - positions[k]) - _area(areas, reach, start - positions[k])
        voxels[k] += weight * seen


@compiled()
def _area(areas: FloatArray, reach: float, offset: float) -> float:
    """Return the area of a profile below ``offset`` from its middle, from a table over ``-reach`` to ``reach``."""
    place = min(max((offset / reach + 1) * 0.5, 0.0), 1.0) * (len(areas) - 1)
    n = min(int(place), len(areas) - 2)
    area: float = areas[n] + (place - n) * (areas[n + 1] - areas[n])
    return area


def textured_noise(generator: np.random.Generator, shape: tuple[int, int], pixel_mm: float) -> FloatArray:
    """Return noise of unit variance whose spectrum is |f| exp(-(f / 0.45)^2), f in cycles per mm.

    The shape is that of standard-kernel head CT (cf. Kijewski & Judy, Phys Med Biol 32, 1987).
    """
    white = generator.standard_normal(shape)
    v = fft.fftfreq(shape[0], pixel_mm)[:, np.newaxis]
    u = fft.rfftfreq(shape[1], pixel_mm)[np.newaxis, :]
    frequency = np.hypot(u, v)
    amplitude = np.sqrt(frequency) * np.exp(-((frequency / 0.45) ** 2) / 2)
    colored: FloatArray = fft.irfft2(fft.rfft2(white) * amplitude, s=shape)
    colored /= colored.std()
    return colored
