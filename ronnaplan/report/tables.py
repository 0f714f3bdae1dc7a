"""Results as plain text tables."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from ronnaplan.localization import Fiducial, Fiducials


def fiducials_table(found: Fiducials, truth_mm: ArrayLike | None = None) -> str:
    """List centers (LPS mm), standard errors (micrometres) and, where the truth (M, 3) is known, the distance."""
    heading = ["", "x", "y", "z", "s.e. x", "s.e. y", "s.e. z um", "diameter", "contrast HU", "flags"]
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


def align(rows: Sequence[Sequence[str]]) -> str:
    """Lay rows of cells out in columns: the first and the last to the left, the others to the right."""
    widths = [max(len(cell) for cell in column) for column in zip(*rows, strict=True)]
    lines = []
    for row in rows:
        cells = [cell.rjust(width) for cell, width in zip(row, widths, strict=True)]
        cells[0], cells[-1] = row[0].ljust(widths[0]), row[-1]
        lines.append("  ".join(cells).rstrip())
    return "\n".join(lines)
