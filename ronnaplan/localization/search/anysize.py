"""Where balls of any size may be: what looks like a sphere in nearest voxels.

Votes for balls of a few sizes give places; where half the image's step lies in every direction from there gives each a
sphere, and so its size.
"""

from __future__ import annotations

import numpy as np

from ronnaplan.ct.progress import advancing
from ronnaplan.ct.volume import CTVolume
from ronnaplan.geometry import FloatArray, first_apart
from ronnaplan.localization.build import Build
from ronnaplan.localization.scanner.scan import Scan
from ronnaplan.localization.search.coarse import blocks, coarse_voxel_mm, coarsen
from ronnaplan.localization.search.detect import detect_in
from ronnaplan.localization.search.look import surface_shares
from ronnaplan.localization.search.sphere import LEAST_SHOWN, spheres_at
from ronnaplan.localization.search.votes import cell_mm
from ronnaplan.threads import in_threads

SEARCHED_MM = (3.0, 26.0)
"""Markers in use have diameters within this range."""

STEP_CELLS = 2.0
"""Each size voted for is larger than the last by so many cells of votes: no ball's surface is off by more than half a
cell, and votes gather over three."""

COARSEST_SHARE = 1.0 / 2.9
"""Voxels in which a ball of any size is still seen, as a share of its diameter: its sphere is sought in finer ones."""

MOST_LOOKED_AT = 1500
"""The strongest candidates of each size that are looked at; noise has thousands of small ones."""

Place = tuple[FloatArray, float]
"""A center (3,) in LPS and a diameter, in mm."""


def round_places(scan: Scan, coarse: CTVolume, marker: Build, progress: bool) -> list[Place]:
    """Return what looks like a sphere, whatever its size, the roundest first.

    Votes are taken from the ``coarse`` copy; those for large balls from a coarser copy of it.
    """
    volume = scan.volume

    def voted(copy: CTVolume, sizes_mm: list[float]) -> list[Place]:
        balls: list[Place] = []
        for diameter_mm, seen in zip(sizes_mm, detect_in(copy, sizes_mm), strict=True):
            places = seen[:MOST_LOOKED_AT]
            thickness_mm = scan.thickness_mm(places)
            shares = surface_shares(volume, places, diameter_mm, marker, thickness_mm, LEAST_SHOWN)
            balls += [(place, diameter_mm) for place in places[shares >= LEAST_SHOWN]]
        return balls

    copies = _copies(coarse, max(SEARCHED_MM[0], 3.0 * volume.grid.row_spacing_mm))
    tried = advancing(in_threads(lambda one: voted(*one), copies), len(copies), progress, "trying sizes")
    found = [ball for some in tried for ball in some]
    if not found:
        return []
    looked_at = np.array([place for place, _ in found]), np.array([size for _, size in found])
    centers_mm, diameters_mm, shares = spheres_at(volume, *looked_at, marker)
    roundest = np.argsort(-shares, kind="stable")[: np.count_nonzero(shares)]
    kept = roundest[first_apart(centers_mm[roundest], diameters_mm[roundest] / 2.0)]
    return [(centers_mm[n], float(diameters_mm[n])) for n in kept]


def _copies(coarse: CTVolume, smallest_mm: float) -> list[tuple[CTVolume, list[float]]]:
    """Return copies that are ever coarser, and the diameters, from the smallest on, that are voted for in each."""
    copies: list[tuple[CTVolume, list[float]]] = [(coarse, [])]
    diameter_mm = smallest_mm
    while diameter_mm < SEARCHED_MM[1]:
        coarsest, sizes_mm = copies[-1]
        voxel_mm = coarse_voxel_mm(diameter_mm, COARSEST_SHARE)
        if max(blocks(coarsest, voxel_mm)) > 1:
            coarsest, sizes_mm = coarsen(coarsest, voxel_mm), []
            copies.append((coarsest, sizes_mm))
        sizes_mm.append(diameter_mm)
        diameter_mm += STEP_CELLS * cell_mm(diameter_mm, coarsest.grid.pixel_mm)
    return [(copy, sizes_mm) for copy, sizes_mm in copies if sizes_mm]
