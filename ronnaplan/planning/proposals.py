"""Entries for a target: every way to the scalp is scored, the best that keep all limits are returned."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ronnaplan.errors import InputError, check_type
from ronnaplan.geometry import FloatArray, as_point
from ronnaplan.planning.angles import RAS_IN_LPS
from ronnaplan.planning.candidates import Candidates, Field, cast, spread_directions
from ronnaplan.planning.head import SKIN_HU, Head
from ronnaplan.planning.landmarks import Landmarks
from ronnaplan.planning.layers import Way
from ronnaplan.planning.lengths import ENTRIES
from ronnaplan.planning.limits import Limits, Verdict, all_pass, judge
from ronnaplan.planning.measures import Measures, measure
from ronnaplan.planning.obstacles import POST_RADIUS_MM, Kind, Obstacle, PostedMarker, Voxels
from ronnaplan.planning.segments import point_distances, segment_distances
from ronnaplan.planning.trajectory import INSTRUMENTS, Instrument, Trajectory
from ronnaplan.planning.uncertainty import Expectation

DIRECTIONS = 20_000
"""Ways that are tried: one a 1.4 degrees, 2 mm apart on the scalp of a deep target."""

APART_MM = 10.0
"""Entries that are proposed lie at least this far from each other."""

SLACK_DEG, SLACK_MM, SLACK_BONE_MM = 3.0, 0.5, 1.5
"""What the coarse search may be off; candidates beyond a limit by more are not looked at."""

MOST_CHECKED = 200
"""Candidates measured in full before the search for proposals ends."""

USUAL_ANGLE_DEG, USUAL_PATH_MM, USUAL_BONE_MM, AMPLE_DISTANCE_MM = 45.0, 120.0, 15.0, 10.0
"""What counts as the worst (angle, length, bone) where no limit says so, and as distance enough."""


@dataclass(frozen=True, eq=False)
class Proposal:
    """A path called as it was asked for, which keeps every limit, its score (0 to 1), and why in words."""

    trajectory: Trajectory
    score: float
    measures: Measures
    verdicts: tuple[Verdict, ...]
    reasons: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Proposals:
    """The best entries, best first, and the whole map: ``scores`` (M,) of ``candidates``, NaN where excluded.

    ``excluded`` counts, by reason, the ways that were not scored.
    """

    best: tuple[Proposal, ...]
    candidates: Candidates
    scores: FloatArray
    excluded: dict[str, int]


def propose(
    target_mm: FloatArray,
    head: Head,
    limits: Limits,
    *,
    name: str = "proposal",
    instrument: Instrument = INSTRUMENTS["pointer"],
    obstacles: Sequence[Obstacle] = (),
    others: Sequence[Trajectory] = (),
    expected: Expectation = Expectation(),  # noqa: B008  # frozen
    landmarks: Landmarks | None = None,
    frame_axes: FloatArray = RAS_IN_LPS,
    count: int = ENTRIES,
    directions: int = DIRECTIONS,
) -> Proposals:
    """Score every way from ``target_mm`` (3,), LPS, to the scalp and return up to ``count`` entries.

    A way is excluded when it leaves the scan, meets no skull, runs through bone or air below the skull, or breaks
    a limit. Each one returned was measured in full (see `measure` for the rest), as the one trajectory of this ``name``
    beside ``others``, and keeps all of ``limits``; there may be none. Raises `InputError` for a target outside the scan
    or in air.
    """
    check_type(head, Head, "the head", "Head.of(volume) returns one")
    check_type(limits, Limits, "the limits", "make them with Limits(longest_path_mm=80.0), say")
    target = as_point(target_mm, "the target")
    if not head.scan.values_hu(target[np.newaxis])[0] >= SKIN_HU:
        raise InputError(
            f"the target at LPS {np.round(target, 1).tolist()} lies outside the scan or in air; choose a place in "
            "the head (LPS or RAS?)"
        )
    field = Field.of([one for one in obstacles if isinstance(one, Voxels)], head)
    found = cast(head, target, spread_directions(directions), field)
    scores, excluded = _scores(found, limits, instrument, obstacles, others)
    best: list[Proposal] = []
    checked = 0
    for m in np.argsort(-np.nan_to_num(scores, nan=-1.0), kind="stable"):
        if len(best) == count or checked == MOST_CHECKED or np.isnan(scores[m]):
            break
        entry = found.entries_mm[m]
        if any(np.linalg.norm(entry - one.trajectory.entry_mm) < APART_MM for one in best):
            continue
        path = Trajectory(name, entry, target, head.volume.frame, instrument)
        measured = measure(
            path,
            head,
            obstacles=obstacles,
            others=others,
            landmarks=landmarks,
            expected=expected,
            tolerance_mm=limits.tolerance_mm,
            frame_axes=frame_axes,
        )
        verdicts = judge(measured, limits)
        checked += 1
        if all_pass(verdicts):
            best.append(Proposal(path, float(scores[m]), measured, verdicts, _reasons(measured)))
    return Proposals(tuple(best), found, scores, excluded)


def _scores(
    found: Candidates,
    limits: Limits,
    instrument: Instrument,
    obstacles: Sequence[Obstacle],
    others: Sequence[Trajectory],
) -> tuple[FloatArray, dict[str, int]]:
    """Return the score (M,) of each way, NaN for the excluded ones, and how many were excluded for what."""
    clearance = found.distance_mm - instrument.radius_mm
    apart = _to_segments(found, instrument, obstacles, others)
    longest = min(limits.longest_path_mm or np.inf, instrument.length_mm)
    steepest = limits.greatest_skull_angle_deg or 90.0
    needed = max(limits.least_distance_mm(Kind.NO_GO), limits.least_distance_mm(Kind.METAL))
    kinds = {one.kind for one in obstacles if isinstance(one, Voxels)}
    if kinds:
        needed = min(limits.least_distance_mm(kind) for kind in kinds)
    thickness = found.outer_mm - found.inner_mm
    reasons = {
        "leaves the scan": found.way == Way.CUT,
        "something is attached to the head": found.way == Way.COVERED,
        "meets no skull": np.isnan(found.inner_mm),
        "bone or air below the skull": ~found.clean,
        "path too long": ~(found.scalp_mm <= longest),
        "too oblique to the skull": ~(found.angle_deg <= steepest + SLACK_DEG),
        "skull too thick": ~(thickness <= (limits.greatest_skull_thickness_mm or np.inf) + SLACK_BONE_MM),
        "too near a no-go region or metal": ~(clearance >= needed - SLACK_MM),
        "too near a marker or trajectory": ~(apart >= 0.0),
    }
    open_ways = np.ones(len(found.way), dtype=np.bool_)
    excluded = {}
    for reason, bad in reasons.items():
        excluded[reason] = int((open_ways & bad).sum())
        open_ways &= ~bad
    parts = [
        1.0 - np.clip(found.angle_deg / (limits.greatest_skull_angle_deg or USUAL_ANGLE_DEG), 0.0, 1.0),
        1.0 - np.clip(found.scalp_mm / (limits.longest_path_mm or USUAL_PATH_MM), 0.0, 1.0),
        1.0 - np.clip(thickness / (limits.greatest_skull_thickness_mm or USUAL_BONE_MM), 0.0, 1.0),
        np.clip(np.minimum(clearance, apart) / AMPLE_DISTANCE_MM, 0.0, 1.0),
    ]
    scores: FloatArray = np.where(open_ways, np.mean(parts, axis=0), np.nan)
    return scores, {reason: number for reason, number in excluded.items() if number}


def _to_segments(
    found: Candidates, instrument: Instrument, obstacles: Sequence[Obstacle], others: Sequence[Trajectory]
) -> FloatArray:
    """Return by how much (M,) each way keeps more than zero distance from all markers and other trajectories."""
    target = found.target_mm
    least = np.full(len(found.outward), np.inf)
    tails = target + max(instrument.length_mm, 1.0) * found.outward
    for marker in (one for one in obstacles if isinstance(one, PostedMarker)):
        axis, _ = segment_distances(tails, target, marker.center_mm, marker.foot_mm)
        sphere = point_distances(marker.center_mm, tails, np.broadcast_to(target, tails.shape))
        nearest = np.minimum(axis - POST_RADIUS_MM, sphere - marker.diameter_mm / 2)
        least = np.minimum(least, nearest - instrument.radius_mm)
    entries = np.where(np.isnan(found.entries_mm), target + found.outward, found.entries_mm)
    for other in others:
        axis, _ = segment_distances(entries, target, other.entry_mm, other.target_mm)
        least = np.minimum(least, axis - instrument.radius_mm - other.instrument.radius_mm)
    return least


def _reasons(measured: Measures) -> tuple[str, ...]:
    reasons = [f"{measured.length_mm:.1f} mm long"]
    if measured.skull_angle_deg is not None and measured.skull_thickness_mm is not None:
        reasons.append(f"{measured.skull_angle_deg:.1f} deg to the skull's normal")
        reasons.append(f"{measured.skull_thickness_mm:.1f} mm of bone")
    reasons += [f"{one.clearance_mm:.1f} mm from {one.name}" for one in measured.clearances]
    reasons += [f"{one.clearance_mm:.1f} mm from {one.other}" for one in measured.spacings]
    if measured.error is not None:
        error = measured.error
        reasons.append(f"{error.target_rms_mm:.2f} mm expected error at the target, as {error.expected.basis}")
    return tuple(reasons)


def score_map(proposals: Proposals) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
    """Return the scalp points (P, 3) that were reached, their scores (P,), and which of them are allowed."""
    reached = proposals.candidates.way == Way.OPEN
    scores = proposals.scores[reached]
    return proposals.candidates.entries_mm[reached], scores, ~np.isnan(scores)
