"""One change of a plan, made again to the plan as another hand has left it meanwhile."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np

from ronnaplan.errors import InputError
from ronnaplan.planning.plan import Change, Landmarks, Plan
from ronnaplan.planning.trajectory import Trajectory


def merged(base: Plan, mine: Plan, theirs: Plan) -> Plan:
    """Return ``theirs`` with the change that led from ``base`` to ``mine``, where both hands changed other things.

    Raises `InputError` where the other hand changed the same trajectory or landmarks, and where ``mine`` is not one
    change further than ``base`` (one was taken back, say); `FrameMismatchError` where ``theirs`` is of another scan.
    """
    theirs.require_source(base.frame, base.voxel_sha256)
    if len(mine.history) != len(base.history) + 1 or mine.history[:-1] != base.history:
        raise InputError(
            "the plan was changed by another hand meanwhile; look at it as it is now, then take back or make again"
        )
    change = mine.history[-1]
    item = change.before or change.after
    assert item is not None
    is_new = change.before is None and isinstance(item, Trajectory)
    if not is_new and not _same(_there(theirs, item), change.before):
        raise InputError(f"{_named(item)} changed by another hand meanwhile; look again, then change it")
    return _again(theirs, change)


def _again(plan: Plan, change: Change) -> Plan:
    before, after = change.before, change.after
    if isinstance(after, Landmarks):
        return plan.with_landmarks(after)
    if before is None:
        assert after is not None
        return plan.add(after)
    assert isinstance(before, Trajectory)
    if after is None:
        return plan.remove(before.name)
    if change.action == "edit":
        return plan.edit(before.name, **_values(after))
    return plan.lock(before.name, after.locked)


def _there(plan: Plan, item: Trajectory | Landmarks) -> Trajectory | Landmarks | None:
    if isinstance(item, Landmarks):
        return plan.landmarks
    return next((one for one in plan.trajectories if one.name == item.name), None)


def _named(item: Trajectory | Landmarks) -> str:
    return "AC, PC and midline were" if isinstance(item, Landmarks) else f"trajectory {item.name!r} was"


def _same(one: Trajectory | Landmarks | None, other: Trajectory | Landmarks | None) -> bool:
    if one is None or other is None:
        return one is other
    values = _values(one)
    return all(np.array_equal(values[name], value) for name, value in _values(other).items())


def _values(item: Trajectory | Landmarks) -> dict[str, Any]:
    return {field.name: getattr(item, field.name) for field in fields(item)}
