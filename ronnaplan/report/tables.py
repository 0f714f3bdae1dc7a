"""Results as plain text tables."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from ronnaplan.localization import Fiducial, Fiducials
from ronnaplan.localization.fiducials import UNSEEN_MOTION_MM, FiducialFlag
from ronnaplan.text import columns, counted, filled, sizes

BELL_SHAPE = 1.0
"""Slice profiles with a larger shape are called bell-shaped: a parabola has 1."""


def fiducials_table(found: Fiducials, truth_mm: ArrayLike | None = None) -> str:
    """List centers (LPS mm), sigmas per axis (micrometres) and, where the truth (M, 3) is known, the distance."""
    heading = [
        "",
        "x mm",
        "y mm",
        "z mm",
        "sigma x um",
        "sigma y um",
        "sigma z um",
        "diameter mm",
        "contrast HU",
        "flags",
    ]
    rows = [_row(one) for one in found.fiducials]
    if truth_mm is not None:
        heading.insert(7, "off truth um")
        truth = np.asarray(truth_mm, dtype=np.float64)
        for row, one in zip(rows, found.fiducials, strict=True):
            row.insert(7, f"{1e3 * np.linalg.norm(truth - one.center_mm, axis=1).min():.1f}")
    return align([heading, *rows])


def _row(one: Fiducial) -> list[str]:
    errors = 1e3 * np.sqrt(np.diag(one.covariance_mm2))
    return [
        one.label,
        *(f"{x:.3f}" for x in one.center_mm),
        *(f"{error:.1f}" for error in errors),
        f"{one.diameter_mm:.3f}",
        f"{one.contrast_hu:.0f}",
        ", ".join(flag.name.lower() for flag in one.flags) or "-",
    ]


def counts_line(found: Fiducials) -> str:
    """Say how many markers of which sizes were found, and how many candidates rejected."""
    rejected = counted(len(found.rejected), "candidate")
    return f"{counted(len(found), 'marker')} of {sizes(found.diameters_mm)} mm; {rejected} rejected"


def resolution_line(found: Fiducials) -> list[str]:
    """Say in a line how sharp the markers look, beside what the scan's header says; none without markers."""
    seen = found.resolution
    if seen is None:
        return []
    kind = "box-like" if seen.shape < BELL_SHAPE else "bell-shaped"
    along = ""
    if seen.profile_axis is not None:
        along = f" along ({', '.join(f'{x:.2f}' for x in seen.profile_axis)}) and not their normal"
    summed = ", their rays summed before the logarithm, which is made good" if seen.summed_first else ""
    stated = "nothing" if seen.stated_mm is None else f"{seen.stated_mm:.2f} mm"
    return [
        f"slices: {seen.profile_mm:.2f} mm wide at half height{along}, {kind}{summed}; the header says {stated}; "
        f"blur within them {seen.blur_mm:.2f} mm"
    ]


def motion_line(found: Fiducials) -> list[str]:
    """Say what is assumed of a patient who moved between the markers, or what known distances say of it."""
    if not len(found):
        return []
    if found.distance_error_mm is not None:
        return [f"motion: the markers' distances are the template's within {found.distance_error_mm:.2f} mm"]
    moved = [one.label for one in found.fiducials if FiducialFlag.MOTION_SUSPECTED in one.flags]
    if moved:
        others = ", of those without that flag, too" if len(moved) < len(found) else ""
        return [
            f"motion is suspected of {', '.join(moved)}: if the head moved, the distances of all markers are open"
            f"{others}; scan again, or test them with a --template"
        ]
    return [
        "motion: if the head moved between the slices of two markers, no image shows it; "
        f"{UNSEEN_MOTION_MM:g} mm per axis are assumed, beside the stated errors; known distances (--template) test it"
    ]


def layout_line(found: Fiducials) -> list[str]:
    """Say how well this layout can be told from its rivals once a tracker sees the markers; none for a few or many."""
    from ronnaplan.correspondence.layout import GREATEST_REFUSAL, MOST_LAYOUT_POINTS, describe_layout
    from ronnaplan.correspondence.told import LEAST_PAIRS

    if not LEAST_PAIRS <= len(found) <= MOST_LAYOUT_POINTS:
        return []
    layout = describe_layout(found.centers)
    refused = layout.refusal_probability()
    line = f"layout: nearest rival order is {layout.rival_distance_mm:.1f} mm away"
    if refused < GREATEST_REFUSAL:
        return [line]
    return [f"{line}; pairing with a tracker would be refused in {refused:.0%} of cases, move a marker"]


def align(rows: Sequence[Sequence[str]]) -> str:
    """Lay rows of cells out in columns: the first and the last to the left, the others to the right."""
    widths = [max(map(columns, column)) for column in zip(*rows, strict=True)]
    lines = []
    for row in rows:
        cells = [" " * (width - columns(cell)) + cell for cell, width in zip(row, widths, strict=True)]
        cells[0], cells[-1] = filled(row[0], widths[0]), row[-1]
        lines.append("  ".join(cells).rstrip())
    return "\n".join(lines)
