"""What was measured and judged of a trajectory in words and numbers, the same wherever it is shown."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from ronnaplan.planning.landmarks import Landmarks
from ronnaplan.planning.limits import Verdict
from ronnaplan.planning.measures import Measures
from ronnaplan.planning.placement import Placement
from ronnaplan.planning.uncertainty import Basis, PathError
from ronnaplan.text import chance

Rows = list[tuple[str, str]]
"""What it is, and its value with the unit."""

MOST_DIGITS = 9
"""Digits after the point that a value may have to be told from its limit."""


def number(value: float | None, digits: int = 2) -> str:
    """Write a number, or a dash where there is none."""
    return "-" if value is None else f"{value:.{digits}f}"


def amount(value: float | None, unit: str) -> str:
    """Write a value with its unit, or a dash alone where there is none.

    >>> amount(12.345, "mm"), amount(None, "deg"), amount(1.0, "")
    ('12.35 mm', '-', '1.00')
    """
    return "-" if value is None else f"{number(value)} {unit}".rstrip()


def coordinates(place_mm: Iterable[float]) -> str:
    """Write a place's coordinates in mm, to hundredths; a sentence writes them by `text.place`.

    >>> coordinates([1.0, -2.25, 0.04])
    '1.00, -2.25, 0.04'
    """
    return ", ".join(f"{value:.2f}" for value in place_mm)


def shape_rows(one: Measures) -> Rows:
    """Return lengths, depths and angles of a path."""
    rows = [
        ("length", f"{one.length_mm:.2f} mm"),
        ("target below scalp", amount(one.depth_below_scalp_mm, "mm")),
        ("target below skull", amount(one.depth_below_skull_mm, "mm")),
        ("bone along the path", amount(one.skull_thickness_mm, "mm")),
        ("angle to the skull's normal", amount(one.skull_angle_deg, "deg")),
        ("arc, ring of the frame", f"{one.arc.arc_deg:.1f}, {one.arc.ring_deg:.1f} deg"),
    ]
    if one.acpc is not None:
        rows += [
            ("AC-PC sagittal, coronal angle", f"{one.acpc.sagittal_deg:.1f}, {one.acpc.coronal_deg:.1f} deg"),
            ("target from mid-commissure, R A S", f"{coordinates(one.acpc.target_mm)} mm"),
        ]
    return rows


def distance_rows(one: Measures) -> Rows:
    """Return how near a path comes to obstacles and to other paths."""
    rows = [
        (
            f"distance to {near.name}",
            f"{near.clearance_mm:.2f} mm (at least {near.at_least_mm:.2f}) at depth {near.depth_mm:.1f} mm",
        )
        for near in one.clearances
    ]
    return rows + [
        (f"distance to {called}", f"{near.clearance_mm:.2f} mm at depth {near.depth_mm:.1f} mm")
        for called, near in one.named_spacings
    ]


def error_table(one: Measures) -> list[tuple[str, ...]]:
    """Return the expected error that counts and, where there are two, the other one beside it, under a row of heads."""
    errors = [error for error in (one.error, one.planned_error) if error is not None]
    if not errors:
        return []
    columns = [dict(error_values(error)) for error in errors]
    rows = [(what, *(column[what] for column in columns)) for what in columns[0]]
    heads = ("expected error", *(f"as {error.expected.basis}" for error in errors))
    return [heads, *rows, ("with", *(error.expected.rests_on for error in errors))]


def errors_by_basis(one: Measures) -> tuple[PathError | None, PathError | None]:
    """Return the expected error as planned and as registered, None where there is none."""
    found = {error.expected.basis: error for error in (one.error, one.planned_error) if error is not None}
    return found.get(Basis.PLANNED), found.get(Basis.REGISTERED)


def error_values(error: PathError) -> Rows:
    """Return the expected error of a path."""
    return [
        ("at the entry", f"{error.entry_rms_mm:.2f} mm RMS"),
        ("at the target", f"{error.target_rms_mm:.2f} mm RMS"),
        ("of the angle", f"{error.angular_rms_deg:.2f} deg RMS"),
        ("radius of the 95 % tube", f"at most {error.tube_mm.max():.2f} mm"),
        (f"chance to stay within {error.tolerance_mm:g} mm", chance(error.probability)),
    ]


def value_and_limit(one: Verdict) -> tuple[str, str]:
    """Return a verdict's value and limit with as many digits as tell them apart and the limit has, two at least.

    >>> value_and_limit(Verdict("A", "chance to stay within 2 mm", 0.9996, "", 0.95, passes=True))
    ('> 0.999', '0.95')
    """
    if one.value is None or one.limit is None:
        return number(one.value), number(one.limit)
    digits, order, stated = 2, _order(one.value, one.limit, MOST_DIGITS), round(one.limit, MOST_DIGITS)
    while digits < MOST_DIGITS and (
        _order(one.value, one.limit, digits) != order or round(one.limit, digits) != stated
    ):
        digits += 1
    value = number(one.value, digits)
    is_certain = not one.unit and float(value) in (0.0, 1.0)  # a chance, as it would be written
    return chance(one.value) if is_certain else value, number(one.limit, digits)


def _order(value: float, limit: float, digits: int) -> int:
    """Return -1, 0 or 1 for a value below, at or above a limit, as written with so many digits."""
    return int(np.sign(round(value, digits) - round(limit, digits)))


def verdict_sentence(one: Verdict) -> str:
    """Return a verdict in words, without the trajectory's name.

    >>> verdict_sentence(Verdict("A", "angle to skull normal", None, "deg", 30.0, passes=False))
    'angle to skull normal - (limit 30.00)'
    """
    value, limit = value_and_limit(one)
    unit = "" if one.value is None else one.unit
    against = "" if one.limit is None else f"(limit {limit})"
    return " ".join(part for part in (one.measure, value, unit, against, one.remark) if part)


def frame_sentence(landmarks: Landmarks) -> str:
    """Return where the AC-PC frame was set: who checks angles and targets in it needs its points."""
    named = (("AC", landmarks.ac_mm), ("PC", landmarks.pc_mm), ("midline", landmarks.midline_mm))
    points = "; ".join(f"{name} {coordinates(place_mm)}" for name, place_mm in named)
    apart = number(float(np.linalg.norm(landmarks.ac_mm - landmarks.pc_mm)), 1)
    return f"AC-PC frame, LPS mm: {points}. AC and PC are {apart} mm apart."


def placement_sentence(placed: Placement) -> str:
    """Return what proposed places for markers promise."""
    return (
        f"largest expected TRE {placed.largest_tre_mm:.3f} mm, {placed.even_tre_mm:.3f} mm for an even spread; "
        f"rival distance {placed.rival_distance_mm:.1f} mm; expected error {placed.expected}"
    )
