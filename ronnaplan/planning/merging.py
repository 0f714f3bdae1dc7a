"""One change of a plan, made again to the plan as another hand has left it meanwhile."""

from __future__ import annotations

from dataclasses import replace

from ronnaplan.errors import InputError
from ronnaplan.planning.changes import Change, Item, same, values_of
from ronnaplan.planning.landmarks import Landmarks
from ronnaplan.planning.plan import Plan
from ronnaplan.planning.rulers import Ruler
from ronnaplan.planning.trajectory import Trajectory


def merged(base: Plan, mine: Plan, theirs: Plan) -> Plan:
    """Return ``theirs`` with the change that led from ``base`` to ``mine``, where both hands changed other things.

    Raises `InputError` where the other hand changed the same trajectory, landmarks or measurement, and where ``mine``
    is not one change further than ``base`` (one was taken back, say); `FrameMismatchError` where ``theirs`` is of
    another scan.
    """
    base.identity.require(replace(theirs.identity, name="the plan that another hand wrote"))
    if len(mine.history) != len(base.history) + 1 or mine.history[:-1] != base.history:
        raise InputError(
            "the plan was changed by another hand meanwhile; look at it as it is now, then take back or make again"
        )
    change = mine.history[-1]
    item = change.before or change.after
    assert item is not None
    is_new = change.before is None and not isinstance(item, Landmarks)
    there = _there(theirs, item)
    if not is_new and not (there is change.before or (there and change.before and same(there, change.before))):
        raise InputError(f"{_named(item)} changed by another hand meanwhile; look again, then change it")
    return _again(theirs, change)


def _again(plan: Plan, change: Change) -> Plan:
    before, after = change.before, change.after
    if isinstance(after, Landmarks):
        return plan.with_landmarks(after)
    if isinstance(after, Ruler):
        return plan.add_ruler(after)
    if isinstance(before, Ruler):
        return plan.remove_ruler(before.name)
    if before is None:
        assert after is not None
        return plan.add(after)
    assert isinstance(before, Trajectory)
    if after is None:
        return plan.remove(before.name)
    if change.action == "edit":
        return plan.edit(before.name, **values_of(after))
    return plan.lock(before.name, after.locked)


def _there(plan: Plan, item: Item) -> Item | None:
    if isinstance(item, Landmarks):
        return plan.landmarks
    those: tuple[Trajectory | Ruler, ...] = plan.rulers if isinstance(item, Ruler) else plan.trajectories
    return next((one for one in those if one.name == item.name), None)


def _named(item: Item) -> str:
    if isinstance(item, Landmarks):
        return "AC, PC and midline were"
    return f"{'measurement' if isinstance(item, Ruler) else 'trajectory'} {item.name!r} was"
