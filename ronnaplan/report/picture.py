"""A picture to check the markers by: three cuts through each with the fitted outline, and the head in 3-D.

Cuts are resampled for the eye only; every measurement is made on the voxels themselves.
"""

from __future__ import annotations

import io
from typing import TYPE_CHECKING

import numpy as np

from ronnaplan.ct import CTVolume
from ronnaplan.geometry import FloatArray
from ronnaplan.localization import Fiducial, Fiducials
from ronnaplan.scene.head import head_picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

CUT_PIXEL_MM = 0.25
CUT_REACH = 1.3
"""A cut shows this many diameters to each side of the marker's center."""

WINDOW_HU = (-1024.0, 600.0)
OUTLINE_COLOUR = "#ff9f1c"

CUTS = {"axial": (0, 1), "coronal": (0, 2), "sagittal": (1, 2)}
"""The two LPS axes that each cut shows, across and upwards (downwards for axial, as radiologists look)."""


def marker_sheet(volume: CTVolume, found: Fiducials) -> bytes:
    """Draw all markers and the head with them; returns a PNG."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    rows = max(len(found), 3)
    figure = Figure(figsize=(11.0, 1.75 * rows + 0.6), dpi=110, facecolor="black", layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(rows, 6)
    for row, one in enumerate(found.fiducials):
        for column, cut in enumerate(CUTS):
            _draw_cut(figure.add_subplot(grid[row, column]), volume, one, cut)
    _draw_head(figure.add_subplot(grid[:, 3:]), volume, found)
    return png(figure)


def cut_image(
    volume: CTVolume,
    center_mm: FloatArray,
    axes: tuple[int, int],
    reach_mm: float,
    *,
    outside_hu: float = WINDOW_HU[0],
) -> FloatArray:
    """Sample a square cut of half width ``reach_mm`` through ``center_mm``, in HU (linear interpolation)."""
    from scipy.ndimage import map_coordinates

    indices = np.moveaxis(volume.grid.indices(cut_places(center_mm, axes, reach_mm)), -1, 0)
    image: FloatArray = map_coordinates(volume.voxels_hu, indices, output=np.float64, order=1, cval=outside_hu)
    return image


def cut_places(center_mm: FloatArray, axes: tuple[int, int], reach_mm: float) -> FloatArray:
    """Places (H, W, 3) in LPS of the pixels of a cut."""
    steps = np.arange(-reach_mm, reach_mm + CUT_PIXEL_MM / 2, CUT_PIXEL_MM)
    places = np.tile(center_mm, (len(steps), len(steps), 1))
    places[..., axes[0]] += steps[np.newaxis, :]
    places[..., axes[1]] += steps[:, np.newaxis]
    return places


def _draw_cut(axes: Axes, volume: CTVolume, one: Fiducial, cut: str) -> None:
    from matplotlib.patches import Circle

    reach = CUT_REACH * one.diameter_mm
    extent = (-reach, reach, -reach, reach)
    image = cut_image(volume, one.center_mm, CUTS[cut], reach)
    axes.imshow(image, cmap="gray", vmin=WINDOW_HU[0], vmax=WINDOW_HU[1], extent=extent, origin="lower")
    axes.add_patch(Circle((0, 0), one.diameter_mm / 2, fill=False, color=OUTLINE_COLOUR, linewidth=0.9))
    axes.plot(0, 0, "+", color=OUTLINE_COLOUR, markersize=5, markeredgewidth=0.7)
    if cut == "axial":
        axes.invert_yaxis()
    axes.set_axis_off()
    axes.set_title(f"{one.label} {cut}", color="white", fontsize=7, pad=2)


def _draw_head(axes: Axes, volume: CTVolume, found: Fiducials) -> None:
    picture, camera = head_picture(volume, found.centers, max(found.diameters_mm))
    axes.imshow(picture, extent=(-1.0, 1.0, 1.0, -1.0))
    for one in found.fiducials:
        axes.annotate(
            one.label,
            tuple(camera.on_screen(one.center_mm)[:2]),
            xytext=(8, 8),
            textcoords="offset points",
            color=OUTLINE_COLOUR,
            fontsize=10,
        )
    axes.set_axis_off()
    axes.set_title("fitted centers, standard error", color="white", fontsize=9)
    for row, one in enumerate(found.fiducials):
        center = ", ".join(f"{x:.2f}" for x in one.center_mm)
        text = f"{one.label}  ({center}) mm   {1e3 * one.standard_error_mm:.0f} um"
        axes.text(0.02, -0.02 - 0.045 * row, text, color="white", fontsize=8, transform=axes.transAxes, va="top")


def png(figure: Figure) -> bytes:
    """Render a figure as a PNG."""
    stream = io.BytesIO()
    figure.savefig(stream, format="png", facecolor=figure.get_facecolor())
    return stream.getvalue()
