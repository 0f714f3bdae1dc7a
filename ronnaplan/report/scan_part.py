"""The report's facts about the scan."""

from __future__ import annotations

import numpy as np

from ronnaplan.case.folder import Case
from ronnaplan.case.surroundings import scan_doubts
from ronnaplan.ct import CTVolume
from ronnaplan.report.html import Part, table


def scan_part(case: Case) -> Part:
    """Say what the scan is, how fine, how tilted, and what is odd about it."""
    if case.volume is None:
        missing = "the scan is not at hand: nothing here was compared with its voxels; give it with --ct"
        return Part("Scan", warnings=[missing])
    return Part("Scan", [table([], _facts(case.volume))], list(scan_doubts(case.volume)))


def _facts(volume: CTVolume) -> list[tuple[str, str]]:
    grid, source = volume.grid, volume.source
    slices, rows, columns = volume.voxels_hu.shape
    gaps = np.unique(grid.spacings_mm.round(3))
    thickness = grid.thickness_mm
    return [
        ("voxels", f"{columns} x {rows} x {slices}"),
        ("pixel", f"{grid.column_spacing_mm:.4f} x {grid.row_spacing_mm:.4f} mm"),
        ("slice spacing", " and ".join(f"{gap:.3f}" for gap in gaps) + " mm"),
        ("slice thickness", "not stated" if thickness is None else f"{thickness:.3f} mm"),
        ("gantry tilt", f"{grid.tilt_deg:.2f} deg (from the slice positions)"),
        ("modality, kernel", f"{source.modality}, {source.kernel or 'kernel not stated'}"),
        ("frame of reference", source.frame_of_reference_uid or "not stated"),
        ("study", source.study_instance_uid or "not stated"),
        ("series", source.series_instance_uid or "not stated"),
    ]
