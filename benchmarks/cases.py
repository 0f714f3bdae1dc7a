"""Scans of random patients with known markers: the material of the localization benchmark.

Whole patients come from the projection-domain scanner (about a minute and a half of one core each; they can be kept
in a folder and used again), the surroundings of single markers and decoys from the fast renderer.
"""

from __future__ import annotations

import glob
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from phantoms.anatomy import scalp_foot
from phantoms.decoys import DECOYS, decoy
from phantoms.examination import Examination
from phantoms.library import laboratory_phantom
from phantoms.markers import marker_kind
from phantoms.motion import Motion
from phantoms.patients import random_patient
from phantoms.scanner import Scanner
from phantoms.scene import Decoy, Marker, join
from phantoms.stack import SliceStack, axial_stack
from ronnaplan.ct import CTVolume, SliceGrid
from ronnaplan.geometry import FloatArray

LABORATORY_DECOYS = ((-0.60, 0.62, 0.50), (0.05, -0.75, 0.66), (0.62, 0.05, 0.78))
"""Directions to the decoys on the laboratory phantom, clear of its markers."""

SLAB_MARGIN_MM = 15.0
"""Slices are scanned this far beyond the outermost marker's or decoy's center."""

SCANNED_MARKERS, DECOYS_EACH = 20, 4
"""Markers and decoys on the head of each patient who is scanned by a protocol: as many as fit on two of five."""

JUMP = ", jump"
"""What the name of a condition adds to its protocol's where the head jumps."""

REACH_MM = 10.0
"""The fast renderer's images reach this far beyond a marker's or decoy's surface."""


@dataclass(frozen=True)
class Condition:
    """A row of the goals: what is scanned, and how far off the centers may be (mm)."""

    name: str
    mean_mm: float
    worst_mm: float
    kinds: tuple[str, ...] = ("post",)
    thicknesses_mm: tuple[float, ...] = (0.5, 0.6, 0.75, 1.0, 1.25)
    options: dict[str, float | bool] = field(default_factory=dict)
    markers: int = 12
    laboratory: bool = False
    one_row: bool = False
    """Whether the scanner has one row of detectors, as tall as a slice."""
    jump_mm: float = 0.0
    """How far the head jumps, in a direction of its own, somewhere in the middle half of the scan."""


CONDITIONS = (
    Condition("lab", 0.004, 0.010, ("plastic screw post",), (0.5, 0.6, 0.75, 1.0), markers=6, laboratory=True),
    Condition("patient", 0.010, 0.030),
    Condition("thick", 0.020, 0.050, thicknesses_mm=(2.0, 2.5, 3.0)),
    Condition("insert", 0.020, 0.060, ("post with insert",)),
    Condition("titanium", 0.014, 0.040, ("titanium 3", "titanium 4"), (0.6,)),
    Condition("steel", 0.030, 0.090, ("steel",)),
    Condition("ceramic", 0.010, 0.030, ("ceramic",)),
    Condition("low dose", 0.020, 0.060, options={"dose": 0.05}),
    Condition("tilted", 0.020, 0.060, options={"tilt_deg": 20.0}),
    Condition("uneven", 0.020, 0.060, options={"uneven": True}),
    Condition("no markers", 0.0, 0.0, ("post", "ceramic", "steel", "titanium 4", "titanium 3"), markers=0),
)

ONE_ROW = Condition("one row", 0.025, 0.080, thicknesses_mm=(3.0, 5.0), one_row=True)
"""Slices of a scanner whose rays are summed before the logarithm; only whole scans tell what lies beside the ball."""

WHOLE = (*CONDITIONS, ONE_ROW)
"""What whole scans are made of."""

SEED_STEP = 20
"""Each condition has patients of its own: the seeds of its patients are so far apart; no scene has as many things."""

PROTOCOLS = (
    Condition("axial", 0.015, 0.060),
    Condition("axial very soft", 0.015, 0.060),
    Condition("axial bone", 0.020, 0.060),
    Condition("axial edge", 0.020, 0.060),
    Condition("axial total variation", 0.020, 0.060),
    Condition("axial non-local means", 0.020, 0.060),
    Condition("axial overlapping", 0.015, 0.060),
    Condition("oblique", 0.015, 0.060),
    Condition("1.5 mm every 0.5 mm", 0.015, 0.060),
    Condition("3 mm", 0.025, 0.080),
    Condition("5 mm every 2.5 mm", 0.025, 0.080),
    Condition("5 mm", 0.025, 0.080),
    Condition("helix 4 x 1.25, 180LI", 0.015, 0.060),
    Condition("helix 32 x 0.6", 0.015, 0.060),
    Condition("cone beam", 0.020, 0.060),
    Condition("cone beam short", 0.020, 0.060),
    Condition("cone beam lag", 0.020, 0.060),
    Condition("helix 4 x 1.25, 360LI", 0.015, 0.060),
    Condition("axial penalized", 0.020, 0.060),
    Condition("axial, jump", 0.015, 0.060, jump_mm=0.5),
    Condition("helix 32 x 0.6, jump", 0.015, 0.060, jump_mm=0.5),
    Condition("cone beam, jump", 0.020, 0.060, jump_mm=0.5),
    Condition("axial slope 2", 0.015, 0.060),
    Condition("axial gapped", 0.025, 0.080),
    Condition("axial motion", 0.015, 0.060),
    Condition("cone beam truncated", 0.020, 0.060),
    Condition("cone beam motion", 0.020, 0.060),
    Condition("helix 16 x 0.75", 0.015, 0.060),
    Condition("helix 64 x 0.6", 0.015, 0.060),
    Condition("helix 32 x 0.6, thick", 0.025, 0.080),
    Condition("helix 32 x 0.6, edge", 0.020, 0.060),
    Condition("helix 32 x 0.6, denoised", 0.020, 0.060),
    Condition("helix 32 x 0.6, fast", 0.020, 0.060),
    Condition("helix motion", 0.015, 0.060),
)
"""Scans as hospitals make them, by the names of `phantoms.protocols`; their tags are often wrong or missing."""


@dataclass(frozen=True)
class Case:
    """A scan, and the true centers in LPS mm of the markers wholly in it (M, 3) and of those cut by its edge."""

    volume: CTVolume
    truth_mm: FloatArray
    cut_mm: FloatArray
    diameter_mm: float


def examination(condition: Condition, first: int, number: int) -> Examination:
    """Draw the patient ``number`` of ``condition``, counted from the seed ``first``."""
    seed = first + SEED_STEP * number + WHOLE.index(condition)
    kind, thickness = _kind(condition, number), condition.thicknesses_mm[number % len(condition.thicknesses_mm)]
    if condition.laboratory:
        return _laboratory(seed, kind, thickness)
    options: dict[str, float | bool] = {"thickness_mm": thickness, **condition.options}
    patient = random_patient(seed, kind=kind, count=condition.markers, **options)  # type: ignore[arg-type]
    if condition.one_row:
        patient = replace(patient, scanner=Scanner(kernel=patient.scanner.kernel, one_row=True))
    return replace(patient, stack=_slab(patient))


def _slab(patient: Examination) -> SliceStack:
    """Return the slices from the lowest to the highest marker or decoy, and a little beyond."""
    stack, scene = patient.stack, patient.scene
    things: tuple[Marker | Decoy, ...] = (*scene.markers, *scene.decoys)
    heights = [one.center_mm @ stack.normal for one in things]
    places = stack.positions_mm
    kept = (places > min(heights) - SLAB_MARGIN_MM) & (places < max(heights) + SLAB_MARGIN_MM)
    return replace(stack, centers_mm=stack.centers_mm[kept])


def _kind(condition: Condition, number: int) -> str:
    return condition.kinds[number % len(condition.kinds)]


def _laboratory(seed: int, kind: str, thickness_mm: float) -> Examination:
    generator = np.random.default_rng([seed, 7])
    names = generator.choice(list(DECOYS), len(LABORATORY_DECOYS), replace=False)
    others = [decoy(str(name), scalp_foot(at), kind) for name, at in zip(names, LABORATORY_DECOYS, strict=True)]
    turn = Rotation.from_rotvec(generator.uniform(-0.3, 0.3, 3)).as_matrix()
    scene = join([laboratory_phantom(), *others], "laboratory phantom with decoys")
    scene = scene.moved(turn, tuple(generator.uniform(-8, 8, 3)))
    things: tuple[Marker | Decoy, ...] = (*scene.markers, *scene.decoys)
    heights = [one.center_mm[2] for one in things]
    stack = axial_stack(
        start_mm=min(heights) - 20,
        stop_mm=max(heights) + 20 + generator.uniform(0, 1),
        spacing_mm=thickness_mm,
        field_of_view_mm=260.0,
    )
    return Examination(scene, stack, seed=seed)


def whole_scan(condition: Condition, first: int, number: int, cache: Path | None = None) -> Case:
    """Scan a patient with the projection-domain scanner, or take the scan from ``cache``."""
    patient = examination(condition, first, number)
    kept = cache / f"{condition.name}-{patient.seed}.npy" if cache else None
    if kept is not None and kept.exists():
        voxels = np.load(kept)
    else:
        voxels = patient.images()
        if kept is not None:
            np.save(kept, voxels)
    return _case(patient, voxels, _kind(condition, number))


def surroundings(condition: Condition, first: int, number: int) -> Iterator[Case]:
    """Render the surroundings of each marker and decoy of a patient with the fast renderer, each with its own noise."""
    patient = examination(condition, first, number)
    patient.scene.check()
    kind = _kind(condition, number)
    reach_mm = marker_kind(kind).diameter_mm / 2 + REACH_MM
    things: tuple[Marker | Decoy, ...] = (*patient.scene.markers, *patient.scene.decoys)
    for place, thing in enumerate(things):
        near = replace(patient.around(thing.center_mm, reach_mm, crop=True), seed=patient.seed * SEED_STEP + place)
        yield _case(near, near.images(fast=True), kind)


def protocol_scan(condition: Condition, first: int, number: int, cache: Path | None = None) -> list[Case]:
    """Scan a patient by a protocol: the surroundings of each marker and decoy, all out of one scan.

    They are kept in ``cache``, or taken from there.
    """
    seed = first + SEED_STEP * number + PROTOCOLS.index(condition)
    kept = cache / f"{condition.name}-{seed}.npz" if cache else None
    if kept is not None and kept.exists():
        return kept_cases(kept)
    kind = _kind(condition, number)
    patient = random_patient(
        seed,
        protocol=condition.name.removesuffix(JUMP),
        kind=kind,
        count=SCANNED_MARKERS,
        decoys=DECOYS_EACH,
    )
    if condition.jump_mm:
        patient = replace(patient, scanner=replace(patient.scanner, motion=_jump(condition.jump_mm, seed)))
    return scanned(patient, kind, kept)


def scanned(patient: Examination, kind: str, kept: Path | None) -> list[Case]:
    """Scan a patient: the surroundings of each marker and decoy, all out of one scan, which is written to ``kept``."""
    things: list[Marker | Decoy] = [*patient.scene.markers, *patient.scene.decoys]
    reach_mm = marker_kind(kind).diameter_mm / 2 + REACH_MM + patient.profile_fwhm_mm
    crops = patient.crops([one.center_mm for one in things], reach_mm)
    cases = [_case(near, voxels, kind) for near, voxels in crops]
    if kept is not None:
        keep(cases, kept)
    return cases


def _jump(length_mm: float, seed: int) -> Motion:
    generator = np.random.default_rng([seed, 8])
    way = generator.standard_normal(3)
    x, y, z = length_mm * way / np.linalg.norm(way)
    return Motion("jump", (float(x), float(y), float(z)), when=float(generator.uniform(0.25, 0.75)))


def keep(cases: list[Case], file: Path) -> None:
    """Write cases to a file."""
    arrays: dict[str, NDArray[np.generic]] = {}
    for n, case in enumerate(cases):
        grid = case.volume.grid
        steps = np.array([grid.column_step_mm, grid.row_step_mm])
        sizes = np.array([np.nan if grid.thickness_mm is None else grid.thickness_mm, case.diameter_mm])
        arrays |= {f"voxels{n}": case.volume.voxels_hu, f"origins{n}": grid.origins_mm, f"steps{n}": steps}
        arrays |= {f"truth{n}": case.truth_mm, f"cut{n}": case.cut_mm, f"sizes{n}": sizes}
    np.savez(file, **arrays)  # type: ignore[arg-type]  # of any kind


def kept_scans(condition: Condition, folder: Path) -> list[Path]:
    """Return the files of a condition's patients that `protocol_scan` has kept in ``folder``."""
    return sorted(folder.glob(f"{glob.escape(condition.name)}-[0-9]*.npz"))


def kept_cases(file: Path) -> list[Case]:
    """Read what `keep` has written."""
    cases = []
    with np.load(file) as kept:
        for n in range(len(kept.files) // 6):
            column_step, row_step = kept[f"steps{n}"]
            thickness, diameter = map(float, kept[f"sizes{n}"])
            grid = SliceGrid(
                kept[f"origins{n}"], row_step, column_step, None if np.isnan(thickness) else thickness
            )
            volume = CTVolume(kept[f"voxels{n}"], grid)
            cases.append(Case(volume, kept[f"truth{n}"], kept[f"cut{n}"], diameter))
    return cases


def _case(patient: Examination, voxels: NDArray[np.int16], kind: str) -> Case:
    """Return a scan as a case: its markers' places while it was made, on the grid that a reader would give."""
    whole: list[FloatArray] = []
    cut: list[FloatArray] = []
    for one in patient.shown.markers:
        is_whole = patient.stack.holds_whole(one.center_mm, one.diameter_mm)
        (whole if is_whole else cut).append(one.center_mm)
    truth, rest = np.reshape(whole, (-1, 3)), np.reshape(cut, (-1, 3))
    scanned = volume(patient.stack, voxels, patient.tagged_thickness_mm)
    return Case(scanned, truth, rest, marker_kind(kind).diameter_mm)


def volume(stack: SliceStack, voxels: NDArray[np.int16], thickness_mm: float | None) -> CTVolume:
    """Lay scanned voxels on the grid that a reader would give them, with what the header says of the thickness."""
    order = np.argsort(stack.positions_mm)
    grid = SliceGrid(
        stack.origins_mm[order],
        stack.row_direction * stack.pixel_mm,
        stack.column_direction * stack.pixel_mm,
        thickness_mm,
    )
    return CTVolume(voxels[order], grid)
