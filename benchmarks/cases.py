"""Physically simulated scans of random patients: the material of the localization benchmark.

Each marker is scanned with everything that is in the room, but only the voxels about it are reconstructed, which
takes a twentieth of the time of whole scans. Scans can be kept in a folder and used again.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from phantoms.examination import Examination
from phantoms.library import laboratory_phantom
from phantoms.patients import random_patient
from phantoms.stack import SliceStack, axial_stack
from ronnaplan.ct import CTVolume, SliceGrid
from ronnaplan.geometry import FloatArray

REACH_MM = 10.0
"""Images are reconstructed this far beyond a marker's surface."""


@dataclass(frozen=True)
class Condition:
    """A row of the goals: what is scanned, and how far off the centres may be (mm)."""

    name: str
    mean_mm: float
    worst_mm: float
    kinds: tuple[str, ...] = ("post",)
    thicknesses_mm: tuple[float, ...] = (0.5, 0.6, 0.75, 1.0, 1.25)
    options: dict[str, float | bool] = field(default_factory=dict)
    laboratory: bool = False


CONDITIONS = (
    Condition("lab", 0.004, 0.010, thicknesses_mm=(0.5, 0.6, 0.75, 1.0), laboratory=True),
    Condition("patient", 0.010, 0.030),
    Condition("thick", 0.020, 0.050, thicknesses_mm=(2.0, 2.5, 3.0)),
    Condition("insert", 0.020, 0.060, ("post with insert",)),
    Condition("titanium", 0.014, 0.040, ("titanium 3", "titanium 4"), (0.6,)),
    Condition("steel", 0.030, 0.090, ("steel",)),
    Condition("ceramic", 0.010, 0.030, ("ceramic",)),
    Condition("low dose", 0.020, 0.060, options={"dose": 0.05}),
    Condition("tilted", 0.020, 0.060, options={"tilt_deg": 20.0}),
    Condition("uneven", 0.020, 0.060, options={"uneven": True}),
)


@dataclass(frozen=True)
class Case:
    """One marker's surroundings, and the true centres (M, 3) in LPS mm of all the patient's markers, its own first."""

    volume: CTVolume
    truth_mm: FloatArray
    diameter_mm: float


def examination(condition: Condition, seed: int) -> Examination:
    """Draw the patient of ``seed`` under ``condition``."""
    kind = condition.kinds[seed % len(condition.kinds)]
    thickness = condition.thicknesses_mm[seed % len(condition.thicknesses_mm)]
    if condition.laboratory:
        return _laboratory(seed, thickness)
    return random_patient(seed, kind=kind, thickness_mm=thickness, **condition.options)  # type: ignore[arg-type]


def _laboratory(seed: int, thickness_mm: float) -> Examination:
    generator = np.random.default_rng([seed, 7])
    turn = Rotation.from_rotvec(generator.uniform(-0.3, 0.3, 3)).as_matrix()
    scene = laboratory_phantom().moved(turn, tuple(generator.uniform(-8, 8, 3)))
    heights = [marker.center_mm[2] for marker in scene.markers]
    stack = axial_stack(
        start_mm=min(heights) - 20,
        stop_mm=max(heights) + 20 + generator.uniform(0, 1),
        spacing_mm=thickness_mm,
        field_of_view_mm=260.0,
    )
    return Examination(scene, stack, seed=seed)


def cases(condition: Condition, seed: int, cache: Path | None = None) -> Iterator[Case]:
    """Scan the surroundings of every marker of the patient of ``seed``."""
    patient = examination(condition, seed)
    markers = patient.scene.markers
    for number, marker in enumerate(markers):
        near = patient.around(marker.center_mm, marker.diameter_mm / 2 + REACH_MM, crop=True)
        if not near.stack.holds_whole(marker.center_mm, marker.diameter_mm):
            continue
        kept = cache / f"{condition.name}-{seed}-{number}.npy" if cache else None
        if kept is not None and kept.exists():
            voxels = np.load(kept)
        else:
            voxels = near.images()
            if kept is not None:
                np.save(kept, voxels)
        others = [other.center_mm for other in markers if other is not marker]
        yield Case(volume(near.stack, voxels), np.array([marker.center_mm, *others]), marker.diameter_mm)


def volume(stack: SliceStack, voxels: NDArray[np.int16]) -> CTVolume:
    """Lay scanned voxels on the grid that a reader would give them."""
    order = np.argsort(stack.positions_mm)
    grid = SliceGrid(
        stack.origins_mm[order],
        stack.row_direction * stack.pixel_mm,
        stack.column_direction * stack.pixel_mm,
        stack.thickness_mm,
    )
    return CTVolume(voxels[order], grid)
