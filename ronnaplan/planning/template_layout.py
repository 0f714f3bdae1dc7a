"""Where the markers of a printed template stand, so that none of them is taken for another.

A layout is judged by its nearest rival: the best fit of the markers onto themselves, or onto their mirror image, in
another order (`ronnaplan.correspondence.layout`), and by how far it is from a line, about which it could turn
unnoticed. Places are moved one at a time, from many starts, to where the lesser of both is greatest.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations, permutations
from typing import TYPE_CHECKING

import numpy as np

from ronnaplan.errors import InputError, RefusedError
from ronnaplan.geometry import FloatArray, mutual_distances
from ronnaplan.planning.lengths import (
    CLEARANCE_MM,
    HOLE_MM,
    MARKER_HEIGHT_MM,
    PLATE_MM,
    PRINT_TOLERANCE_MM,
    SCREW_PLAY_MM,
    THICKNESS_MM,
    USUAL_DIAMETER_MM,
)
from ronnaplan.sigmas import SIGMA_CT_MM, SIGMA_OTS_MM

if TYPE_CHECKING:
    from ronnaplan.correspondence import Layout

MOST_MARKERS = 6
"""Of a template."""
GREATEST_REFUSAL = 0.001
"""A template whose markers would be refused more often is not made."""
STARTS, ROUNDS, TRIALS = 8, 12, 12
"""Starts of the search, rounds from each, places tried for a marker in a round."""
DRAWN, DRAWN_SINGLY = 200, 20
"""Times that a start is drawn anew where markers have no room, all holes at once, then one after the other."""
CT_DISTANCE_SD_MM = 0.15
"""Of a marker of a rigid frame in a scan, per axis: the scanner's scale and noise (the paper's phantom)."""
ENGRAVED_MM = 0.8
"""How deep labels are engraved: a plate is thicker."""
TOLERANCE_SDS = 4.0
"""A distance in a scan departs from the drawing's by less, in standard deviations."""
LONGEST_MM, LARGEST_RADIUS_MM = 500.0, 1e5
"""No plate for a head, nor its markers, is larger; bent to a larger radius it is flat."""
STANDARD_RADIUS_MM = 80.0
"""Of the lower surface from ear to ear, where no scan tells: a head 152 mm wide, and 4 mm of room."""


@dataclass(frozen=True)
class Bridge:
    """What the template is made of, mm: a plate ``size_mm`` wide and deep, bent from side to side or flat."""

    size_mm: tuple[float, float] = PLATE_MM
    radius_mm: float | None = STANDARD_RADIUS_MM
    """Of its lower surface; None for a flat one."""
    thickness_mm: float = THICKNESS_MM
    marker_diameter_mm: float = USUAL_DIAMETER_MM
    marker_height_mm: float = MARKER_HEIGHT_MM
    """From the upper surface to the marker's center."""
    clearance_mm: float = CLEARANCE_MM
    """Between two markers' surfaces at least."""
    pad_radius_mm: float = 9.0
    hole_diameter_mm: float = HOLE_MM
    print_tolerance_mm: float = PRINT_TOLERANCE_MM
    """A hole is printed off its place by up to so much along each axis."""
    screw_play_mm: float = SCREW_PLAY_MM
    """A marker's center is off its hole's axis, and its height, by up to so much: play, tilt and depth of its screw."""

    @property
    def sigma_mm(self) -> float:
        """Standard deviation per axis of a marker about its place on the drawing: both tolerances, evenly spread."""
        return float(np.hypot(self.print_tolerance_mm, self.screw_play_mm) / np.sqrt(3))

    @property
    def distance_tolerance_mm(self) -> float:
        """By how much a distance in a scan departs from the drawing's at most."""
        return float(TOLERANCE_SDS * np.sqrt(2 * (self.sigma_mm**2 + CT_DISTANCE_SD_MM**2)))

    @property
    def reach_mm(self) -> FloatArray:
        """How far (2,) a hole may be from the plate's middle."""
        return np.array(self.size_mm) / 2 - self.pad_radius_mm

    def bent(self, places_mm: FloatArray) -> FloatArray:
        """Return where the bent plate has places (..., 3) of the flat one (x, y, height above its lower surface)."""
        if self.radius_mm is None:
            return places_mm
        angle = places_mm[..., 0] / self.radius_mm
        out = self.radius_mm + places_mm[..., 2]
        return np.stack([out * np.sin(angle), places_mm[..., 1], out * np.cos(angle) - self.radius_mm], axis=-1)

    def centers_mm(self, holes_mm: FloatArray) -> FloatArray:
        """Return the markers (N, 3) that stand over holes (N, 2) of the flat plate."""
        height = np.full((len(holes_mm), 1), self.thickness_mm + self.marker_height_mm)
        return self.bent(np.hstack([holes_mm, height]))

    def check(self) -> None:
        """Raise `InputError` where no plate or no marker can be so."""
        width, depth = self.size_mm
        least = min(self.marker_diameter_mm, self.clearance_mm, self.print_tolerance_mm, self.screw_play_mm)
        if least < 0 or self.marker_diameter_mm == 0:
            raise InputError(
                f"markers of {self.marker_diameter_mm:g} mm, {self.clearance_mm:g} mm apart, printed within "
                f"{self.print_tolerance_mm:g} mm and screwed within {self.screw_play_mm:g} mm were asked for; expected "
                "nothing below zero, and a diameter above"
            )
        longest_mm = max(width, depth, self.thickness_mm, self.marker_diameter_mm, self.marker_height_mm)
        if longest_mm > LONGEST_MM or (self.radius_mm or 0.0) > LARGEST_RADIUS_MM:
            raise InputError(
                f"a template with a length of {longest_mm:g} mm, bent to a radius of {self.radius_mm or 0:g} mm, was "
                f"asked for; expected up to {LONGEST_MM:g} mm, and a radius up to {LARGEST_RADIUS_MM:g} mm or none"
            )
        if self.thickness_mm <= ENGRAVED_MM:
            raise InputError(
                f"a template {self.thickness_mm:g} mm thick was asked for; expected more than {ENGRAVED_MM:g} mm, the "
                "depth of its labels"
            )
        if min(self.reach_mm) <= 0:
            raise InputError(
                f"a template of {width:g} x {depth:g} mm has no room for a pad of {2 * self.pad_radius_mm:g} mm; "
                "take a larger one"
            )
        if self.radius_mm is not None and self.radius_mm < width / 2:
            raise InputError(
                f"a template {width:g} mm wide was to be bent to a radius of {self.radius_mm:g} mm; "
                "expected at least half its width"
            )
        if self.marker_height_mm < self.marker_diameter_mm / 2:
            raise InputError(
                f"markers of {self.marker_diameter_mm:g} mm were to stand {self.marker_height_mm:g} mm above the "
                "template; expected at least their radius"
            )
        if not 0 < self.hole_diameter_mm < self.pad_radius_mm:
            raise InputError(
                f"holes of {self.hole_diameter_mm:g} mm were asked for; expected more than 0 and less than "
                f"{self.pad_radius_mm:g} mm"
            )


@dataclass(frozen=True, eq=False)
class TemplateLayout:
    """The template's holes (N, 2) in the flat plate, and what is to be expected of its markers."""

    bridge: Bridge
    holes_mm: FloatArray
    sigma_ct_mm: float = SIGMA_CT_MM
    sigma_ots_mm: float = SIGMA_OTS_MM

    @cached_property
    def centers_mm(self) -> FloatArray:
        """The markers (N, 3): x from right to left, y from front to back, z up, about the plate's middle."""
        return self.bridge.centers_mm(self.holes_mm)

    @property
    def labels(self) -> tuple[str, ...]:
        """A, B, ... from right to left."""
        return tuple("ABCDEF"[: len(self.holes_mm)])

    @cached_property
    def layout(self) -> Layout:
        """The nearest rival that correspondence could take for the truth."""
        from ronnaplan.correspondence import describe_layout

        return describe_layout(self.centers_mm)

    @cached_property
    def rival_distance_mm(self) -> float:
        """How far the nearest rival is, turned or mirrored."""
        from ronnaplan.correspondence.layout import mirror_distance

        return min(self.layout.rival_distance_mm, mirror_distance(self.centers_mm))

    @property
    def worth_mm(self) -> float:
        """The rival distance, or that from the best line if less: both are root sums of squares over the markers."""
        return min(self._rival_and_line_mm, self.rival_distance_mm)

    def is_worth_more(self, than_mm: float) -> bool:
        """Tell whether `worth_mm` is more; the mirrored rival, which takes longest, is looked for last."""
        return self._rival_and_line_mm > than_mm and self.rival_distance_mm > than_mm

    @property
    def _rival_and_line_mm(self) -> float:
        line_mm = float(np.sqrt(len(self.holes_mm))) * self.layout.line_distance_mm
        return min(self.layout.rival_distance_mm, line_mm)

    @property
    def refusal_probability(self) -> float:
        """How often correspondence refuses the markers for their nearest rival.

        That they do not stand where they were drawn counts as if scan and tracker differed by it.
        """
        return self.layout.refusal_probability(
            float(np.hypot(self.sigma_ct_mm, self.bridge.sigma_mm)), self.sigma_ots_mm
        )

    @cached_property
    def distance_gap_mm(self) -> float:
        """By how much at least one distance differs, in whatever other order the markers are taken."""
        apart = mutual_distances(self.centers_mm)
        orders = list(permutations(range(len(apart))))[1:]
        return min(float(np.abs(apart[np.ix_(order, order)] - apart).max()) for order in orders)


def refusal_text(probability: float) -> str:
    """Return a probability in percent, not smaller than it can be told."""
    return "less than 0.001 %" if probability < 1e-5 else f"{100 * probability:.3g} %"


def design_template(
    count: int,
    bridge: Bridge,
    *,
    sigma_ct_mm: float = SIGMA_CT_MM,
    sigma_ots_mm: float = SIGMA_OTS_MM,
    seed: int = 0,
) -> TemplateLayout:
    """Return the layout of ``count`` markers on ``bridge`` of the greatest worth.

    Raises `InputError` where so many markers do not fit, `RefusedError` where they could be confused.
    """
    if not 3 <= count <= MOST_MARKERS:
        raise InputError(f"{count} markers were asked for; a template has 3 to {MOST_MARKERS}")
    bridge.check()
    rng = np.random.default_rng(seed)
    starts = [holes for _ in range(STARTS) if (holes := random_holes(count, bridge, rng)) is not None]
    if not starts:
        raise InputError(
            f"{count} markers do not fit on {bridge.size_mm[0]:g} x {bridge.size_mm[1]:g} mm with "
            f"{bridge.clearance_mm:g} mm between them, on pads of {2 * bridge.pad_radius_mm:g} mm; take a larger "
            "template"
        )
    found = max((_improved(holes, bridge, rng) for holes in starts), key=lambda one: one.worth_mm)
    order = np.lexsort((found.holes_mm[:, 1], found.holes_mm[:, 0]))
    best = TemplateLayout(bridge, found.holes_mm[order], sigma_ct_mm, sigma_ots_mm)
    require_unmistakable(best)
    return best


def require_unmistakable(found: TemplateLayout) -> None:
    """Raise `RefusedError` where correspondence, or `localize --template`, could take a marker for another."""
    size = " x ".join(f"{side:g}" for side in found.bridge.size_mm)
    remedy = "take a larger one, more markers, or smaller tolerances"
    if found.refusal_probability >= GREATEST_REFUSAL:
        raise RefusedError(
            f"the best template of {len(found.holes_mm)} markers on {size} mm would be refused for its nearest "
            f"rival in {refusal_text(found.refusal_probability)} of cases, expected below "
            f"{100 * GREATEST_REFUSAL:g} %; {remedy}"
        )
    tolerance = found.bridge.distance_tolerance_mm
    if found.distance_gap_mm <= 2 * tolerance:
        raise RefusedError(
            f"the best template of {len(found.holes_mm)} markers on {size} mm has distances that differ by no more "
            f"than {found.distance_gap_mm:.1f} mm in another order, expected over {2 * tolerance:.1f} mm: print and "
            f"screws leave {tolerance:.1f} mm of doubt in each; {remedy}"
        )


def random_holes(count: int, bridge: Bridge, rng: np.random.Generator) -> FloatArray | None:
    """Return holes (N, 2) anywhere on the plate with clearance between the markers, None where they found no room."""
    reach = bridge.reach_mm
    for _ in range(DRAWN):
        holes = rng.uniform(-reach, reach, (count, 2))
        if _apart(holes, bridge):
            return holes
    for _ in range(DRAWN_SINGLY):  # where many hardly fit, all drawn at once seldom do
        holes = rng.uniform(-reach, reach, (1, 2))
        for one in rng.uniform(-reach, reach, (DRAWN, 2)):
            more = np.vstack([holes, one])
            holes = more if len(holes) < count and _apart(more, bridge) else holes
        if len(holes) == count:
            return holes
    return None


def _improved(holes_mm: FloatArray, bridge: Bridge, rng: np.random.Generator) -> TemplateLayout:
    best, reach = TemplateLayout(bridge, holes_mm), bridge.reach_mm
    for step in np.geomspace(1.0, 0.02, ROUNDS):
        for marker in range(len(holes_mm)):
            for _ in range(TRIALS):
                holes = best.holes_mm.copy()
                holes[marker] = np.clip(holes[marker] + rng.normal(size=2) * step * reach, -reach, reach)
                moved = TemplateLayout(bridge, holes)
                if _apart(holes, bridge) and moved.is_worth_more(best.worth_mm):
                    best = moved
    return best


def _apart(holes_mm: FloatArray, bridge: Bridge) -> bool:
    least = bridge.marker_diameter_mm + bridge.clearance_mm
    places = holes_mm, bridge.centers_mm(holes_mm)
    flat, bent = (min(math.dist(*two) for two in combinations(at.tolist(), 2)) for at in places)
    return bent >= least and flat >= 2 * bridge.pad_radius_mm
