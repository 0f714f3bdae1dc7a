"""Regions that are shown, and their outlines: those to keep away from, and label maps by which nothing is judged."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ronnaplan.case.surroundings import Labels
from ronnaplan.ct import CTVolume
from ronnaplan.errors import UsageError
from ronnaplan.geometry import FloatArray
from ronnaplan.planner.panes import Pane
from ronnaplan.planner.storage import ShownRegion
from ronnaplan.planning.sampling import SliceSampler
from ronnaplan.planning.trajectory import COLOUR
from ronnaplan.scene.cut import Cut
from ronnaplan.scene.sampled import values_hu
from ronnaplan.scene.things import NO_GO_COLOUR, REGION_OPACITY, label_colour

MOST_PIXELS, FINER = 40_000, 3
"""With so many pixels a cut through a region is sampled, and each is divided so often before its edge is followed."""

EDGE = 0.5
"""Of a mask that is 1 inside and 0 outside, interpolated."""


@dataclass(frozen=True)
class Region:
    """A region as one page shows it: ``opacity`` is that of its surface; 0 hides its outlines, too."""

    name: str
    colour: str
    opacity: float = REGION_OPACITY
    no_go: bool = False


Regions = Mapping[str, Region]


def joined(no_go: Labels, labels: Labels) -> Labels:
    """Return the masks of both by name; a label map's region that is called like one to keep away from is renamed."""
    return {
        **no_go,
        **{name if name not in no_go else f"{name} (shown only)": mask for name, mask in labels.items()},
    }


def first_shown(no_go: Labels, masks: Labels, chosen: Mapping[str, ShownRegion]) -> Regions:
    """Return how the regions of ``masks`` are shown at first: as was ``chosen`` before, if it was."""
    shown = {name: Region(name, NO_GO_COLOUR, no_go=True) for name in no_go}
    for number, name in enumerate(name for name in masks if name not in no_go):
        shown[name] = Region(name, label_colour(number))
    for name in shown.keys() & chosen.keys():
        shown[name] = replace(shown[name], colour=chosen[name].colour, opacity=chosen[name].opacity)
    return shown


def changed(regions: Regions, name: str, colour: str, opacity: float) -> Regions:
    """Return the regions with one in another colour and opacity (0 to 1)."""
    if name not in regions:
        raise UsageError(f"there is no region {name}; there are {', '.join(regions) or 'none'}")
    if not COLOUR.fullmatch(colour):
        raise UsageError(f"colour {colour!r} is not of the form #rrggbb (lower case)")
    return {**regions, name: replace(regions[name], colour=colour, opacity=opacity)}


def region_rows(regions: Regions) -> list[dict[str, Any]]:
    """Return one row a region, as the page lists it."""
    return [
        {"name": one.name, "colour": one.colour, "opacity": one.opacity, "no_go": one.no_go}
        for one in regions.values()
    ]


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
