"""Where to put the markers, before the scan that counts: so that the error at the targets is least.

For equal, isotropic errors the expected squared error at a place r from the markers' centroid is, after
Fitzpatrick, West and Maurer (1998, IEEE TMI 17:694), sigma^2 (3 / N + trace([r]x K^-1 [r]x')), K the markers'
inertia about their centroid. So more markers help, and a centroid near the target, and a spread to all sides. The
largest of it over the targets is made small by exchange: every marker in turn is moved to the allowed place where
it helps most, from several starts, until no move helps.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ronnaplan.ct.progress import Progress, advancing
from ronnaplan.errors import InputError, RefusedError
from ronnaplan.geometry import FloatArray, Frame, Points, as_points
from ronnaplan.planning.sites import PlacementRules, Sites, allowed_sites, even_layout
from ronnaplan.planning.uncertainty import ExpectedPose
from ronnaplan.text import listed

if TYPE_CHECKING:
    from ronnaplan.correspondence import Layout

STARTS = 12
"""Starting layouts of the exchange; the best end is taken."""

SPREADS = 5
"""Even spreads, differently turned, that a proposal is compared with."""


@dataclass(frozen=True, eq=False)
class Placement:
    """Proposed markers: on the scalp (N, 3), their normals (N, 3) and centers (N, 3), LPS mm."""

    scalp_mm: FloatArray
    normals: FloatArray
    centers_mm: FloatArray
    diameter_mm: float
    expected: ExpectedPose
    """The error of the registration that they will give."""
    tre_rms_mm: FloatArray
    """That error at each target (T,)."""
    rival_distance_mm: float
    """How far the layout is from being taken for itself in another order."""
    refusal_probability: float
    """How often correspondence would refuse it."""
    allowed: int
    """The number of sites that were open."""
    even_tre_mm: float
    """The largest expected error of as many markers spread evenly over them: the mean of some spreads."""
    doubt: str | None
    """Why some places may not do."""

    @property
    def largest_tre_mm(self) -> float:
        """The error that was minimized: the largest over the targets."""
        return float(self.tre_rms_mm.max())


def place_markers(
    sites: Sites,
    targets_mm: ArrayLike,
    count: int,
    rules: PlacementRules,
    entries_mm: ArrayLike = (),
    seed: int = 0,
    progress: Progress = False,
) -> Placement:
    """Propose ``count`` markers among ``sites`` that make the largest expected error at ``targets_mm`` (T, 3) least.

    ``progress`` shows or is told how many of the layouts were tried. Raises `InputError` for fewer than three markers
    or no target, and `RefusedError` when the rules leave no layout.
    """
    from ronnaplan.correspondence.layout import GREATEST_REFUSAL

    targets = as_points(targets_mm, "targets")
    if count < 3 or len(targets) == 0:
        raise InputError(
            f"{count} markers for {len(targets)} targets were asked for; expected three or more for at least one"
        )
    allowed = allowed_sites(sites, rules, entries_mm)
    centers = allowed.centers_mm(rules.height_mm)
    generator = np.random.default_rng(seed)
    best: tuple[float, NDArray[np.int64]] | None = None
    for _ in advancing(range(STARTS), STARTS, progress, "trying layouts"):
        start = scattered_layout(centers, count, rules.least_apart_mm, generator)
        if start is None:
            continue
        score, chosen = _improve(centers, targets, start, rules)
        if (best is None or score < best[0]) and _refusal(centers[chosen], rules) <= GREATEST_REFUSAL:
            best = (score, chosen)
    if best is None:
        raise RefusedError(
            f"no unambiguous layout of {count} markers keeps the rules on {len(allowed)} allowed places; allow "
            "more of the scalp, a smaller distance, or another number of markers"
        )
    chosen = best[1][np.argsort(-centers[best[1], 2], kind="stable")]
    layout, expected = _described(centers[chosen]), _expected(centers[chosen], rules)
    return Placement(
        allowed.scalp_mm[chosen],
        allowed.normals[chosen],
        centers[chosen],
        rules.diameter_mm,
        expected,
        expected.tre_rms_mm(targets),
        layout.rival_distance_mm,
        layout.refusal_probability(rules.sigma_ct_mm, rules.sigma_ots_mm),
        len(allowed),
        even_tre_mm(allowed, targets, count, rules, generator),
        None if rules.lowest_mm is not None else _low_doubt(allowed.scalp_mm[chosen], sites.inside_mm),
    )


def _low_doubt(scalp_mm: FloatArray, inside_mm: FloatArray) -> str | None:
    """Return which places (N, 3) lie in the lower half of what is scanned, where nothing tells a face from a scalp."""
    low = [f"M{n}" for n, place in enumerate(scalp_mm, 1) if place[2] < inside_mm[2]]
    if not low:
        return None
    return (
        f"below the middle of the head as it is scanned (z {inside_mm[2]:.0f} mm), and so perhaps on face or neck: "
        f"{listed(low)}; look at them"
    )


def even_tre_mm(
    allowed: Sites, targets_mm: FloatArray, count: int, rules: PlacementRules, generator: np.random.Generator
) -> float:
    """Return the largest expected error over the targets (T, 3) of markers spread evenly, mean of `SPREADS`."""
    centers = allowed.centers_mm(rules.height_mm)
    layouts = (centers[even_layout(allowed, count, generator)] for _ in range(SPREADS))
    return float(np.mean([expected_tre_mm(layout, targets_mm, rules).max() for layout in layouts]))


def expected_tre_mm(markers_mm: FloatArray, targets_mm: FloatArray, rules: PlacementRules) -> FloatArray:
    """Return the expected root-mean-square error (T,) at ``targets_mm`` (T, 3), mm."""
    return _expected(markers_mm, rules).tre_rms_mm(targets_mm)


def _expected(markers_mm: FloatArray, rules: PlacementRules) -> ExpectedPose:
    labels = tuple(f"M{number}" for number in range(1, len(markers_mm) + 1))
    markers = Points.exact(markers_mm, labels, Frame("CT"))
    return ExpectedPose.planned(markers, rules.sigma_ct_mm, rules.sigma_ots_mm)


def scattered_layout(
    centers: FloatArray, count: int, apart_mm: float, generator: np.random.Generator
) -> NDArray[np.int64] | None:
    """Return a random layout (``count``,) of centers (S, 3) that keep apart, or None when the places ran out."""
    open_places = np.ones(len(centers), dtype=np.bool_)
    chosen: list[int] = []
    while len(chosen) < count:
        if not open_places.any():
            return None
        chosen.append(int(generator.choice(np.flatnonzero(open_places))))
        open_places &= np.linalg.norm(centers - centers[chosen[-1]], axis=1) >= apart_mm
    return np.array(chosen, dtype=np.int64)


def _improve(
    centers: FloatArray, targets: FloatArray, start: NDArray[np.int64], rules: PlacementRules
) -> tuple[float, NDArray[np.int64]]:
    """Exchange markers until no move helps; a move that makes the layout ambiguous is not taken."""
    from ronnaplan.correspondence.layout import GREATEST_REFUSAL
    from ronnaplan.planning.compiled import exchange, largest

    chosen = start.copy()
    best = float(largest(np.ascontiguousarray(centers[chosen]), targets))
    moved = True
    while moved:
        moved = False
        for place in range(len(chosen)):
            scores = np.full(len(centers), np.inf)
            exchange(centers, targets, chosen, place, rules.least_apart_mm, scores)
            for site in np.argsort(scores, kind="stable")[:_MOST_TRIED]:
                if not scores[site] < best * (1.0 - 1e-9):
                    break
                trial = chosen.copy()
                trial[place] = site
                if _refusal(centers[trial], rules) <= max(GREATEST_REFUSAL, _refusal(centers[chosen], rules)):
                    chosen, best, moved = trial, float(scores[site]), True
                    break
    return best, chosen


_MOST_TRIED = 20
"""Places tried for a marker before it is left where it is, should the best ones be ambiguous."""


def _refusal(markers: FloatArray, rules: PlacementRules) -> float:
    return _described(markers).refusal_probability(rules.sigma_ct_mm, rules.sigma_ots_mm)


def _described(markers: FloatArray) -> Layout:
    from ronnaplan.correspondence import describe_layout

    return describe_layout(markers)
