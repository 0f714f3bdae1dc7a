"""Where the edges of regions (no-go, label maps) lie in a cut, as closed lines."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from ronnaplan.case.surroundings import Labels
from ronnaplan.ct import CTVolume
from ronnaplan.geometry import FloatArray
from ronnaplan.planner.panes import Pane
from ronnaplan.planning.sampling import SliceSampler
from ronnaplan.scene.cut import Cut
from ronnaplan.scene.sampled import values_hu

MOST_PIXELS, FINER = 40_000, 3
"""With so many pixels a cut through a region is sampled, and each is divided so often before its edge is followed."""

EDGE = 0.5
"""Of a mask that is 1 inside and 0 outside, interpolated."""


class Outlines:
    """The edges of all regions of a scan; those of the last cut in each view are kept."""

    def __init__(self, volume: CTVolume, regions: Labels) -> None:
        scan = SliceSampler.of(volume)
        self._regions = {
            # a mask's bytes as they are, for a scan's voxels: sampled alike, and not copied
            name: replace(scan, voxels=mask.view(np.uint8))  # type: ignore[arg-type]
            for name, mask in regions.items()
        }
        self._kept: dict[str, tuple[Any, list[dict[str, Any]]]] = {}

    def drawn(self, view: str, cut: Cut, pane: Pane) -> list[dict[str, Any]]:
        """Return name and lines (SVG path, mm from the middle of the cut) of each region that a view's cut meets."""
        if not self._regions:
            return []
        of = (*cut.center_mm.tolist(), *cut.right.tolist(), *cut.down.tolist(), cut.field_mm, pane)
        known = self._kept.get(view)
        if known is None or known[0] != of:
            shape = pane.shape(MOST_PIXELS)
            met = ((name, edges(region, cut, shape)) for name, region in self._regions.items())
            known = of, [{"name": name, "path": _path(lines)} for name, lines in met if lines]
            self._kept[view] = known
        return known[1]


def edges(region: SliceSampler, cut: Cut, shape: tuple[int, int]) -> list[FloatArray]:
    """Return the closed lines (N, 2) about a region in a cut, in mm from its middle, sampled with ``shape`` pixels."""
    import cv2

    values = values_hu(region, cut, shape, 0.0)
    if values.max() < EDGE:
        return []
    size = (FINER * shape[1], FINER * shape[0])
    inside = (cv2.resize(values, size, interpolation=cv2.INTER_LINEAR) >= EDGE).astype(np.uint8)
    lines, _ = cv2.findContours(inside, cv2.RETR_LIST, cv2.CHAIN_APPROX_TC89_L1)
    middle, pixel_mm = np.array(size) / 2, cut.field_mm / min(size)
    return [(line[:, 0] + 0.5 - middle) * pixel_mm for line in lines if len(line) > 2]


def _path(lines: list[FloatArray]) -> str:
    return "".join("M" + "L".join(f"{x:.2f} {y:.2f}" for x, y in line) + "Z" for line in lines)
