"""What a placement of the robot does not hold for in its case: report and planner tell it alike."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from ronnaplan.planning import Trajectory

if TYPE_CHECKING:
    from ronnaplan.documents.fiducials import FiducialsDocument
    from ronnaplan.documents.placement import PlacementDocument


def placement_doubts(
    found: PlacementDocument, trajectories: Iterable[Trajectory], fiducials: FiducialsDocument | None
) -> list[str]:
    """Return what blocks every place, else what the best one does not cover, a sentence each.

    That is what was not looked at, tasks without a free way, what comes near on the robot itself, and trajectories and
    markers that it does not know as they are.
    """
    if not found.robot_from_ct:
        return [f"no place of the robot serves all: {sentence}" for sentence in found.blocked]
    best = found.robot_from_ct[0]
    told = [f"the robot's place: {note}" for note in found.notes]
    if best.no_way is not None:
        told.append(f"the robot has {best.no_way}")
    told += [f"on the robot, {sentence}" for sentence in best.near]
    changed = [f"trajectory {name}" for name in found.not_known(trajectories)] + [
        f"marker {label}" for label in _found_anew(found, fiducials)
    ]
    return told + [
        f"nothing says that the robot's place serves {what} as it is now; run 'robot place' again"
        for what in changed
    ]


def _found_anew(found: PlacementDocument, fiducials: FiducialsDocument | None) -> list[str]:
    """Return the labels of markers that the placement does not know where they are; none where it serves no markers."""
    if fiducials is None or all(one.kind != "marker" for one in found.robot_from_ct[0].tasks):
        return []
    known = {one.label: one for one in found.markers}
    return [
        one.label
        for one in fiducials.fiducials
        if one.label not in known or not known[one.label].is_at(one.center)
    ]
