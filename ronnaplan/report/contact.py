"""A contact sheet: every accepted and nearly accepted candidate, three cuts each, and what the model leaves over."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ronnaplan.ct import CTVolume
from ronnaplan.errors import check_type
from ronnaplan.geometry import FloatArray
from ronnaplan.localization import Fiducials
from ronnaplan.localization.parameters import BACKGROUND, CENTER, CONTRAST, RADIUS
from ronnaplan.report.picture import CUTS, OUTLINE_COLOUR, cut_image, png

if TYPE_CHECKING:
    from matplotlib.axes import Axes

NEARLY_SHOWN = 8
"""Rejected candidates on the sheet, nearest to acceptance first."""

RESIDUAL_SHARE = 0.1
"""Residuals are drawn from minus to plus this share of the contrast."""


@dataclass(frozen=True)
class Candidate:
    """A fitted place: its center (3,) in LPS mm and the model's parameters."""

    title: str
    center_mm: FloatArray
    parameters: FloatArray
    accepted: bool
    layer_mm: float = 0.0


def contact_sheet(volume: CTVolume, found: Fiducials) -> bytes:
    """Draw cuts and residuals of each candidate in a row; returns a PNG."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    check_type(volume, CTVolume, "the volume", "read_ct returns one")
    check_type(found, Fiducials, "what was found", "localize returns it")
    rows = _rows(found)
    figure = Figure(figsize=(12.0, 1.9 * max(len(rows), 1) + 0.4), dpi=90, layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(max(len(rows), 1), 2 * len(CUTS))
    for number, row in enumerate(rows):
        for column, cut in enumerate(CUTS):
            picture = figure.add_subplot(grid[number, 2 * column])
            residual = figure.add_subplot(grid[number, 2 * column + 1])
            draw_cut(picture, residual, volume, row, cut)
            if column == 0:
                colour = "black" if row.accepted else "firebrick"
                picture.set_title(row.title, fontsize=7, loc="left", color=colour)
    if not rows:
        figure.text(0.5, 0.5, "no candidate was looked at closely", ha="center")
    return png(figure)


def _rows(found: Fiducials) -> list[Candidate]:
    accepted = [
        Candidate(
            f"{one.label}: s.e. {1e3 * one.standard_error_mm:.1f} um, misfit {one.misfit:.1%}, "
            f"{one.coverage:.0%} of the surface used",
            one.center_mm,
            one.parameters,
            accepted=True,
            layer_mm=found.marker.layer_mm,
        )
        for one in found.fiducials
    ]
    nearly = [
        Candidate(
            f"rejected: {one.reason}",
            one.fitted_mm,
            one.parameters,
            accepted=False,
            layer_mm=found.marker.layer_mm,
        )
        for one in found.rejected[:NEARLY_SHOWN]
    ]
    return accepted + nearly


def draw_cut(picture: Axes, residual: Axes, volume: CTVolume, row: Candidate, cut: str) -> None:
    """Draw one cut through a fitted place with its outline, and beside it the data less the model."""
    from matplotlib.patches import Circle

    radius_mm, contrast_hu, background_hu = row.parameters[[RADIUS, CONTRAST, BACKGROUND]]
    reach_mm = 1.6 * radius_mm + 1.0
    image = cut_image(volume, row.center_mm, CUTS[cut], reach_mm)
    left_over = cut_image(_left_over(volume, row, reach_mm), row.center_mm, CUTS[cut], reach_mm, outside_hu=0.0)
    extent = (-reach_mm, reach_mm, -reach_mm, reach_mm)
    window = {"vmin": background_hu - 0.1 * contrast_hu, "vmax": background_hu + 1.3 * contrast_hu}
    picture.imshow(image, cmap="gray", extent=extent, origin="lower", **window)
    limit = RESIDUAL_SHARE * abs(contrast_hu)
    residual.imshow(left_over, cmap="RdBu_r", extent=extent, origin="lower", vmin=-limit, vmax=limit)
    for axes in (picture, residual):
        axes.add_patch(Circle((0, 0), radius_mm, fill=False, color=OUTLINE_COLOUR, linewidth=0.8))
        axes.set_axis_off()
        if cut == "axial":
            axes.invert_yaxis()


def _left_over(volume: CTVolume, row: Candidate, reach_mm: float) -> CTVolume:
    """The voxels about a candidate less the fitted model, in HU: compared voxel by voxel, as the fit does."""
    from ronnaplan.localization.ball import discs
    from ronnaplan.localization.model import evaluate

    grid = volume.grid
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * reach_mm * np.sqrt(2)
    indices = grid.indices(row.center_mm + corners)
    low = np.clip(np.floor(indices.min(axis=0)), 0, volume.voxels_hu.shape).astype(int)
    high = np.clip(np.ceil(indices.max(axis=0)) + 1, low + 1, volume.voxels_hu.shape).astype(int)
    low = np.minimum(low, high - 1)
    box = volume.voxels_hu[tuple(slice(a, b) for a, b in zip(low, high, strict=True))]
    places = grid.positions_mm(np.moveaxis(np.indices(box.shape), 0, -1) + low.astype(np.float64))
    at_center = row.parameters.copy()
    at_center[CENTER] = 0.0
    offsets = np.ascontiguousarray((places - row.center_mm).reshape(-1, 3) @ grid.axes.T)
    model, _ = evaluate(offsets, at_center, row.layer_mm, *discs(at_center))
    origins = grid.origins_mm[low[0] : high[0]] + low[1] * grid.row_step_mm + low[2] * grid.column_step_mm
    left_over = (box - model.reshape(box.shape)).astype(np.float32)
    return replace(volume, voxels_hu=left_over, grid=replace(grid, origins_mm=origins))
