#!/usr/bin/env python3
"""Show that the phantom scanner is right: one table of claims, measured values and limits.

python benchmarks/phantom_physics.py             the table (about three minutes on two cores)
python benchmarks/phantom_physics.py --quick     fewer cases (half a minute)
python benchmarks/phantom_physics.py --pictures DIR   draw docs/images/phantom_*.png instead
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from phantoms import library
from phantoms.anatomy import Foot
from phantoms.averages import average_hu
from phantoms.cone_beam import ConeBeam
from phantoms.coverings import FILM_MM
from phantoms.helix import Helix
from phantoms.kernels import KERNELS
from phantoms.machine import Machine
from phantoms.markers import Condition, MarkerKind, marker, marker_kind
from phantoms.materials import MATERIALS
from phantoms.motion import Form, Motion
from phantoms.scanner import Scanner
from phantoms.scene import Part, Scene
from phantoms.solids import FloatArray, cylinder, sphere
from phantoms.stack import SliceStack, axial_stack

Row = tuple[str, str, str, bool]
"""Claim, measured, limit, whether it holds."""

BALLS = (
    ("acrylic", 11.5, 2.0),
    ("acrylic", 4.0, 2.0),
    ("ceramic", 10.0, 2.0),
    ("titanium", 3.0, 6.0),
    ("steel", 5.0, 6.0),
)
"""Material, diameter in mm, and how far the centroid may be off in micrometres.

Metal absorbs so much that a detector element half in its shadow reads wrong (the non-linear partial-volume effect
of every real scanner), hence the wider limit.
"""
HOME = np.array([45.0, -30.0, 0.0])
"""Where the balls are scanned: away from the center of rotation, where errors would show."""
TURN = np.linalg.qr(np.array([[0.3, -0.5, 0.8], [0.9, 0.2, -0.4], [0.1, 0.7, 0.6]]))[0]
TURN *= np.sign(np.linalg.det(TURN))


def hu(scene: Scene, stack: SliceStack, scanner: Machine, seed: int = 0) -> FloatArray:
    """Return the images in HU, neither rounded nor clipped."""
    return scanner.reconstruct(scene, [stack], seed=seed)[0].astype(np.float64)


def places(stack: SliceStack) -> FloatArray:
    """Return where every voxel is (K, rows, columns, 3)."""
    v, u = np.mgrid[: stack.rows, : stack.columns] * stack.pixel_mm
    in_plane = v[..., np.newaxis] * stack.row_direction + u[..., np.newaxis] * stack.column_direction
    found: FloatArray = stack.origins_mm[:, np.newaxis, np.newaxis] + in_plane
    return found


def moments(
    excess: FloatArray, stack: SliceStack, center: FloatArray, reach_mm: float
) -> tuple[FloatArray, float]:
    """Return centroid (mm) and mass (HU x mm3) of what rises above the surroundings near ``center``."""
    points = places(stack)
    weights = np.where(np.linalg.norm(points - center, axis=-1) < reach_mm, excess, 0.0)
    centroid = np.average(points.reshape(-1, 3), axis=0, weights=weights.ravel())
    gap = float(np.diff(stack.positions_mm).mean())
    return centroid, float(weights.sum()) * stack.pixel_mm**2 * gap


def ball_stack(diameter_mm: float, spacing_mm: float, thickness_mm: float, **options: object) -> SliceStack:
    """Return slices about `HOME` that hold a ball with a margin."""
    half = diameter_mm / 2 + thickness_mm + 2
    return axial_stack(
        start_mm=-half,
        stop_mm=half,
        spacing_mm=spacing_mm,
        thickness_mm=thickness_mm,
        matrix=160,
        field_of_view_mm=60,
        center_mm=HOME,
        **options,  # type: ignore[arg-type]
    )


def water(quick: bool) -> Iterator[Row]:
    """Check that water is 0 HU and flat across a 200 mm disc."""
    stack = axial_stack(start_mm=0, stop_mm=0, matrix=256 if quick else 512)
    radius = np.linalg.norm(places(stack)[0, ..., :2], axis=-1)
    for kernel in KERNELS:
        for kilovolts in (120.0,) if quick else (80.0, 120.0, 140.0):
            image = hu(library.water_disc(), stack, Scanner(dose=0, kernel=kernel, kilovolts=kilovolts))[0]
            inside = image[radius < 96]
            worst = float(np.abs(inside).max())
            name = f"water, {kernel}, {kilovolts:.0f} kV: mean; farthest pixel (r < 96 mm)"
            yield name, f"{inside.mean():+.2f}; {worst:.2f} HU", "0 +- 3 HU", worst < 3


def noise(quick: bool) -> Iterator[Row]:
    """Check that noise falls with the square root of dose, and show what the electronics add at low dose."""
    stack = axial_stack(start_mm=0, stop_mm=0, matrix=256, field_of_view_mm=120)
    doses = (0.25, 1.0) if quick else (0.05, 0.25, 1.0, 4.0)
    quantum = [Scanner(dose=dose, electronic_noise=0.0) for dose in doses]
    levels = np.array([hu(library.water_disc(), stack, scanner, seed=1).std() for scanner in quantum])
    scaled = levels * np.sqrt(doses)
    text = ", ".join(f"{level:.2f} HU at {dose:g}" for level, dose in zip(levels, doses, strict=True))
    worst = float(np.abs(scaled / scaled[-1] - 1).max())
    yield f"noise x sqrt(dose): largest change ({text})", f"{100 * worst:.1f} %", "5 %", worst < 0.05
    low = hu(library.water_disc(), stack, Scanner(dose=0.05), seed=1).std()
    yield "noise at dose 0.05 with electronic noise (information)", f"{low:.1f} HU", "", True
    for kernel in KERNELS:
        level = hu(library.water_disc(), stack, Scanner(kernel=kernel), seed=2).std()
        yield f"noise of {kernel}, 1 mm, dose 1 (information)", f"{level:.1f} HU", "", True


def centroids(quick: bool) -> Iterator[Row]:
    """Check that a ball is where it should be, in any orientation; metal is blurred by physics, not by us."""
    generator = np.random.default_rng(11)
    cases: list[tuple[str, dict[str, object]]] = [("axial", {}), ("oblique", {"orientation": TURN})]
    cases += [("tilted 20 deg", {"tilt_deg": 20.0}), ("tilted, oblique", {"tilt_deg": -15.0, "orientation": TURN})]
    for material, diameter, limit in BALLS:
        spacing = 1.0 if diameter > 11 else 0.5
        for name, options in cases[:: 3 if quick else 1]:
            errors = []
            for _ in range(1 if quick else 3):
                turn = np.asarray(options.get("orientation", np.eye(3)))
                center = turn @ (HOME + generator.uniform(-0.5, 0.5, 3))
                stack = ball_stack(diameter, spacing, spacing, **options)
                excess = hu(Scene((Part(sphere(center, diameter), material),)), stack, Scanner(dose=0)) + 1000
                errors.append((moments(excess, stack, center, diameter / 2 + 6)[0] - center) @ turn)
            worst = np.abs(errors).max(axis=0) * 1000
            text = ", ".join(f"{value:.2f}" for value in worst)
            label = f"centroid of {material} {diameter:g} mm, {spacing:g} mm slices, {name}: x, y, z"
            yield label, f"{text} um", f"{limit:g} um", bool(worst.max() < limit)


def masses(quick: bool) -> Iterator[Row]:
    """Check that mass does not depend on kernel and slice thickness."""
    center = HOME + np.array([0.21, 0.13, 0.37])
    for material, diameter in (("acrylic", 11.5), ("titanium", 3.0)):
        scene = Scene((Part(sphere(center, diameter), material),))
        found = []
        thicknesses = ((0.5, 0.5), (3.0, 3.0)) if quick else ((0.5, 0.5), (1, 1), (2, 1), (3, 3), (5, 2.5), (5, 5))
        for kernel in KERNELS:
            for thickness, spacing in thicknesses:
                stack = ball_stack(diameter, spacing, thickness)
                excess = hu(scene, stack, Scanner(dose=0, kernel=kernel)) + 1000
                found.append(moments(excess, stack, center, diameter / 2 + 5 + thickness)[1])
        spread = max(found) / min(found) - 1
        label = f"mass of {material} {diameter:g} mm over kernels and thickness 0.5 to 5 mm: spread"
        yield label, f"{100 * spread:.2f} %", "1 %", spread < 0.01


def fast_renderer(quick: bool) -> Iterator[Row]:
    """Check that the fast renderer keeps place and mass too."""
    errors, ratios = [], []
    for tilt in (0.0, 20.0):
        center = HOME + np.array([0.21, 0.13, 0.37])
        stack = ball_stack(11.5, 1.0, 1.0, tilt_deg=tilt)
        excess = average_hu(Scene((Part(sphere(center, 11.5), "acrylic"),)), stack) + 1000
        centroid, mass = moments(excess, stack, center, 11.5)
        errors.append(np.abs(centroid - center).max() * 1000)
        ratios.append(mass / (excess.max() * np.pi / 6 * 11.5**3) - 1)
    yield "fast renderer, acrylic 11.5 mm: centroid", f"{max(errors):.2f} um", "2 um", max(errors) < 2
    worst = float(np.abs(ratios).max())
    yield "fast renderer, acrylic 11.5 mm: mass against the solid's", f"{100 * worst:.2f} %", "1 %", worst < 0.01


def cone_beam(quick: bool) -> Iterator[Row]:
    """Check place, water and noise of the cone-beam scanner; half a turn is exact only in its middle plane."""
    full = ConeBeam(dose=0, views=360)
    places_mm = ((45.1, -30.2, 0.1), (45.1, -30.2, 40.3), (0.1, 0.2, 60.3), (-80.2, 60.1, 45.2))
    for name, scanner, limit in (("full turn", full, 4.0), ("short", replace(full, turn="short"), 25.0)):
        found = [_cone_error(np.array(place), scanner) for place in places_mm[: 2 if quick else 4]]
        worst = np.abs(found).max(axis=0)
        text = ", ".join(f"{value:.2f}" for value in worst)
        yield (
            f"cone beam, {name}: centroid of 11.5 mm ball: x, y, z",
            f"{text} um",
            f"{limit:g} um",
            worst.max() < limit,
        )
    rod = _cone_error(np.array([45.1, -30.2, 0.0]), replace(full, turn="short"), rod=True)
    worst_rod = float(np.abs(rod).max())
    yield "cone beam, short: centroid of 11.5 mm rod along the axis", f"{worst_rod:.2f} um", "4 um", worst_rod < 4
    stack = axial_stack(start_mm=0, stop_mm=0, spacing_mm=0.4, matrix=500, field_of_view_mm=200)
    disc = Scene((Part(cylinder((0, 0, -60), (0, 0, 1), 120, 160), "water"),))
    (image,) = full.reconstruct(disc, [stack])
    inside = np.linalg.norm(places(stack)[..., :2], axis=-1) < 76
    worst_hu = float(np.abs(image[inside]).max())
    yield (
        "cone beam, water over a 160 mm disc: farthest pixel (r < 76 mm)",
        f"{worst_hu:.2f} HU",
        "4 HU",
        worst_hu < 4,
    )
    small = stack.around((0, 0, 0), 20, crop=True)
    levels = [
        (replace(full, dose=dose, electronic_noise=0.0).reconstruct(disc, [small])[0]).std()
        for dose in (1.0, 0.25)
    ]
    text = f"{levels[0]:.1f}, {levels[1]:.1f} HU"
    yield (
        "cone beam, noise at dose 1 and 0.25, 0.4 mm voxels",
        text,
        "x 2 +- 5 %",
        abs(levels[1] / levels[0] - 2) < 0.1,
    )


def _cone_error(center: FloatArray, scanner: ConeBeam, *, rod: bool = False) -> FloatArray:
    """Return how far the centroid of a plastic ball or rod is off in a cone-beam scan, in micrometres."""
    reach = 0.0 if rod else 11.0
    stack = axial_stack(
        start_mm=center[2] - reach,
        stop_mm=center[2] + reach,
        spacing_mm=0.4,
        matrix=640,
        field_of_view_mm=256,
    ).around(center, 11, crop=True)
    solid = cylinder((*center[:2], -150), (0, 0, 1), 300, 11.5) if rod else sphere(center, 11.5)
    (images,) = scanner.reconstruct(Scene((Part(solid, "acrylic"),)), [stack])
    points = places(stack)
    weights = np.where(np.linalg.norm(points - center, axis=-1) < 8.25, images + 1000.0, 0.0)
    return (np.average(points.reshape(-1, 3), axis=0, weights=weights.ravel()) - center) * 1000


def markers_as_they_are(quick: bool) -> Iterator[Row]:
    """Check the mass of what is hollow, and how far a film of known thickness shifts it."""
    foot = Foot(HOME, np.array([0.0, 0.6, 0.8]))
    for name in ("hollow ceramic", "ceramic"):
        known = marker_kind(name)
        scene = marker("M1", foot, known, Condition(oversize_mm=-0.15, out_of_round=0.02, seed=3))
        (truth,) = scene.markers
        outer = truth.diameter_mm
        inner = outer - 2 * known.wall_mm if known.wall_mm else 0.0
        centroid, mass = _mass(scene)
        expected = (MATERIALS[known.material].nominal_hu + 1000) * np.pi / 6 * (outer**3 - inner**3)
        off = float(np.abs(centroid - truth.center_mm).max() * 1000)
        wrong = abs(mass / expected - 1)
        label = f"{name}, 0.15 mm too small, 2 % out of round: centroid; mass against the solid's"
        yield label, f"{off:.2f} um; {100 * wrong:.2f} %", "2 um; 1 %", off < 2 and wrong < 0.01
    scene = marker("M1", foot, MarkerKind(11.5, "acrylic"), Condition(covering="film", seed=2))
    ball, film = (MATERIALS[name].nominal_hu + 1000 for name in ("acrylic", "polyester"))
    share = film * (11.5 + FILM_MM) ** 3
    shift = float(np.linalg.norm(_mass(scene)[0] - scene.markers[0].center_mm)) * 1000
    wanted = FILM_MM / 2 * share / (share + (ball - film) * 11.5**3) * 1000
    off = abs(shift - wanted)
    yield (
        "one-sided film, 0.5 mm: shift of the centroid; off theory",
        f"{shift:.1f}; {off:.2f} um",
        "2 um",
        off < 2,
    )


def _mass(scene: Scene) -> tuple[FloatArray, float]:
    """Return centroid and mass of a scene about its marker, drawn by the fast renderer."""
    center = scene.markers[0].center_mm
    stack = axial_stack(
        start_mm=center[2] - 11,
        stop_mm=center[2] + 11,
        spacing_mm=0.7,
        matrix=80,
        field_of_view_mm=24,
        center_mm=(*center[:2], 0),
    )
    return moments(average_hu(scene, stack) + 1000, stack, center, 12)


def motion(quick: bool) -> Iterator[Row]:
    """Check that who has moved is shown where he is, and who drifts where theory has him."""
    place, views = np.array([45.1, -30.2, 20.3]), 240
    cases: tuple[tuple[str, Form], ...] = (("has moved before", "jump"), ("drifts 0.5 mm", "drift"))
    for name, form in cases:
        moving = Motion(form, (0.3, -0.2, 0.35), (0.2, 0.1, -0.3) if form == "jump" else (0.0, 0.0, 0.0), 0.0)
        expected = _seen_in_full_turn(moving.path(place, np.linspace(0, 1, views)) - place)
        off = _cone_error(place, ConeBeam(dose=0, views=views, motion=moving)) - expected * 1000
        worst = float(np.abs(off).max())
        yield f"cone beam, patient who {name}: centroid against theory", f"{worst:.2f} um", "6 um", worst < 6


def _seen_in_full_turn(shifts_mm: FloatArray) -> FloatArray:
    """Return the shift (3,) that the image shows of one that differs from view to view (V, 3).

    Each view tells the shift along the axis, and that across its own direction; together they are least squares.
    """
    angles = 2 * np.pi * np.arange(len(shifts_mm)) / len(shifts_mm)
    across = np.column_stack([-np.sin(angles), np.cos(angles)])
    told = np.sum(shifts_mm[:, :2] * across, axis=1)
    return np.array([*(2 * np.mean(told[:, np.newaxis] * across, axis=0)), shifts_mm[:, 2].mean()])


def helix(quick: bool) -> Iterator[Row]:
    """Check a ball's place, the slice profile, water and noise of helical scans."""
    few = Helix(dose=0, views=240, rows=4, row_mm=1.25, pitch=0.75, method="180LI")
    many = Helix(dose=0, views=480, pitch=0.52)
    scanners = (
        (few, many) if quick else (few, replace(few, method="360LI"), many, replace(many, rows=64, pitch=0.56))
    )
    for scanner in scanners:
        name = f"{scanner.method} {scanner.rows} x {scanner.row_mm:g}, pitch {scanner.pitch:g}"
        center = HOME + np.array([0.21, -0.13, 3.37])
        stack = axial_stack(start_mm=-7, stop_mm=14, spacing_mm=scanner.row_mm, matrix=60, field_of_view_mm=27)
        stack = replace(stack, aside_mm=(45.0, -30.0))
        excess = hu(Scene((Part(sphere(center, 11.5), "acrylic"),)), stack, scanner) + 1000
        worst = np.abs(moments(excess, stack, center, 8.75)[0] - center) * 1000
        text = ", ".join(f"{value:.1f}" for value in worst)
        yield f"centroid of acrylic 11.5 mm, {name}: x, y, z", f"{text} um", "4 um", bool(worst.max() < 4)
        found, stated = _helical_width(scanner), scanner.profile(stack).fwhm_mm
        good = abs(found / stated - 1) < 0.05
        yield f"width of the slice profile, {name}; theory {stated:.3f} mm", f"{found:.3f} mm", "5 %", good
    stack = axial_stack(start_mm=0, stop_mm=0, thickness_mm=0.6, matrix=128)
    radius = np.linalg.norm(places(stack)[0, ..., :2], axis=-1)
    for scanner in (few, many)[: 1 if quick else 2]:
        image = hu(library.water_disc(), stack, replace(scanner, dose=1.0))[0]
        text, good = f"{image[radius < 90].mean():+.2f} HU", bool(abs(image[radius < 90].mean()) < 1)
        yield (
            f"water, {scanner.method}, dose 1; noise in the middle {image[radius < 40].std():.1f} HU",
            text,
            "1 HU",
            good,
        )


def _helical_width(scanner: Helix) -> float:
    """Return the full width at half maximum that a thin disc shows at the axis."""
    disc = Scene((Part(cylinder((0, 0, 3.3), (0, 0, 1), 0.1, 16), "acrylic"),))
    reach = 2.2 * scanner.row_mm
    stack = axial_stack(
        start_mm=3.35 - reach,
        stop_mm=3.35 + reach,
        spacing_mm=0.1,
        thickness_mm=scanner.row_mm,
        matrix=16,
        field_of_view_mm=6,
    )
    seen = hu(disc, stack, scanner)[:, 4:12, 4:12].mean(axis=(1, 2)) + 1000
    fine = np.linspace(-reach, reach, 8001)
    curve = np.interp(fine, stack.positions_mm - 3.35, seen)
    return float(np.ptp(fine[curve >= curve.max() / 2]))


def speed(quick: bool) -> Iterator[Row]:
    """Time a 512 x 512 slice: at most a second on two cores."""
    patient = library.ready("patient-8")
    slab = patient.around(patient.scene.markers[0].center_mm, 2.5 if quick else 6.0)
    slab.around(patient.scene.markers[0].center_mm, 0.6).images()
    for fast in (False, True):
        start, used = time.perf_counter(), time.process_time()
        slab.images(fast=fast)
        each = (time.perf_counter() - start) / len(slab.stack)
        work = (time.process_time() - used) / len(slab.stack) / 2
        name = "fast renderer" if fast else "scanner"
        claim = f"{name}: 512 x 512 slice, 1 mm: processor time / 2 cores (wall clock now {each:.2f} s)"
        yield claim, f"{work:.2f} s", "1 s", work < 1


def validator(quick: bool) -> Iterator[Row]:
    """Let an independent validator look at the DICOM."""
    if shutil.which("dciodvfy") is None:
        yield "dciodvfy (Debian's dicom3tools) is not installed", "skipped", "", True
        return
    with tempfile.TemporaryDirectory() as folder:
        examination = library.ready("patient-3")
        target = Path(folder) / "ct"
        examination.around((0, 0, 50), 3).write(target, fast=True)
        faults = 0
        for path in target.glob("*.dcm"):
            answer = subprocess.run(["dciodvfy", str(path)], capture_output=True, text=True, check=False).stderr
            faults += answer.count("Error") + answer.count("Warning")
    yield "dciodvfy: errors and warnings", str(faults), "0", faults == 0


CHECKS: tuple[Callable[[bool], Iterator[Row]], ...] = (
    water,
    noise,
    centroids,
    masses,
    fast_renderer,
    cone_beam,
    helix,
    markers_as_they_are,
    motion,
    speed,
    validator,
)


def table(quick: bool) -> bool:
    """Print one line a claim as it is measured; returns whether all hold."""
    good = True
    print(f"{'claim':92}{'measured':>24}  {'limit':10}")
    for check in CHECKS:
        for claim, measured, limit, holds in check(quick):
            print(f"{claim:92}{measured:>24}  {limit:10}{'' if holds else ' FAILS'}", flush=True)
            good = good and holds
    return good


def pictures(folder: Path) -> None:
    """Draw the pictures of the documentation."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    def save(
        name: str, panels: list[tuple[str, FloatArray, tuple[float, float]]], columns: int, height: float = 3.1
    ) -> None:
        lines = -(-len(panels) // columns)
        figure, axes = plt.subplots(lines, columns, figsize=(2.8 * columns, height * lines), squeeze=False)
        for axis in axes.flat:
            axis.axis("off")
        for axis, (title, image, window) in zip(axes.flat, panels, strict=False):
            axis.imshow(image, cmap="gray", vmin=window[0], vmax=window[1])
            axis.set_title(title, fontsize=9)
        figure.tight_layout()
        figure.savefig(folder / name, dpi=80)
        plt.close(figure)

    folder.mkdir(parents=True, exist_ok=True)
    save("phantom_streaks.png", list(_streaks()), 3)
    save("phantom_kernels.png", list(_kernels()), 3)
    save("phantom_scenes.png", list(_scenes()), 4, 2.4)


def _one_slice(name: str, height_mm: float, field_of_view_mm: float = 270.0, **scanner: object) -> FloatArray:
    examination = library.ready(name)
    stack = axial_stack(start_mm=height_mm, stop_mm=height_mm, field_of_view_mm=field_of_view_mm)
    settings = Scanner(**scanner)  # type: ignore[arg-type]
    found: FloatArray = replace(examination, stack=stack, scanner=settings).images()[0].astype(np.float64)
    return found


def _streaks() -> Iterator[tuple[str, FloatArray, tuple[float, float]]]:
    window = (-400.0, 600.0)
    yield "amalgam fillings", _one_slice("patient-8", -92), window
    titanium = library.ready("patient-8").scene.markers[1].center_mm[2] - 12
    yield "titanium bone screws", _one_slice("patient-8", float(titanium)), window
    insert = library.ready("patient-insert").scene.markers[0].center_mm[2]
    yield "metal insert in a marker", _one_slice("patient-insert", float(insert) - 1), (-1100.0, 600.0)
    steel = library.ready("patient-steel").scene.markers[0].center_mm[2]
    yield "5 mm steel balls", _one_slice("patient-steel", float(steel)), (-1100.0, 300.0)
    yield "posterior fossa, no scatter", _one_slice("patient-8", -40, dose=4.0), (-60.0, 140.0)
    yield "posterior fossa, scatter 0.02", _one_slice("patient-8", -40, dose=4.0, scatter=0.02), (-60.0, 140.0)


def _kernels() -> Iterator[tuple[str, FloatArray, tuple[float, float]]]:
    center = library.ready("patient-5").scene.markers[0].center_mm
    examination = library.ready("patient-5")
    for dose in (1.0, 0.05):
        for kernel in KERNELS:
            stack = axial_stack(
                start_mm=center[2],
                stop_mm=center[2],
                matrix=128,
                field_of_view_mm=60,
                center_mm=(*center[:2], 0.0),
            )
            scanned = replace(examination, stack=stack, scanner=Scanner(kernel=kernel, dose=dose))
            yield f"{kernel}, dose {dose:g}", scanned.images()[0].astype(np.float64), (-1100.0, 400.0)


def _scenes() -> Iterator[tuple[str, FloatArray, tuple[float, float]]]:
    alike = {"patient-4", "patient-5", "patient-6", "patient-7", "water-disc"}
    for name in (name for name in library.READY if name not in alike):
        examination = library.ready(name)
        stack = examination.stack.changed(matrix=160, spacing_mm=1.75, start_mm=-70, stop_mm=138)
        images = replace(examination, stack=stack).images(fast=True).astype(np.float64)
        radiograph = np.sqrt(np.maximum(images + 1000, 0).mean(axis=1))[::-1]
        yield name, radiograph, (0.0, float(np.percentile(radiograph, 99.8)))


def main() -> int:
    """Print the table or draw the pictures."""
    parser = argparse.ArgumentParser(description="Show that the phantom scanner is right.")
    parser.add_argument("--quick", action="store_true", help="fewer cases")
    parser.add_argument("--pictures", type=Path, metavar="DIR", help="draw the documentation's pictures instead")
    arguments = parser.parse_args()
    if arguments.pictures:
        pictures(arguments.pictures)
        return 0
    return 0 if table(arguments.quick) else 1


if __name__ == "__main__":
    sys.exit(main())
