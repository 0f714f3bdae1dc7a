"""A scene drawn with characters, for the terminal."""

from __future__ import annotations

import numpy as np

from phantoms.materials import material
from phantoms.scene import Scene
from phantoms.stack import SliceStack

SHADES = ((-300.0, " "), (100.0, "·"), (600.0, "░"), (3500.0, "▒"), (float("inf"), "█"))
"""Character for everything up to a nominal HU; markers are drawn as ``●``."""
COLUMNS, LINES, DEPTH = 36, 14, 48
"""Characters across and down, and places looked at along each line of sight."""


def draw(scene: Scene, stack: SliceStack) -> str:
    """Return the view from the front: along each line of sight the densest material that is met."""
    along = stack.positions_mm
    width = stack.columns * stack.pixel_mm
    middle = stack.centers_mm.mean(axis=0)
    u = ((np.arange(COLUMNS) + 0.5) / COLUMNS - 0.5) * width
    w = along.max() - (np.arange(LINES) + 0.5) / LINES * np.ptp(along) - middle @ stack.normal
    v = ((np.arange(DEPTH) + 0.5) / DEPTH - 0.5) * width
    grid = np.stack(np.meshgrid(w, u, v, indexing="ij"), axis=-1)
    points = middle + grid @ np.array([stack.normal, stack.column_direction, stack.row_direction])
    values = np.full(grid.shape[:3], -1000.0)
    for part in scene.parts:
        inside = part.solid.contains(points.reshape(-1, 3)).reshape(values.shape)
        values[inside] = material(part.material).nominal_hu
    picture = [[_shade(value) for value in line] for line in values.max(axis=2)]
    for marker in scene.markers:
        offset = marker.center_mm - middle
        column = int((offset @ stack.column_direction / width + 0.5) * COLUMNS)
        line = int((along.max() - marker.center_mm @ stack.normal) / max(np.ptp(along), 1e-9) * LINES)
        if 0 <= column < COLUMNS and 0 <= line < LINES:
            picture[line][column] = "●"
    return "\n".join("".join(line).rstrip() for line in picture)


def _shade(value: float) -> str:
    return next(character for limit, character in SHADES if value <= limit)
