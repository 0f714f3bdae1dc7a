"""What a plan holds, and one step of its history."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from datetime import datetime
from typing import Any, TypeVar

import numpy as np

from ronnaplan.errors import InputError
from ronnaplan.planning.landmarks import Landmarks
from ronnaplan.planning.rulers import Ruler
from ronnaplan.planning.trajectory import Trajectory

One = TypeVar("One", Trajectory, Ruler)

Item = Trajectory | Landmarks | Ruler
"""What a plan holds, each with a history of its own."""


@dataclass(frozen=True, eq=False)
class Change:
    """One step of a history: the trajectory, landmarks or ruler at ``index`` before and after it (None: absent)."""

    time: datetime
    action: str
    index: int
    before: Item | None
    after: Item | None

    @property
    def reverse(self) -> Change:
        """The change that takes this one back."""
        return replace(self, before=self.after, after=self.before)


def same(one: Item, other: Item) -> bool:
    """Tell whether two items of one kind have the same values."""
    values = values_of(one)
    return all(np.array_equal(values[name], value) for name, value in values_of(other).items())


def unchanged(one: Item | None, other: Item | None) -> bool:
    """Tell whether what a plan holds is what it held: read anew, an item has the same values in another object."""
    return one is other or (one is not None and other is not None and same(one, other))


def values_of(item: Item) -> dict[str, Any]:
    """Return the values of an item by the names of its fields."""
    return {field.name: getattr(item, field.name) for field in fields(item)}


def exchanged(items: Sequence[One], change: Change, kind: type[One]) -> tuple[One, ...]:
    """Return ``items`` with the one at the change's index as it is after it.

    Raises `InputError` where they are not those that were changed, with all their values, as in a plan that was edited
    by hand.
    """
    kept, before, after = list(items), change.before, change.after
    if before is not None:
        assert isinstance(before, kind)
        require_held(change, next(iter(kept[change.index : change.index + 1]), None))
        del kept[change.index]
    if after is not None:
        assert isinstance(after, kind)
        if after.name in {one.name for one in kept}:
            raise not_held(change)
        kept.insert(change.index, after)
    return tuple(kept)


def require_held(change: Change, held: Item | None) -> None:
    """Raise `InputError` unless ``held`` is what was changed."""
    if not unchanged(held, change.before):
        raise not_held(change)


def not_held(change: Change) -> InputError:
    """Return what is said where a plan is not as the change left it."""
    return InputError(
        f"the plan does not hold what its history says ('{change.action}'), as where its file was edited by hand; "
        "make the change anew"
    )
