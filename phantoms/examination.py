"""A scene together with how it is scanned: what a benchmark runs and what is written to disk."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from phantoms.fast import render
from phantoms.output import check_target, write_phantom
from phantoms.scanner import Scanner, scan
from phantoms.scene import Scene
from phantoms.series import SeriesOptions
from phantoms.solids import Vector
from phantoms.stack import SliceStack

FAST_BLUR_MM = {"soft": 0.64, "standard": 0.47, "bone": 0.30}
"""Gaussian blur that resembles each kernel in the fast renderer."""
FAST_NOISE_HU = {"soft": 4.6, "standard": 7.5, "bone": 21.0}
"""Noise of each kernel at dose 1 in 1 mm slices, as measured in a 200 mm water disc on the full scanner."""


@dataclass(frozen=True)
class Examination:
    """A scene, its slices, the scanner's settings and the seed of its noise."""

    scene: Scene
    stack: SliceStack
    scanner: Scanner = field(default_factory=Scanner)
    seed: int = 0

    def around(self, center_mm: Vector, reach_mm: float, *, crop: bool = False) -> Examination:
        """Return the same examination with only the slices within ``reach_mm`` of a place.

        The voxels of the slab equal those of the whole scan, so a benchmark need not scan whole heads. With
        ``crop`` the images, too, reach no farther, which saves the reconstruction; their noise is another draw.
        """
        return replace(self, stack=self.stack.around(center_mm, reach_mm, crop=crop))

    def images(self, *, fast: bool = False, progress: bool = False) -> NDArray[np.int16]:
        """Return the images (K, rows, columns) in HU, by the full scanner or by the fast renderer."""
        if not fast:
            return scan(self.scene, self.stack, self.scanner, seed=self.seed, progress=progress)
        kernel, dose = self.scanner.kernel, self.scanner.dose
        return render(
            self.scene,
            self.stack,
            blur_mm=FAST_BLUR_MM[kernel],
            noise_hu=FAST_NOISE_HU[kernel] / np.sqrt(dose * self.stack.thickness_mm) if dose else 0.0,
            seed=self.seed,
            clip_hu=self.scanner.range_hu,
        )

    def write(
        self,
        folder: str | Path,
        options: SeriesOptions | None = None,
        *,
        fast: bool = False,
        progress: bool = False,
    ) -> None:
        """Scan and write the DICOM series and ``truth.json`` to ``folder``, whole or not at all."""
        check_target(Path(folder))
        kernel = "FAST " + self.scanner.kernel if fast else self.scanner.kernel
        options = options or SeriesOptions(
            description=self.scene.name or "Phantom",
            kernel=kernel.upper(),
            kilovolts=self.scanner.kilovolts,
            seed=self.seed,
        )
        write_phantom(
            folder,
            self.scene,
            self.stack,
            self.images(fast=fast, progress=progress),
            options,
            renderer="fast" if fast else "projection",
            kernel=self.scanner.kernel,
            dose=self.scanner.dose,
            kilovolts=self.scanner.kilovolts,
            scatter=self.scanner.scatter,
            seed=self.seed,
        )
