"""Regions that are shown: those to keep away from, and label maps by which nothing is judged."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from ronnaplan.case.surroundings import Labels
from ronnaplan.errors import UsageError
from ronnaplan.planner.storage import ShownRegion
from ronnaplan.planning.trajectory import COLOUR
from ronnaplan.scene.things import NO_GO_COLOUR, REGION_OPACITY, label_colour


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
