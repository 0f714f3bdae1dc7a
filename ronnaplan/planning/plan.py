"""A plan: trajectories in one scan's frame of reference, and every change that led to it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

import numpy as np

from ronnaplan.ct.identity import ScanIdentity
from ronnaplan.ct.volume import WAYS_TO_A_VOLUME, CTVolume, SeriesSource
from ronnaplan.display import Shown, coordinates, head_in_3d
from ronnaplan.errors import InputError, UsageError, check_type
from ronnaplan.geometry import Frame, Points
from ronnaplan.planning.changes import Change, Item, exchanged, require_held, same
from ronnaplan.planning.landmarks import Landmarks
from ronnaplan.planning.rulers import Ruler
from ronnaplan.planning.trajectory import Trajectory, next_colour
from ronnaplan.text import as_read, counted, listed

if TYPE_CHECKING:
    from ronnaplan.figures import Picture


@dataclass(frozen=True, eq=False, repr=False)
class Plan(Shown[Trajectory]):
    """Trajectories of one scan, a sequence of them. Every method returns a new plan; nothing is changed in place.

    ``history`` holds the changes in order; ``undone`` those taken back, the latest last. ``revision`` counts all
    changes ever made, those that take back or make again among them. A trajectory without a colour gets
    that of its place.
    """

    source: SeriesSource
    voxel_sha256: str | None = None
    trajectories: tuple[Trajectory, ...] = ()
    landmarks: Landmarks | None = None
    history: tuple[Change, ...] = ()
    undone: tuple[Change, ...] = ()
    revision: int = 0
    rulers: tuple[Ruler, ...] = ()

    def __post_init__(self) -> None:
        coloured = tuple(_coloured(one, index) for index, one in enumerate(self.trajectories))
        object.__setattr__(self, "trajectories", coloured)

    @classmethod
    def of_scan(cls, volume: CTVolume) -> Plan:
        """Return an empty plan tied to ``volume``."""
        check_type(volume, CTVolume, "the volume", WAYS_TO_A_VOLUME)
        return cls(volume.source, volume.voxel_sha256)

    def _items(self) -> Sequence[Trajectory]:
        return self.trajectories

    def _headline(self) -> str:
        names = ", ".join(one.name for one in self) or "no trajectory"
        return f"{names}; {counted(len(self.history), 'change')}"

    def _columns(self) -> Mapping[str, Sequence[object]]:
        return {
            "name": [one.name for one in self],
            **coordinates("entry_", [one.entry_mm for one in self]),
            **coordinates("target_", [one.target_mm for one in self]),
            "length_mm": [one.length_mm for one in self],
            "instrument": [one.instrument.name for one in self],
            "electrode": [one.electrode.name if one.electrode else "" for one in self],
            "locked": [one.locked for one in self],
            "notes": [one.notes for one in self],
        }

    def plot(self, volume: CTVolume | None = None) -> Picture:
        """Return the trajectories from three sides; given their scan's ``volume``, before its silhouette.

        Then they are shown in its head in 3-D, too, where pyvista is installed.
        """
        from ronnaplan.ct.silhouette import silhouettes
        from ronnaplan.figures import ThreeViews

        if volume is not None:
            self.require_scan(volume)
        views = ThreeViews(self._headline(), head=None if volume is None else head_in_3d(self, volume))
        entries, targets = (
            np.array([getattr(one, end) for one in self], dtype=np.float64).reshape(-1, 3)
            for end in ("entry_mm", "target_mm")
        )
        colours = [one.colour for one in self]
        views.segments(entries, targets, colours)
        views.points(targets, colours=colours)
        views.names(entries, [one.name for one in self], colours, targets)
        if volume is None:
            views.frame(np.concatenate([entries, targets]))
        else:
            views.silhouettes(silhouettes(volume))
        return views.picture

    @property
    def frame(self) -> Frame:
        """The frame all points of the plan are in."""
        return self.source.frame

    @property
    def points(self) -> Points:
        """``<name> entry`` and ``<name> target`` of every trajectory, as exact points."""
        places = [place for one in self.trajectories for place in (one.entry_mm, one.target_mm)]
        labels = tuple(f"{one.name} {end}" for one in self.trajectories for end in ("entry", "target"))
        return Points.exact(places, labels, self.frame)

    @property
    def identity(self) -> ScanIdentity:
        """The scan that the plan was made on."""
        return ScanIdentity("the plan", self.frame, self.source.series_instance_uid, self.voxel_sha256)

    def require_scan(self, volume: CTVolume) -> None:
        """Raise as `ScanIdentity.require` does unless ``volume`` is the plan's scan, or another series of its frame."""
        volume.identity.require(self.identity)

    def require_trajectories(self, wanted: str = "") -> None:
        """Raise `InputError` unless there is a trajectory; what for may be ``wanted``, as in "to check"."""
        if not self.trajectories:
            raise InputError(f"the plan has no trajectory{wanted and f' {wanted}'}; add one first")

    def trajectory(self, name: str) -> Trajectory:
        """Return the trajectory called ``name``; raises `InputError` with the known names."""
        return self.trajectories[self._index(name)]

    def ruler(self, name: str) -> Ruler:
        """Return the measurement called ``name``; raises `InputError` with the known names."""
        for one in self.rulers:
            if one.name == name:
                return one
        raise InputError(f"the plan has no measurement {name!r}; it has {listed(one.name for one in self.rulers)}")

    def add(self, trajectory: Trajectory) -> Plan:
        """Return the plan with one more trajectory; `InputError` for a name in use, else `FrameMismatchError`."""
        check_type(
            trajectory, Trajectory, "what is added", "make it with Trajectory(name, entry_mm, target_mm, frame)"
        )
        self._check_new(trajectory, ())
        return self._changed("add", len(self.trajectories), None, trajectory)

    def edit(self, name: str, /, **changes: Any) -> Plan:
        """Return the plan with fields of a trajectory replaced; a locked one is refused (`InputError`)."""
        index = self._unlocked(name)
        unknown = sorted(changes.keys() - {one.name for one in fields(Trajectory)})
        if unknown:
            known = ", ".join(one.name for one in fields(Trajectory))
            raise UsageError(f"a trajectory has no {unknown[0]}; change one of {known}")
        edited = replace(self.trajectories[index], **changes)
        self._check_new(edited, (name,))
        return self._changed("edit", index, self.trajectories[index], edited)

    def remove(self, name: str) -> Plan:
        """Return the plan without a trajectory; a locked one is refused (`InputError`)."""
        index = self._unlocked(name)
        return self._changed("remove", index, self.trajectories[index], None)

    def lock(self, name: str, locked: bool = True) -> Plan:
        """Return the plan with a trajectory locked against change, or unlocked."""
        index = self._index(name)
        before = self.trajectories[index]
        return self._changed("lock" if locked else "unlock", index, before, replace(before, locked=locked))

    @property
    def acpc(self) -> Landmarks:
        """The landmarks of the AC-PC frame; raises `InputError` where they are not stated."""
        if self.landmarks is None:
            raise InputError("the plan has no AC-PC frame; state AC, PC and a point of the midline first")
        return self.landmarks

    def with_landmarks(self, landmarks: Landmarks) -> Plan:
        """Return the plan with other AC-PC landmarks."""
        return self._changed("landmarks", 0, self.landmarks, landmarks)

    def add_ruler(self, ruler: Ruler) -> Plan:
        """Return the plan with one more measurement; `InputError` for a name in use."""
        if ruler.name in {one.name for one in self.rulers}:
            raise InputError(f"the plan already has a measurement {ruler.name!r}; choose another name")
        return self._changed("measure", len(self.rulers), None, ruler)

    def remove_ruler(self, name: str) -> Plan:
        """Return the plan without a measurement; `InputError` where there is none of that name."""
        removed = self.ruler(name)
        return self._changed("remove measurement", self.rulers.index(removed), removed, None)

    def undo(self) -> Plan:
        """Return the plan before its last change; raises `InputError` when there is none."""
        if not self.history:
            raise InputError("the plan has no change to take back")
        last = self.history[-1]
        return replace(self._with(last.reverse), history=self.history[:-1], undone=(*self.undone, last))

    def redo(self) -> Plan:
        """Return the plan with the change made again that was taken back last; `InputError` when there is none."""
        if not self.undone:
            raise InputError("the plan has no change to make again")
        last = self.undone[-1]
        return replace(self._with(last), history=(*self.history, last), undone=self.undone[:-1])

    def _index(self, name: str) -> int:
        names = [one.name for one in self.trajectories]
        if name not in names:
            raise InputError(f"the plan has no trajectory {name!r}; it has {listed(names)}")
        return names.index(name)

    def _unlocked(self, name: str) -> int:
        index = self._index(name)
        if self.trajectories[index].locked:
            raise InputError(f"trajectory {name!r} is locked; unlock it before changing it")
        return index

    def _check_new(self, trajectory: Trajectory, replaced: tuple[str, ...]) -> None:
        self.frame.require(trajectory.frame)
        if trajectory.name in replaced:
            return
        for used in (one.name for one in self.trajectories if one.name not in replaced):
            if as_read(used) == as_read(trajectory.name):
                raise InputError(f"the plan already has a trajectory {used!r}; choose another name")

    def _changed(
        self,
        action: str,
        index: int,
        before: Item | None,
        after: Item | None,
    ) -> Plan:
        """Return the plan with a change, itself where that changes nothing."""
        if isinstance(after, Trajectory):
            after = _coloured(after, index)
        if before is not None and after is not None and same(before, after):
            return self
        change = Change(datetime.now(UTC), action, index, before, after)
        return replace(self._with(change), history=(*self.history, change), undone=())

    def _with(self, change: Change) -> Plan:
        revision = self.revision + 1
        item = change.before or change.after
        if isinstance(item, Landmarks):
            assert change.after is None or isinstance(change.after, Landmarks)
            require_held(change, self.landmarks)
            return replace(self, landmarks=change.after, revision=revision)
        if isinstance(item, Ruler):
            return replace(self, rulers=exchanged(self.rulers, change, Ruler), revision=revision)
        return replace(self, trajectories=exchanged(self.trajectories, change, Trajectory), revision=revision)


def _coloured(trajectory: Trajectory, index: int) -> Trajectory:
    """Return a trajectory with the colour of the one at ``index``, if it has none."""
    return trajectory if trajectory.colour else replace(trajectory, colour=next_colour(index))
