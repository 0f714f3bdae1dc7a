"""What becomes of reconstructed images before they are stored: denoised, interpolated, reformatted, rounded, tagged."""

from __future__ import annotations

import importlib
from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage

from phantoms.errors import PhantomError
from phantoms.machine import Images
from phantoms.series import Tag
from phantoms.solids import FloatArray
from phantoms.stack import TABLE, SliceStack

LOWEST_HU = -1024.0
TWELVE_BITS = 4095
EXTENDED_LIMIT_HU = 31743.0
"""Top of the extended scale: 16 bits with an intercept of -1024."""
DENOISING_MARGIN = 10
"""Pixels beyond a crop that are denoised with it, so that it shows what the whole image would."""


PENALIZED_STEPS, PENALIZED_MARGIN = 40, 24
"""Steps towards the minimum, and pixels by which an image is mirrored for it."""


class Step(ABC):
    """Makes images from images; ``source`` says which slices it needs, ``apply`` makes those asked for."""

    derived = False
    """Whether the result is marked as made from other images."""

    @abstractmethod
    def source(self, stack: SliceStack) -> SliceStack:
        """Return the slices from which those of ``stack`` are made."""

    @abstractmethod
    def apply(self, images: Images, source: SliceStack, stack: SliceStack) -> Images:
        """Return the images of ``stack`` from those of ``source``."""


class _Denoised(Step):
    """A filter of single slices that sees a margin about what is kept."""

    def source(self, stack: SliceStack) -> SliceStack:
        return stack.wider(DENOISING_MARGIN)

    def apply(self, images: Images, source: SliceStack, stack: SliceStack) -> Images:
        inner = slice(DENOISING_MARGIN, -DENOISING_MARGIN)
        return np.stack([self._filtered(image, stack.pixel_mm)[inner, inner] for image in images])

    @abstractmethod
    def _filtered(self, image: Images, pixel_mm: float) -> Images:
        """Return one slice denoised."""


@dataclass(frozen=True)
class TotalVariation(_Denoised):
    """Denoising by total variation (Rudin, Osher & Fatemi, Physica D 60, 1992; Chambolle, J Math Imaging 20, 2004).

    The larger ``weight_hu`` the smoother; a disc of r pixels loses ``2 weight / r`` of its contrast.
    """

    weight_hu: float

    def _filtered(self, image: Images, pixel_mm: float) -> Images:
        return np.asarray(_restoration().denoise_tv_chambolle(image, self.weight_hu, max_num_iter=60))


@dataclass(frozen=True)
class NonLocalMeans(_Denoised):
    """Denoising by the mean of pixels with similar surroundings (Buades, Coll & Morel, CVPR 2005)."""

    strength_hu: float

    def _filtered(self, image: Images, pixel_mm: float) -> Images:
        restoration = _restoration()
        return np.asarray(
            restoration.denoise_nl_means(image, 5, 6, h=self.strength_hu, fast_mode=True, preserve_range=True)
        )


@dataclass(frozen=True)
class PenalizedLeastSquares(_Denoised):
    """Reconstruction by penalized least squares: readings fitted evenly, differences of neighbours by Huber's measure.

    Of parallel rays that weigh alike, the squared misfit to the readings is that to the image of filtered
    back-projection without smoothing, each frequency f divided by f. So the image that minimizes the sum (Fessler,
    IEEE Trans Med Imaging 13:290, 1994) is found from that image, by steps that never make the sum larger. What is
    left out: rays through metal or much bone would weigh less.
    """

    half_at_per_mm: float
    """The frequency, in cycles per mm, at which small differences lose half of their height."""
    edge_hu_per_mm: float
    """Slopes steeper than this are edges: the penalty grows no faster than they do."""

    def _filtered(self, image: Images, pixel_mm: float) -> Images:
        padded = np.pad(image, PENALIZED_MARGIN, mode="reflect")
        down, across = (fft.fftfreq(padded.shape[0], pixel_mm), fft.rfftfreq(padded.shape[1], pixel_mm))
        frequency = np.hypot(down[:, np.newaxis], across)
        frequency[0, 0] = across[1] / 2
        roughness = sum((2 * np.sin(np.pi * f * pixel_mm) / pixel_mm) ** 2 for f in (down[:, np.newaxis], across))
        strength = 1 / self.half_at_per_mm / (2 * np.pi * self.half_at_per_mm) ** 2
        measured, found = fft.rfft2(padded), padded
        for _ in range(PENALIZED_STEPS):
            slopes = [np.roll(found, -1, axis) - found for axis in (0, 1)]
            limit = self.edge_hu_per_mm * pixel_mm
            pulls = [np.clip(slope, -limit, limit) / pixel_mm**2 for slope in slopes]
            rough = np.sum([np.roll(pull, 1, axis) - pull for axis, pull in enumerate(pulls)], axis=0)
            slope = (fft.rfft2(found) - measured) / frequency + strength * fft.rfft2(rough)
            found = found - fft.irfft2(slope / (1 / frequency + strength * roughness), s=padded.shape)
        inner = slice(PENALIZED_MARGIN, -PENALIZED_MARGIN)
        return np.asarray(found[inner, inner])


def _restoration() -> Any:
    try:
        return importlib.import_module("skimage.restoration")
    except ImportError as error:
        raise PhantomError("denoising needs scikit-image, which is not installed; install scikit-image") from error


@dataclass(frozen=True)
class Interpolated(Step):
    """Slices drawn linearly between slices that were reconstructed every ``native_mm`` along the table."""

    native_mm: float
    derived = True

    def source(self, stack: SliceStack) -> SliceStack:
        """Return the native slices between which those of ``stack`` lie; their grid starts at zero."""
        places = stack.centers_mm @ stack.travel / self.native_mm
        numbers = np.arange(np.floor(places.min()), np.floor(places.max()) + 2)
        start = stack.centers_mm[0]
        along = numbers * self.native_mm - start @ stack.travel
        return replace(stack, centers_mm=start + along[:, np.newaxis] * stack.travel)

    def apply(self, images: Images, source: SliceStack, stack: SliceStack) -> Images:
        """Return each slice as the weighted mean of its two native neighbours."""
        place = (stack.centers_mm - source.centers_mm[0]) @ stack.travel / self.native_mm
        low = np.clip(np.floor(place).astype(int), 0, len(source) - 2)
        share = (place - low)[:, np.newaxis, np.newaxis]
        return np.asarray(images[low] * (1 - share) + images[low + 1] * share)


@dataclass(frozen=True)
class Reformatted(Step):
    """Slices of any direction drawn, trilinearly, through axial slices of ``thickness_mm`` every ``native_mm``."""

    native_mm: float
    thickness_mm: float
    axis_mm: tuple[float, float] = (0.0, 0.0)
    """Where the axial scan's axis of rotation meets the plane z = 0."""
    derived = True

    def source(self, stack: SliceStack) -> SliceStack:
        """Return the box of axial voxels that holds ``stack``; their grid starts at the axis of rotation."""
        steps = np.array([stack.pixel_mm, stack.pixel_mm, self.native_mm])
        far = stack.origins_mm + (stack.columns - 1) * stack.pixel_mm * stack.column_direction
        down = (stack.rows - 1) * stack.pixel_mm * stack.row_direction
        corners = np.concatenate([stack.origins_mm, far, stack.origins_mm + down, far + down])
        places = (corners - (*self.axis_mm, 0.0)) / steps
        low, high = np.floor(places.min(axis=0) - 1), np.ceil(places.max(axis=0) + 1)
        columns, rows, count = (high - low).astype(int) + 1
        aside = (low[:2] + high[:2]) / 2 * stack.pixel_mm
        heights = (low[2] + np.arange(count)) * self.native_mm
        return SliceStack(
            np.array([*self.axis_mm, 0.0]) + heights[:, np.newaxis] * TABLE,
            np.array([1.0, 0.0, 0.0]),
            np.array([0.0, 1.0, 0.0]),
            stack.pixel_mm,
            int(rows),
            int(columns),
            self.thickness_mm,
            aside_mm=(float(aside[0]), float(aside[1])),
        )

    def apply(self, images: Images, source: SliceStack, stack: SliceStack) -> Images:
        """Return the values at the voxels' places."""
        steps = np.array([stack.pixel_mm, stack.pixel_mm, self.native_mm])
        v, u = np.mgrid[: stack.rows, : stack.columns] * stack.pixel_mm
        across = v[..., np.newaxis] * stack.row_direction + u[..., np.newaxis] * stack.column_direction
        result = np.empty((len(stack), stack.rows, stack.columns), dtype=images.dtype)
        for k, origin in enumerate(stack.origins_mm):
            places = (origin + across - source.origins_mm[0]) / steps
            ndimage.map_coordinates(images, np.moveaxis(places[..., ::-1], -1, 0), result[k], order=1)
        return result


@dataclass(frozen=True)
class Finish:
    """The steps in their order, and how the result is stored: whole multiples of ``slope`` HU in 12 bits, tagged."""

    steps: tuple[Step, ...] = ()
    slope: float = 1.0
    tag: Tag = "nominal"

    @property
    def derived(self) -> bool:
        """Whether the stored images are made from other images."""
        return any(step.derived for step in self.steps)

    def sources(self, stack: SliceStack) -> list[SliceStack]:
        """Return the slices before each step, the first to be reconstructed, and last ``stack`` itself."""
        stacks = [stack]
        for step in reversed(self.steps):
            stacks.insert(0, step.source(stacks[0]))
        return stacks

    def apply(self, images: Images, stack: SliceStack, *, extended_scale: bool = False) -> NDArray[np.int16]:
        """Return what is stored (K, rows, columns) in HU, given the images of ``sources(stack)[0]``."""
        highest = EXTENDED_LIMIT_HU if extended_scale else LOWEST_HU + TWELVE_BITS * self.slope
        stacks = self.sources(stack)
        kept = np.clip(images, LOWEST_HU, highest)
        for step, before, after in zip(self.steps, stacks[:-1], stacks[1:], strict=True):
            kept = np.clip(step.apply(kept, before, after), LOWEST_HU, highest)
        stored: FloatArray = np.round((kept - LOWEST_HU) / self.slope) * self.slope + LOWEST_HU
        return np.round(stored).astype(np.int16)
