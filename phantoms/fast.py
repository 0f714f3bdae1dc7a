"""The image-domain renderer: exact partial volume, a blur and coloured noise; seconds for a whole head.

No reconstruction takes place, so there are no streaks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage
from tqdm import tqdm

from phantoms.averages import average_hu
from phantoms.errors import PhantomError
from phantoms.machine import Images, Machine
from phantoms.profiles import Profile, Shape
from phantoms.scene import Scene
from phantoms.solids import FloatArray
from phantoms.stack import SliceStack

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
) -> NDArray[np.int16]:
    """Return the images of `render_hu` as they are stored: whole HU in 12 bits."""
    images = render_hu(scene, stack, blur_mm=blur_mm, noise_hu=noise_hu, seed=seed)
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
        images[k] = blurred
        if noise_hu:
            images[k] += noise_hu * textured_noise(generator, blurred.shape, stack.pixel_mm)
    return images


def textured_noise(generator: np.random.Generator, shape: tuple[int, int], pixel_mm: float) -> FloatArray:
    """Return noise of unit variance whose spectrum is |f| exp(-(f / 0.45)^2), f in cycles per mm.

    The shape is that of standard-kernel head CT (cf. Kijewski & Judy, Phys Med Biol 32, 1987).
    """
    white = generator.standard_normal(shape)
    colored: FloatArray = fft.irfft2(fft.rfft2(white) * _amplitude(shape, pixel_mm), s=shape)
    colored /= colored.std()
    return colored


@lru_cache(maxsize=1)  # all slices of a stack are alike
def _amplitude(shape: tuple[int, int], pixel_mm: float) -> FloatArray:
    """Return the root of the noise's spectrum, as `scipy.fft.rfft2` lays it out."""
    v = fft.fftfreq(shape[0], pixel_mm)[:, np.newaxis]
    u = fft.rfftfreq(shape[1], pixel_mm)[np.newaxis, :]
    frequency = np.hypot(u, v)
    amplitude: FloatArray = np.sqrt(frequency) * np.exp(-((frequency / 0.45) ** 2) / 2)
    return amplitude
