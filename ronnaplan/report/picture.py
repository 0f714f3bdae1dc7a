"""A picture to check the markers by: the head in 3-D, and three cuts through each marker with the fitted outline.

Cuts are resampled for the eye only; every measurement is made on the voxels themselves.
"""

from __future__ import annotations

import io
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ronnaplan.ct import CTVolume
from ronnaplan.ct.sampling import sampled
from ronnaplan.geometry import FloatArray
from ronnaplan.localization import Fiducial, Fiducials
from ronnaplan.scene.portrait import head_picture
from ronnaplan.text import counted

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

CUT_PIXEL_MM = 0.25
CUT_REACH = 1.3
"""A cut shows this many diameters to each side of the marker's center."""

WINDOW_HU = (-1024.0, 600.0)
OUTLINE_COLOUR, QUIET, BACKGROUND = "#ff9f1c", "#9fb3c4", "#0b0e11"

CUTS = {"axial": (0, 1), "coronal": (0, 2), "sagittal": (1, 2)}
"""The two LPS axes that each cut shows, across and upwards (downwards for axial, as radiologists look)."""


def marker_sheet(volume: CTVolume, found: Fiducials) -> bytes:
    """Draw the head with all markers, and cuts through each; returns a PNG."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    rows = max(len(found), 3)
    figure = Figure(figsize=(14.4, 9.0), dpi=110, facecolor=BACKGROUND)
    FigureCanvasAgg(figure)
    _draw_head(figure.add_axes((0.0, 0.0, 0.625, 1.0)), volume, found)
    grid = figure.add_gridspec(rows, 4, left=0.64, right=0.99, bottom=0.05, top=0.93, wspace=0.06, hspace=0.1)
    for row, one in enumerate(found.fiducials):
        for column, cut in enumerate(CUTS):
            axes = figure.add_subplot(grid[row, column])
            _draw_cut(axes, volume, one, cut)
            if row == 0:
                axes.set_title(cut, color=QUIET, fontsize=10, pad=6)
        _say(figure.add_subplot(grid[row, len(CUTS)]), one)
    title = f"ronnaplan   {counted(len(found), 'marker')} found"
    figure.text(0.018, 0.955, title, color="white", fontsize=15, weight="bold")
    figure.text(0.018, 0.022, "research software, not a medical device", color=QUIET, fontsize=9)
    return png(figure)


def cut_image(
    volume: CTVolume, center_mm: FloatArray, axes: tuple[int, int], reach_mm: float
) -> NDArray[np.float32]:
    """Sample a square cut of half width ``reach_mm`` through ``center_mm``, in HU (linear interpolation)."""
    places = cut_places(center_mm, axes, reach_mm)
    return sampled(volume.voxels_hu, volume.grid.indices(places), WINDOW_HU[0])


def cut_places(center_mm: FloatArray, axes: tuple[int, int], reach_mm: float) -> FloatArray:
    """Places (H, W, 3) in LPS of the pixels of a cut through ``center_mm`` (3,)."""
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
    axes.imshow(
        image,
        cmap="gray",
        vmin=WINDOW_HU[0],
        vmax=WINDOW_HU[1],
        extent=extent,
        origin="lower",
        interpolation="bilinear",
    )
    axes.add_patch(Circle((0, 0), one.diameter_mm / 2, fill=False, color=OUTLINE_COLOUR, linewidth=1.2))
    axes.plot(0, 0, "+", color=OUTLINE_COLOUR, markersize=6, markeredgewidth=0.8)
    if cut == "axial":
        axes.invert_yaxis()
    axes.set_axis_off()


def _say(axes: Axes, one: Fiducial) -> None:
    """Write a marker's label, its fitted center and its error."""
    axes.set_axis_off()
    place = "\n".join(f"{axis} {x:8.2f} mm" for axis, x in zip("LPS", one.center_mm, strict=True))
    axes.text(0.06, 0.86, one.label, color=OUTLINE_COLOUR, fontsize=13, weight="bold", va="center")
    axes.text(0.06, 0.70, place, color="white", fontsize=8.5, va="top", family="monospace")
    axes.text(0.06, 0.06, f"error {1e3 * one.error_rms_mm:.0f} um RMS", color=QUIET, fontsize=8.5, va="bottom")


def _draw_head(axes: Axes, volume: CTVolume, found: Fiducials) -> None:
    from matplotlib.patheffects import withStroke

    head = head_picture(volume, found.centers, max(found.diameters_mm, default=0.0))
    axes.imshow(head.shades, extent=(-1.0, 1.0, -1.0, 1.0), interpolation="antialiased")
    for one, seen in zip(found.fiducials, head.seen, strict=True):
        across, down, _ = head.camera.on_screen(one.center_mm)
        if not seen:
            axes.plot(
                across, -down, "o", color=OUTLINE_COLOUR, markersize=20, fillstyle="none", alpha=0.6, ls="--"
            )
        axes.annotate(
            one.label if seen else f"{one.label} behind",
            (across, -down),
            xytext=(14, 12),
            textcoords="offset points",
            color="white",
            fontsize=12 if seen else 9,
            weight="bold",
            path_effects=[withStroke(linewidth=3, foreground=BACKGROUND)],
        )
    axes.set_axis_off()


def png(figure: Figure) -> bytes:
    """Render a figure as a PNG."""
    from ronnaplan.letters import written_out

    written_out(figure)
    stream = io.BytesIO()
    figure.savefig(stream, format="png", facecolor=figure.get_facecolor())
    return stream.getvalue()
