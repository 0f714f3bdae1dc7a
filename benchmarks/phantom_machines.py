"""Claims about the phantom's cone beam, its helices and its patients who move, against theory."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from benchmarks.phantom_measures import HOME, Row, hu, moments, places
from phantoms import library
from phantoms.cone_beam import ConeBeam
from phantoms.helix import Helix
from phantoms.motion import Form, Motion
from phantoms.scene import Part, Scene
from phantoms.solids import FloatArray, cylinder, sphere
from phantoms.stack import axial_stack


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
        bool(abs(levels[1] / levels[0] - 2) < 0.1),
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
