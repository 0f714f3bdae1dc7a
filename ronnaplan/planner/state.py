"""All that the planner knows and can do, without a browser: the views draw this object and call its methods."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ronnaplan.case.surroundings import Judgement, others
from ronnaplan.documents.fiducials import FiducialsDocument, fiducials_document
from ronnaplan.errors import InputError, UsageError
from ronnaplan.geometry import FloatArray, as_points
from ronnaplan.planner import markers
from ronnaplan.planner.registering import Registering
from ronnaplan.planning import Instrument, Landmarks, Placement, Proposals, Trajectory, place_markers
from ronnaplan.planning.sites import PlacementRules, scalp_sites
from ronnaplan.planning.trajectory import instrument_named

COLOURS = ("#e8a33d", "#4fc3f7", "#81c784", "#f06292", "#ba68c8", "#ffd54f")
"""Given to new trajectories in turn."""

ENDS = ("entry", "target")

LANDMARKS = ("AC", "PC", "midline")


@dataclass(frozen=True, eq=False)
class Proposed:
    """Entries proposed for the trajectory that was ``path`` when they were asked for, among ``others``."""

    path: Trajectory
    others: tuple[Trajectory, ...]
    surroundings: Any
    found: Proposals


@dataclass(frozen=True, eq=False)
class Placed:
    """Places proposed for markers, for the trajectories that had these ``ends_mm``."""

    ends_mm: tuple[tuple[float, ...], ...]
    placement: Placement


class PlannerState(Registering):
    """One opened case, with everything that a person can do to it."""

    def __init__(self, *opened: Any, **options: Any) -> None:
        """Open a case, see `OpenedCase`."""
        super().__init__(*opened, **options)
        self._proposed: Proposed | None = None
        self._placed: Placed | None = None

    # --- markers ---------------------------------------------------------------------------------------------

    def find_markers(self, diameter_mm: float) -> FiducialsDocument:
        """Look for markers of another diameter; changes nothing yet."""
        from ronnaplan.localization import localize

        return fiducials_document(localize(self.volume, diameter_mm=diameter_mm))

    def replace_markers(self, found: FiducialsDocument) -> None:
        """Put other markers in the place of those there were."""
        self._change_fiducials(found)

    def reject_marker(self, label: str) -> None:
        """Turn a marker down."""
        self._change_fiducials(markers.reject(self.found, label))

    def accept_marker(self, index: int) -> None:
        """Take the ``index``-th rejected candidate back, if it was a person who turned it down."""
        self._change_fiducials(markers.accept(self.found, index))

    def rename_marker(self, label: str, new: str) -> None:
        """Give a marker another label."""
        self._change_fiducials(markers.rename(self.found, label, new))

    def jump_to_marker(self, label: str) -> None:
        """Select a marker and put the crosshair at its centre."""
        self.jump(markers.named(self.found, label).center)
        self.pick_marker(label)

    def jump_to_rejected(self, index: int) -> None:
        """Put the crosshair at a rejected candidate."""
        rejected = self.found.rejected
        if not 0 <= index < len(rejected):
            raise UsageError(f"there is no rejected candidate {index}; there are {len(rejected)}")
        self.jump(rejected[index].center)

    # --- trajectories ----------------------------------------------------------------------------------------

    def add_trajectory(self, entry_mm: FloatArray, target_mm: FloatArray, name: str | None = None) -> str:
        """Add a trajectory and select it; returns its name."""
        taken = {one.name for one in self.plan.trajectories}
        free = next(f"T{n}" for n in range(1, len(taken) + 2) if f"T{n}" not in taken)
        colour = COLOURS[len(taken) % len(COLOURS)]
        added = Trajectory(name or free, entry_mm, target_mm, self.plan.frame, colour=colour)
        self._change_plan(self.plan.add(added))
        self.select(added.name)
        return added.name

    def edit(self, name: str, /, **changes: Any) -> None:
        """Change fields of a trajectory in one step that can be undone; a locked one is refused."""
        self._change_plan(self.plan.edit(name, **changes))

    def rename(self, name: str, new: str) -> None:
        """Give a trajectory another name, which must be new and not empty."""
        self.edit(name, name=new.strip())

    def choose_instrument(self, name: str, kind: str) -> None:
        """Give a trajectory an instrument of the catalogue."""
        self.edit(name, instrument=instrument_named(kind))

    def size_instrument(self, name: str, size: str, value_mm: float) -> None:
        """Change the ``diameter`` or ``length`` of a trajectory's instrument, in mm."""
        used = self.plan.trajectory(name).instrument
        sizes = {"diameter": used.diameter_mm, "length": used.length_mm}
        if size not in sizes:
            raise UsageError(f"an instrument has no {size}; it has diameter and length")
        sizes[size] = value_mm
        self.edit(name, instrument=Instrument(used.name, sizes["diameter"], sizes["length"]))

    def begin_drag(self, name: str) -> None:
        """Begin to move a trajectory with the mouse; a locked one is refused."""
        self.plan.edit(name)
        self._before_drag = self.plan

    def drag(self, name: str, end: str, place_mm: FloatArray) -> None:
        """Move one end of a trajectory; the whole drag is one step that can be undone."""
        if end not in ENDS:
            raise UsageError(f"a trajectory has no end {end}; it has entry and target")
        if self._before_drag is None:
            self.begin_drag(name)
        assert self._before_drag is not None
        self.plan = self._before_drag.edit(name, **{f"{end}_mm": place_mm})

    def end_drag(self) -> None:
        """Let go: what was dragged is written."""
        before, self._before_drag = self._before_drag, None
        if before is not None and before is not self.plan:
            self._change_plan(self.plan)

    @property
    def dragging(self) -> bool:
        """Whether an end is being dragged just now."""
        return self._before_drag is not None

    def judge(self, trajectory: Trajectory) -> Judgement:
        """Return measures, verdicts and expected error of a trajectory as it is now, or why there are none.

        While an end is dragged, distances to no-go regions are to their voxels only.
        """
        return self.surroundings.judge(trajectory, self.plan, rough=self.dragging)

    def remove(self, name: str) -> None:
        """Remove a trajectory; a locked one is refused."""
        self._change_plan(self.plan.remove(name))

    def lock(self, name: str, locked: bool) -> None:
        """Lock a trajectory against change, or unlock it."""
        self._change_plan(self.plan.lock(name, locked))

    def undo(self) -> None:
        """Take the last change of plan or markers back; a drag under way is let go first."""
        self.end_drag()
        super().undo()

    # --- AC, PC and midline ----------------------------------------------------------------------------------

    @property
    def landmarks_mm(self) -> dict[str, FloatArray]:
        """The points (3,) of the AC-PC frame that are set, by name."""
        known = self.plan.landmarks
        if known is None:
            return self.points_mm
        return dict(zip(LANDMARKS, (known.ac_mm, known.pc_mm, known.midline_mm), strict=True))

    def set_landmark(self, which: str, place_mm: FloatArray) -> None:
        """Set AC, PC or the midline point (3,); with the third the plan has its frame.

        Raises `InputError` where the three points lie on one line, and changes nothing then.
        """
        if which not in LANDMARKS:
            raise UsageError(f"there is no point {which}; there are {', '.join(LANDMARKS)}")
        place = as_points([list(place_mm)], which)[0]
        points = {**self.landmarks_mm, which: place}
        if len(points) == len(LANDMARKS):
            self._change_plan(self.plan.with_landmarks(Landmarks(*(points[name] for name in LANDMARKS))))
        else:
            self.points_mm = points
        self.save_look()

    def jump_to_landmark(self, which: str) -> None:
        """Put the crosshair at AC, PC or the midline point."""
        if which not in self.landmarks_mm:
            raise UsageError(f"{which} is not set; put the crosshair there and set it")
        self.jump(self.landmarks_mm[which])

    # --- proposals -------------------------------------------------------------------------------------------

    def propose(self, name: str) -> Proposed:
        """Score every way to the target of a trajectory; changes nothing."""
        path, around = self.plan.trajectory(name), self.surroundings
        found = around.propose(path.target_mm, self.plan, name=name, instrument=path.instrument)
        return Proposed(path, others(self.plan, name), around, found)

    def show_proposals(self, proposed: Proposed | None) -> None:
        """Show proposed entries until their target, instrument or surroundings change."""
        self._proposed = proposed

    @property
    def proposals(self) -> Proposals | None:
        """Entries proposed for the selected trajectory, None where there are none or they no longer hold."""
        asked, path = self._proposed, self.chosen
        if asked is None or path is None:
            return None
        holds = (
            path.name == asked.path.name
            and path.instrument == asked.path.instrument
            and np.array_equal(path.target_mm, asked.path.target_mm)
            and others(self.plan, path.name) == asked.others
            and asked.surroundings is self.surroundings
        )
        return asked.found if holds else None

    def take_proposal(self, index: int) -> None:
        """Use a proposed entry for the trajectory it was proposed for."""
        found = self.proposals
        if found is None or not 0 <= index < len(found.best):
            raise InputError("these entries were proposed for another target; propose them again")
        assert self.selected is not None
        self.edit(self.selected, entry_mm=found.best[index].trajectory.entry_mm)

    def propose_markers(self, count: int) -> Placed:
        """Propose places for ``count`` markers that make the expected error at all targets least."""
        paths, ends, rules = self.plan.trajectories, self._ends_mm, self.surroundings.rules
        placement = place_markers(
            scalp_sites(self.surroundings.head),
            [one.target_mm for one in paths],
            count,
            PlacementRules(sigma_ct_mm=rules.sigma_ct_mm, sigma_ots_mm=rules.sigma_ots_mm),
            [one.entry_mm for one in paths],
        )
        return Placed(ends, placement)

    def show_placement(self, placed: Placed | None) -> None:
        """Show proposed places for markers until a trajectory changes."""
        self._placed = placed

    @property
    def placement(self) -> Placement | None:
        """Proposed places for markers, None where there are none or they no longer hold."""
        placed = self._placed
        return placed.placement if placed is not None and placed.ends_mm == self._ends_mm else None

    @property
    def _ends_mm(self) -> tuple[tuple[float, ...], ...]:
        return tuple((*one.entry_mm, *one.target_mm) for one in self.plan.trajectories)
