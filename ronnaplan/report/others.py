"""Other trajectories beside one in the report: of many the nearest are listed, what is wrong with two is told once."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

from ronnaplan.planning import Measures, Verdict
from ronnaplan.planning.limits import is_near
from ronnaplan.planning.rows import Rows, distance_rows

NEAREST = 20
"""So many others are listed whatever their distance; who breaks a limit, or nearly so, always is."""


def with_far_ones_gathered(one: Measures, verdicts: Sequence[Verdict]) -> list[Verdict]:
    """Return the verdicts on a trajectory, those on others that are far from it as one: that on their nearest."""
    named = _others(one)
    on_others = [verdict for verdict in verdicts if (verdict.measure, verdict.value) in named]
    on_others.sort(key=lambda verdict: verdict.value or 0.0)
    far = [verdict for verdict in on_others[NEAREST:] if verdict.passes and not is_near(verdict)]
    if len(far) < 2:
        return list(verdicts)
    left_out = set(far)
    kept = [verdict for verdict in verdicts if verdict not in left_out]
    return [*kept, replace(far[0], measure=_called(len(far)), remark="the nearest of them")]


def nearest_rows(one: Measures) -> Rows:
    """Return how near a trajectory comes to obstacles and to the nearest others, where no limit could be held."""
    by_distance = sorted(one.spacings, key=lambda near: near.clearance_mm)
    far = by_distance[NEAREST:]
    if len(far) < 2:
        return distance_rows(one)
    left_out = set(far)
    kept = tuple(near for near in one.spacings if near not in left_out)
    least = f"{far[0].clearance_mm:.2f} mm, the nearest of them"
    return [*distance_rows(replace(one, spacings=kept)), (_called(len(far)), least)]


def faults(one: Measures, broken: Sequence[Verdict], told: set[frozenset[str]]) -> Iterator[Verdict]:
    """Yield what is ``broken`` of a trajectory; of two that come too near to each other once, as ``told`` keeps."""
    named = _others(one)
    for verdict in broken:
        other = named.get((verdict.measure, verdict.value))
        pair = frozenset((verdict.trajectory, other)) if other is not None else None
        if pair is None or pair not in told:
            yield verdict
        if pair is not None:
            told.add(pair)


def _others(one: Measures) -> dict[tuple[str, float | None], str]:
    """Return the other trajectories by measure and value of the verdicts on them."""
    return {(f"distance to {called}", near.clearance_mm): near.other for called, near in one.named_spacings}


def _called(count: int) -> str:
    return f"distance to {count} others"
