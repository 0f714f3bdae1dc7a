"""A scene together with how it is scanned: what a benchmark runs and what is written to disk."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from hashlib import sha256
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from phantoms.fast import Renderer, like
from phantoms.finish import Finish
from phantoms.machine import Machine
from phantoms.motion import mean_place, timed_path
from phantoms.output import check_target, write_phantom
from phantoms.scanner import Scanner
from phantoms.scene import Scene
from phantoms.series import SeriesOptions, tagged_thickness_mm
from phantoms.solids import Vector
from phantoms.stack import SliceStack


@dataclass(frozen=True)
class Examination:
    """A scene, its slices, the scanner's settings, what becomes of its images, and the seed of its noise."""

    scene: Scene
    stack: SliceStack
    scanner: Machine = field(default_factory=Scanner)
    seed: int = 0
    finish: Finish = field(default_factory=Finish)
    protocol: str = ""
    """Name of the protocol by which the scan is made, for the record."""

    @property
    def tagged_thickness_mm(self) -> float | None:
        """What the header says of the slices' thickness; None when it says nothing."""
        return tagged_thickness_mm(self.stack, self.finish.tag)

    @property
    def profile_fwhm_mm(self) -> float:
        """Full width at half maximum of the slices that the scanner reconstructs, as physics makes it."""
        return self.scanner.profile(self.finish.sources(self.stack)[0]).fwhm_mm

    @property
    def shown(self) -> Scene:
        """The scene with markers and decoys where they were, on average, while they were in the beam."""
        motion = self.scanner.motion
        if not motion.moves:
            return self.scene
        markers = []
        for one in self.scene.markers:
            span = self.scanner.seen_during(one.center_mm, one.diameter_mm / 2, self.stack)
            place, path = mean_place(motion, one.center_mm, span), timed_path(motion, one.center_mm, span)
            markers.append(replace(one, center_mm=place, path=path))
        decoys = []
        for other in self.scene.decoys:
            span = self.scanner.seen_during(other.center_mm, 0.0, self.stack)
            decoys.append(replace(other, center_mm=mean_place(motion, other.center_mm, span)))
        return replace(self.scene, markers=tuple(markers), decoys=tuple(decoys))

    def around(self, center_mm: Vector, reach_mm: float, *, crop: bool = False) -> Examination:
        """Return the same examination with only the slices within ``reach_mm`` of a place.

        The voxels of the slab equal those of the whole scan, so a benchmark need not scan whole heads. With
        ``crop`` the images, too, reach no farther, which saves the reconstruction; their noise is another draw.
        """
        return replace(self, stack=self.stack.around(center_mm, reach_mm, crop=crop))

    def crops(self, places_mm: Sequence[Vector] | NDArray[np.float64], reach_mm: float) -> list[Crop]:
        """Return the surroundings of each place (N, 3), all out of one scan: the scene is measured once."""
        near = [self.around(place, reach_mm, crop=True) for place in places_mm]
        images = self._stored(self.scanner, [one.stack for one in near])
        return [Crop(one, voxels) for one, voxels in zip(near, images, strict=True)]

    def images(self, *, fast: bool = False, progress: bool = False) -> NDArray[np.int16]:
        """Return the images (K, rows, columns) in HU, by the full scanner or by the fast renderer."""
        machine = like(self.scanner, self.finish.sources(self.stack)[0]) if fast else self.scanner
        return self._stored(machine, [self.stack], progress=progress)[0]

    def _stored(
        self, machine: Machine, stacks: Sequence[SliceStack], *, progress: bool = False
    ) -> list[NDArray[np.int16]]:
        sources = [self.finish.sources(stack)[0] for stack in stacks]
        images = machine.reconstruct(self.scene, sources, seed=self.seed, progress=progress)
        return [
            self.finish.apply(voxels, stack, extended_scale=machine.extended_scale)
            for voxels, stack in zip(images, stacks, strict=True)
        ]

    def options(self, *, fast: bool = False) -> SeriesOptions:
        """Return how the series is written."""
        drawn = fast or isinstance(self.scanner, Renderer)
        kernel = "FAST " + self.scanner.kernel if drawn else self.scanner.kernel
        return SeriesOptions(
            slope=self.finish.slope,
            tag=self.finish.tag,
            derived=self.finish.derived,
            description=self.scene.name or "Phantom",
            kernel=kernel.upper(),
            kilovolts=self.scanner.kilovolts,
            seed=self.seed,
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
        images = self.images(fast=fast, progress=progress)
        scan = sha256(repr(self.stack).encode() + images.tobytes()).hexdigest()
        write_phantom(
            folder,
            self.shown,
            self.stack,
            images,
            replace(options or self.options(fast=fast), scan=scan),
            protocol=self.protocol,
            renderer="fast" if fast or isinstance(self.scanner, Renderer) else "projection",
            profile_fwhm_mm=round(self.profile_fwhm_mm, 4),
            tagged_thickness_mm=self.tagged_thickness_mm,
            **asdict(self.scanner),
            finish=repr(self.finish),
            seed=self.seed,
        )


class Crop(NamedTuple):
    """A small part of a scan: how it lies, and its voxels (K, rows, columns) in HU."""

    examination: Examination
    images: NDArray[np.int16]
