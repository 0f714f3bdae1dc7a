"""Two cuts that contain a trajectory, at right angles to each other, and the HU along it, at one scale of depth."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ronnaplan.ct import CTVolume
from ronnaplan.ct.sampling import sampled
from ronnaplan.geometry import FloatArray
from ronnaplan.planning import Measures, Trajectory
from ronnaplan.planning.contacts import contact_ends_mm
from ronnaplan.report.picture import WINDOW_HU, png
from ronnaplan.scene.cut import axes_beside, letters

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PIXEL_MM = 0.5
REACH_MM = 30.0
"""To each side of the path."""

BEYOND_MM = 15.0
"""Beyond the path's ends."""

WIDTH_IN, PROFILE_IN, HIGHEST_IN = 9.6, 2.4, 3.9
"""Of the whole picture, of its profile at least, and the height of a cut at most."""

LEFT_IN, RIGHT_IN, BELOW_IN, ABOVE_IN, GAP_IN = 0.8, 1.0, 0.65, 0.1, 0.15
"""What stands beside the panes has so much room."""

CONTACT_COLOUR = "#00e5ff"

PROFILE_COLOUR = "#1c2730"
"""Trajectories have colours that are seen on a scan; on white paper some are not."""

SIDE_SHARE = 0.03
"""Towards which side of the patient an edge of a cut lies is written so far from it, in widths of the cut."""

LETTERS_PT = 12
"""On paper the picture is three quarters as large."""


def path_picture(volume: CTVolume, measured: Measures) -> bytes:
    """Draw a measured trajectory in its scan; returns a PNG."""
    return png(path_figure(volume, measured))


def path_figure(volume: CTVolume, measured: Measures) -> Figure:
    """Return two cuts that hold a measured trajectory, seen as standard cuts are, and the HU along it."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    path = measured.trajectory
    deepest = path.length_mm + BEYOND_MM
    ratio = (deepest + BEYOND_MM) / (2 * REACH_MM)
    room_in = WIDTH_IN - LEFT_IN - RIGHT_IN - 2 * GAP_IN
    across_in = min((room_in - PROFILE_IN) / 2, HIGHEST_IN / ratio)
    down_in = across_in * ratio
    high_in = down_in + BELOW_IN + ABOVE_IN
    figure = Figure(figsize=(WIDTH_IN, high_in), dpi=110)
    FigureCanvasAgg(figure)
    panes, left_in = [], LEFT_IN
    for wide_in in (across_in, across_in, room_in - 2 * across_in):
        place = (left_in / WIDTH_IN, BELOW_IN / high_in, wide_in / WIDTH_IN, down_in / high_in)
        panes.append(figure.add_axes(place))
        left_in += wide_in + GAP_IN
    for axes, sideways in zip(panes, axes_beside(path.inward), strict=False):
        _draw_cut(axes, volume, path, sideways)
    panes[0].set_ylabel("depth, mm", fontsize=LETTERS_PT)
    _draw_profile(panes[2], measured)
    for axes in panes:
        axes.tick_params(labelsize=LETTERS_PT, labelleft=axes is panes[0])
        axes.set_ylim(deepest, -BEYOND_MM)
    return figure


def path_cut(volume: CTVolume, trajectory: Trajectory, sideways: FloatArray) -> NDArray[np.float32]:
    """Sample the plane of the path and ``sideways`` (3,), in HU: rows along the path, columns across it."""
    along = np.arange(-BEYOND_MM, trajectory.length_mm + BEYOND_MM, PIXEL_MM)
    across = np.arange(-REACH_MM, REACH_MM + PIXEL_MM / 2, PIXEL_MM)
    places = trajectory.at_depth(along)[:, np.newaxis] + across[:, np.newaxis] * sideways
    return sampled(volume.voxels_hu, volume.grid.indices(places), WINDOW_HU[0])


def _draw_cut(axes: Axes, volume: CTVolume, trajectory: Trajectory, sideways: FloatArray) -> None:
    from matplotlib.patches import Rectangle

    image = path_cut(volume, trajectory, sideways)
    low, high = WINDOW_HU
    extent = (-REACH_MM, REACH_MM, trajectory.length_mm + BEYOND_MM, -BEYOND_MM)
    axes.imshow(image, cmap="gray", vmin=low, vmax=high, extent=extent)
    for side in (-trajectory.instrument.radius_mm, trajectory.instrument.radius_mm):
        axes.plot([side, side], [0, trajectory.length_mm], color=trajectory.colour, linewidth=1.0)
    wide = trajectory.electrode.diameter_mm if trajectory.electrode else 0.0
    for upper, lower in (contact_ends_mm(trajectory) - trajectory.entry_mm) @ trajectory.inward:
        axes.add_patch(Rectangle((-wide / 2, upper), wide, lower - upper, color=CONTACT_COLOUR, zorder=3))
    for place, towards in ((SIDE_SHARE, -sideways), (1.0 - SIDE_SHARE, sideways)):
        _name_side(axes, place, letters(towards))
    axes.set_xlabel("across, mm", fontsize=LETTERS_PT)


def _name_side(axes: Axes, place: float, side: str) -> None:
    """Write towards which side of the patient an edge lies, at a share of the cut's width, in its middle."""
    from matplotlib.patheffects import withStroke

    axes.text(
        *(place, 0.5, side),
        transform=axes.transAxes, color="white", fontsize=LETTERS_PT, fontweight="bold",
        ha="left" if place < 0.5 else "right", va="center",
        path_effects=[withStroke(linewidth=2.5, foreground="black")],
    )  # fmt: skip


def _draw_profile(axes: Axes, measured: Measures) -> None:
    """Draw the HU along the path, and where it crosses scalp and skull."""
    axes.plot(measured.profile_hu, measured.profile_mm, color=PROFILE_COLOUR, linewidth=1.8)
    axes.set_xlabel("HU along the path", fontsize=LETTERS_PT)
    axes.grid(color="#e4e9ee")
    crossings = measured.crossings
    surfaces = {"scalp": crossings.scalp, "outer table": crossings.outer, "inner table": crossings.inner}
    found = {name: measured.length_mm - one.reach_mm for name, one in surfaces.items() if one is not None}
    for depth in found.values():
        axes.axhline(depth, color="#7a8b99", linewidth=0.8, linestyle=":")
    axes.secondary_yaxis("right").set_yticks(list(found.values()), list(found), fontsize=LETTERS_PT - 2)
