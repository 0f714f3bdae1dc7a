"""What was proposed in an open case, entries and places for markers, for as long as it holds."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from ronnaplan.case.edits import OpenCase
from ronnaplan.case.surroundings import Surroundings, others
from ronnaplan.errors import InputError
from ronnaplan.planner.looking import Looking
from ronnaplan.planner.worker import Job, Start
from ronnaplan.planning import Placement, Proposals, Trajectory
from ronnaplan.planning.changes import unchanged
from ronnaplan.planning.sites import PlacementRules


@dataclass(frozen=True, eq=False)
class Proposed:
    """Entries proposed for the trajectory that was ``path`` when they were asked for, among ``others``."""

    path: Trajectory
    others: tuple[Trajectory, ...]
    surroundings: Surroundings
    found: Proposals


@dataclass(frozen=True, eq=False)
class Placed:
    """Places proposed for markers by these ``rules``, for the trajectories that had these ``ends_mm``."""

    ends_mm: tuple[tuple[float, ...], ...]
    rules: PlacementRules
    placement: Placement


@dataclass
class Offered:
    """What was proposed last, for all pages."""

    proposed: Proposed | None = None
    placed: Placed | None = None


class Offers:
    """Proposed entries and proposed places for markers, as one page sees them."""

    def __init__(self, case: OpenCase, look: Looking, start: Start, offered: Offered | None = None) -> None:
        """Nothing is proposed yet, or what other pages see already."""
        self.case, self.look, self.start = case, look, start
        self.offered = offered or Offered()

    def propose(self, name: str) -> None:
        """Score every way to the target of a trajectory, shown until target, instrument or surroundings change."""
        path, around, plan = self.case.plan.trajectory(name), self.case.surroundings, self.case.plan
        work = partial(around.propose, path.target_mm, plan, name=name, instrument=path.instrument)

        def show(found: Proposals) -> None:
            self.offered.proposed = Proposed(path, others(plan, name), around, found)

        self.start(Job(f"scoring the entries for {name}", work, show))

    @property
    def proposals(self) -> Proposals | None:
        """Entries proposed for the selected trajectory, None where there are none or they no longer hold."""
        asked, path = self.offered.proposed, self.look.chosen
        if asked is None or path is None:
            return None
        holds = (
            path.name == asked.path.name
            and path.instrument == asked.path.instrument
            and np.array_equal(path.target_mm, asked.path.target_mm)
            and _unchanged(others(self.case.plan, path.name), asked.others)
            and asked.surroundings is self.case.surroundings
        )
        return asked.found if holds else None

    def take_proposal(self, index: int) -> None:
        """Use a proposed entry for the trajectory it was proposed for."""
        found = self.proposals
        if found is None or not 0 <= index < len(found.best):
            raise InputError("these entries were proposed for another target; propose them again")
        assert self.look.selected is not None
        self.case.edit(self.look.selected, entry_mm=found.best[index].trajectory.entry_mm)

    def propose_markers(self, count: int) -> None:
        """Propose places for ``count`` markers that make the expected error least.

        They hold until a trajectory changes, or the markers' diameter.
        """
        ends, plan, rules = self._ends_mm, self.case.plan, self._rules
        work = partial(self.case.surroundings.place_markers, plan, count, rules)

        def show(placement: Placement) -> None:
            self.offered.placed = Placed(ends, rules, placement)

        self.start(Job(f"finding places for {count} markers", work, show, tells=True))

    @property
    def placement(self) -> Placement | None:
        """Proposed places for markers, None where there are none or they no longer hold."""
        placed = self.offered.placed
        holds = placed is not None and (placed.ends_mm, placed.rules) == (self._ends_mm, self._rules)
        return placed.placement if placed is not None and holds else None

    @property
    def _rules(self) -> PlacementRules:
        known = self.case.fiducials
        return PlacementRules(diameter_mm=known.marker.diameter_mm) if known else PlacementRules()

    @property
    def _ends_mm(self) -> tuple[tuple[float, ...], ...]:
        return tuple((*one.entry_mm, *one.target_mm) for one in self.case.plan.trajectories)


def _unchanged(these: tuple[Trajectory, ...], those: tuple[Trajectory, ...]) -> bool:
    return len(these) == len(those) and all(map(unchanged, these, those))
