"""Fiducials as CSV, one row each, for spreadsheets and scripts."""

from __future__ import annotations

import csv
import io

from ronnaplan.documents.fiducials import FiducialsDocument
from ronnaplan.tracking.cells import plain_text

HEADER = (
    *("label", "x", "y", "z", "sigma_x", "sigma_y", "sigma_z"),
    *("diameter_mm", "contrast_hu", "flags", "coordinate_system", "frame_of_reference_uid"),
)


def csv_table(document: FiducialsDocument) -> str:
    """Write the fiducials as CSV: LPS mm, and the standard deviation of each coordinate in mm."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(HEADER)
    for entry in document.fiducials:
        sigmas = [entry.covariance[axis][axis] ** 0.5 for axis in range(3)]
        numbers = [*entry.center, *sigmas, entry.diameter_mm]
        writer.writerow(
            [
                plain_text(entry.label),
                *(f"{number:.6f}" for number in numbers),
                f"{entry.contrast_hu:.1f}",
                plain_text(" ".join(entry.flags)),
                "LPS",
                plain_text(document.source.frame_of_reference_uid or ""),
            ]
        )
    return stream.getvalue()
