"""Balls of which a part is missing, as of cut balls and of the rounded heads of screws.

What holds a marker hides a part of its edge, and is bright there. Where nothing stands beside a ball, its edge is
where a sphere's is; a flat face lies farther in by more than kernels, noise and the slices' profile displace any edge.
What lies farther in on one side and farther out on another is a ball in two places: that is motion's to tell.
"""

from __future__ import annotations

import numpy as np

from ronnaplan.localization.fit.directions import NEIGHBOUR_SHARE, Verdict
from ronnaplan.localization.judge.evidence import Evidence

FAR = 2.0
"""An edge is far off by so many times what is allowed."""

MOST_MISSING = 0.06
"""In so many of all directions the edge may lie far in, with nothing beside it. Of 208 balls of 3 to 8 mm in seven
kinds of pictures 0.03 at most do; eleven of 15 cut balls and heads of screws that passed all other tests show 0.062 to
0.27."""


def what_is_missing(evidence: Evidence) -> str | None:
    """Tell how much of a ball is missing where nothing stands beside it, if too much is; else None.

    It is not asked of what is as large as the balls of a scan that makes them ragged, nor in cubic voxels, as cone
    beams have them: what these do to edges it was not held against.
    """
    if evidence.is_alike or evidence.volume.grid.is_in_cubes:
        return None
    missing = missing_share(evidence.verdict, evidence.fit.contrast_hu)
    if missing <= MOST_MISSING:
        return None
    return f"{missing:.0%} of it is missing where nothing stands beside it, {MOST_MISSING:.0%} allowed"


def missing_share(verdict: Verdict, contrast_hu: float) -> float:
    """Share of all directions in which a ball is missing, beyond those in which there is as much too much of it."""
    alone = (verdict.state >= 0) & ~verdict.beside & (verdict.excess_hu < NEIGHBOUR_SHARE * contrast_hu)
    off = verdict.off_share
    return float(np.mean(alone & (off < -FAR)) - np.mean(alone & (off > FAR)))
