"""How a person looks at the head in 3-D: as what it is drawn, what is taken away, and where its surface is met."""

from __future__ import annotations

import numpy as np

from ronnaplan.bounds import LOWEST_HU
from ronnaplan.ct import CTVolume
from ronnaplan.errors import UsageError
from ronnaplan.geometry import FloatArray
from ronnaplan.planning.measures import DEEPEST_ENTRY_MM
from ronnaplan.planning.sampling import SliceSampler
from ronnaplan.scene.cut import Cut
from ronnaplan.scene.field import bounds_mm
from ronnaplan.scene.surfaces import SURFACES
from ronnaplan.scene.volume import PRESETS

SNAP_STEP_MM, SNAP_WAYS = 0.25, 64
"""The scalp near an entry that is clicked or dragged is looked for in such steps and so many ways."""

OPENINGS: dict[str, int | None] = {"corner": None, "axial": 2, "coronal": 1, "sagittal": 0}
"""What may be taken away before the crosshair: the corner, or all on one side of a cut, whose axis is told."""

RAY_STEP_MM = 0.5
"""A surface is looked for along a ray in steps of this size."""


class HeadLooking:
    """What of a scan is seen in 3-D, about the crosshair."""

    def __init__(self, volume: CTVolume) -> None:
        self.scan = SliceSampler.of(volume)
        self.bounds_mm = bounds_mm(volume)
        """Smallest and largest LPS coordinates (3,) of voxel centers."""
        self.crosshair_mm: FloatArray
        self.surface = "skin"
        self.preset = ""
        """As what the scan is drawn whole in the 3-D view; empty where its surface is."""
        self.strength = 1.0
        """How dense it is drawn."""
        self.opened = ""
        """Which part of the head before the crosshair is taken away in the 3-D view: one of `OPENINGS`, or none."""

    def other_surface(self) -> None:
        """Show the skull in the place of the skin in the 3-D view, or the other way about."""
        self.preset = ""
        self.surface = "skull" if self.surface == "skin" else "skin"

    def show_as(self, name: str) -> None:
        """Show a surface (skin, skull) in the 3-D view, or the scan whole as one of the presets."""
        if name in SURFACES:
            self.surface, self.preset = name, ""
        elif name in PRESETS:
            self.surface, self.preset = PRESETS[name].surface, name
        else:
            raise UsageError(f"the head is not drawn as {name}; it is as {', '.join((*SURFACES, *PRESETS))}")

    def open_head(self, name: str) -> None:
        """Take a part of the head before the crosshair away, or none (empty)."""
        if name not in ("", *OPENINGS):
            raise UsageError(f"the head is not opened as {name}; it is as {', '.join(OPENINGS)}")
        self.opened = name

    def surface_along(self, origin_mm: FloatArray, direction: FloatArray) -> FloatArray | None:
        """Return where a ray from ``origin_mm`` (3,) along the unit vector (3,) first meets the surface shown.

        The surface is taken from the voxels, not from the coarse triangles of the 3-D view; None if it is missed.
        """
        reach = float(np.linalg.norm(np.abs(origin_mm - np.array(self.bounds_mm)).max(axis=0)))
        places = origin_mm + np.arange(0.0, reach, RAY_STEP_MM)[:, np.newaxis] * direction
        values, level = self.scan.values_hu(places), SURFACES[self.surface].value
        there = values >= level
        if self.opened:
            towards = self.opened_towards(origin_mm)
            there &= ~((places - self.crosshair_mm) * towards > np.abs(towards) - 1.0).all(axis=1)
        inside = np.flatnonzero(there)
        if not len(inside):
            return None
        first = int(inside[0])
        before = values[first - 1] if first else np.nan
        share = (values[first] - level) / (values[first] - before) if before < level else 0.0
        place: FloatArray = places[first] - share * RAY_STEP_MM * direction
        return place

    def onto_scalp(self, place_mm: FloatArray, plane: Cut) -> FloatArray:
        """Return the place (3,) on the skin nearest to another in a plane, or the other if none is near.

        That is within `DEEPEST_ENTRY_MM`: from further, an entry is doubted.
        """
        angles = np.linspace(0.0, 2 * np.pi, SNAP_WAYS, endpoint=False)[:, np.newaxis]
        ways = np.cos(angles) * plane.right + np.sin(angles) * plane.down
        reaches = np.arange(0.0, DEEPEST_ENTRY_MM + SNAP_STEP_MM, SNAP_STEP_MM)
        places = place_mm + ways[:, np.newaxis] * reaches[:, np.newaxis]
        level = SURFACES["skin"].value
        above = (
            np.nan_to_num(self.scan.values_hu(places.reshape(-1, 3)), nan=LOWEST_HU).reshape(places.shape[:2])
            - level
        )
        crosses = (above[:, 1:] >= 0.0) != (above[:, :-1] >= 0.0)
        if not crosses.any():
            return place_mm
        first = np.where(crosses.any(axis=1), crosses.argmax(axis=1), len(reaches))
        way = int(first.argmin())
        before, after = above[way, first[way] : first[way] + 2]
        found: FloatArray = place_mm + (reaches[first[way]] + SNAP_STEP_MM * before / (before - after)) * ways[way]
        return found

    def opened_towards(self, eye_mm: FloatArray) -> FloatArray:
        """Return the signs (3,) of the LPS axes, from the crosshair, of the part that is taken away; 0 for any."""
        signs = np.where(eye_mm < self.crosshair_mm, -1.0, 1.0)
        across = OPENINGS.get(self.opened)
        return signs if across is None else signs * np.eye(3)[across]
