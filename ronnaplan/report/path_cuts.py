"""Two cuts that contain a trajectory, at right angles to each other, and the HU along it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ronnaplan.ct import CTVolume
from ronnaplan.geometry import FloatArray, unit
from ronnaplan.planning import Measures, Trajectory
from ronnaplan.report.picture import WINDOW_HU, png

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PIXEL_MM = 0.5
REACH_MM = 30.0
"""To each side of the path, and beyond its ends."""


def path_picture(volume: CTVolume, measured: Measures) -> bytes:
    """Draw a measured trajectory in its scan; returns a PNG."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11.0, 3.4), dpi=80, layout="constrained")
    FigureCanvasAgg(figure)
    cuts = figure.subplots(1, 3)
    for axes, sideways in zip(cuts, sideways_axes(measured.trajectory), strict=False):
        _draw_cut(axes, volume, measured.trajectory, sideways)
    profile = cuts[2]
    profile.plot(measured.profile_mm, measured.profile_hu, color=measured.trajectory.colour)
    profile.set_xlabel("depth, mm")
    profile.set_ylabel("HU along the path")
    return png(figure)


def sideways_axes(trajectory: Trajectory) -> tuple[FloatArray, FloatArray]:
    """Return two unit vectors (3,) across the path, at right angles to each other."""
    least = np.eye(3)[np.argmin(np.abs(trajectory.inward))]
    first = unit(np.cross(trajectory.inward, least))
    return first, np.cross(trajectory.inward, first)


def path_cut(volume: CTVolume, trajectory: Trajectory, sideways: FloatArray) -> FloatArray:
    """Sample the plane of the path and ``sideways`` (3,), in HU: rows along the path, columns across it."""
    from scipy.ndimage import map_coordinates

    along = np.arange(-REACH_MM, trajectory.length_mm + REACH_MM, PIXEL_MM)
    across = np.arange(-REACH_MM, REACH_MM + PIXEL_MM / 2, PIXEL_MM)
    places = trajectory.at_depth(along)[:, np.newaxis] + across[:, np.newaxis] * sideways
    indices = np.moveaxis(volume.grid.indices(places), -1, 0)
    image: FloatArray = map_coordinates(volume.voxels_hu, indices, output=np.float64, order=1, cval=WINDOW_HU[0])
    return image


def _draw_cut(axes: Axes, volume: CTVolume, trajectory: Trajectory, sideways: FloatArray) -> None:
    image = path_cut(volume, trajectory, sideways)
    low, high = WINDOW_HU
    extent = (-REACH_MM, REACH_MM, trajectory.length_mm + REACH_MM, -REACH_MM)
    axes.imshow(image, cmap="gray", vmin=low, vmax=high, extent=extent)
    for side in (-trajectory.instrument.radius_mm, trajectory.instrument.radius_mm):
        axes.plot([side, side], [0, trajectory.length_mm], color=trajectory.colour, linewidth=1.0)
    axes.set_xlabel("across, mm")
    axes.set_ylabel("depth, mm")
