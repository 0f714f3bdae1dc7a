"""What the trajectories of a case are judged against: head, obstacles, expected error and limits, each found once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ronnaplan.case.expectation import expectation
from ronnaplan.case.judgement import UNJUDGED, Judgement, Measured
from ronnaplan.ct import CTVolume
from ronnaplan.ct.progress import Progress
from ronnaplan.documents.fiducials import FiducialsDocument
from ronnaplan.documents.registration import RegistrationDocument
from ronnaplan.errors import RonnaplanError
from ronnaplan.geometry import FloatArray
from ronnaplan.planning import (
    Head,
    Instrument,
    Limits,
    Measures,
    Placement,
    Plan,
    Proposals,
    Trajectory,
    judge,
    measure,
    place_markers,
    propose,
)
from ronnaplan.planning.angles import RAS_IN_LPS
from ronnaplan.planning.apart import Apart, spacings
from ronnaplan.planning.lengths import ENTRIES
from ronnaplan.planning.obstacles import Kind, Obstacle, Voxels, markers_on, metal
from ronnaplan.planning.sites import PlacementRules, scalp_sites
from ronnaplan.planning.uncertainty import Expectation
from ronnaplan.sigmas import SIGMA_CT_MM, SIGMA_OTS_MM

Labels = Mapping[str, NDArray[np.bool_]]
"""Named masks (K, J, I) of the scan."""


@dataclass(frozen=True, eq=False)
class Rules:
    """What a person states before anything is judged.

    ``sigma_ct_mm`` and ``sigma_ots_mm`` are the markers' errors (per axis) that a plan counts on; rows of
    ``frame_axes`` (3, 3) are right, anterior, superior of the stereotactic frame in LPS.
    """

    limits: Limits = field(default_factory=Limits)
    sigma_ct_mm: float = SIGMA_CT_MM
    sigma_ots_mm: float = SIGMA_OTS_MM
    frame_axes: FloatArray = field(default_factory=lambda: RAS_IN_LPS)


class Terrain:
    """What does not change while a case is open: the head in its scan, metal and no-go regions."""

    def __init__(self, volume: CTVolume, no_go: Labels | None = None) -> None:
        self.volume, self.no_go = volume, no_go or {}

    def __reduce__(self) -> tuple[Any, ...]:
        """Go to another process without what can be found again there."""
        return Terrain, (self.volume, self.no_go)

    @cached_property
    def head(self) -> Head:
        """The head in the scan; raises `InputError` where there is none."""
        return Head.of(self.volume)

    @cached_property
    def obstacles(self) -> tuple[Voxels, ...]:
        """Metal, then the no-go regions."""
        regions = (Voxels.of(Kind.NO_GO, name, mask, self.head) for name, mask in self.no_go.items())
        return (metal(self.head), *regions)


class Surroundings:
    """All that a trajectory is judged against; what takes time is found when first needed, and kept.

    It belongs to one state of the markers and the registration: after a change a new one is made (`with_documents`).
    """

    def __init__(
        self,
        terrain: Terrain,
        rules: Rules,
        fiducials: FiducialsDocument | None = None,
        registration: RegistrationDocument | None = None,
    ) -> None:
        self.terrain, self.rules, self.fiducials, self.registration = terrain, rules, fiducials, registration
        self._measured: dict[str, Measured] = {}
        self._apart = Apart()

    def __reduce__(self) -> tuple[Any, ...]:
        """Go to another process without what can be found again there."""
        return Surroundings, (self.terrain, self.rules, self.fiducials, self.registration)

    def with_documents(
        self, rules: Rules, fiducials: FiducialsDocument | None, registration: RegistrationDocument | None
    ) -> Surroundings:
        """Return the same head with other rules, other markers or another registration.

        Where only limits are others, what was measured is held against them.
        """
        other = Surroundings(self.terrain, rules, fiducials, registration)
        other._apart = self._apart
        if other._measures_as(self):
            kept = self._measured.copy()  # at once, for others may be measured in another thread
            other._measured = {name: replace(one, glanced=UNJUDGED) for name, one in kept.items()}
        return other

    def _measures_as(self, other: Surroundings) -> bool:
        mine, theirs = self.rules, other.rules
        return (
            self.fiducials is other.fiducials
            and self.registration is other.registration
            and (mine.sigma_ct_mm, mine.sigma_ots_mm) == (theirs.sigma_ct_mm, theirs.sigma_ots_mm)
            and mine.limits.tolerance_mm == theirs.limits.tolerance_mm
            and np.array_equal(mine.frame_axes, theirs.frame_axes)
        )

    @property
    def head(self) -> Head:
        """The head in the scan; raises `InputError` where there is none."""
        return self.terrain.head

    @cached_property
    def obstacles(self) -> tuple[Obstacle, ...]:
        """Metal, no-go regions and markers."""
        if self.fiducials is None or not self.fiducials.fiducials:
            return self.terrain.obstacles
        points, diameter_mm = self.fiducials.points, self.fiducials.marker.diameter_mm
        markers = markers_on(self.head, points.labels, points.positions_mm, diameter_mm)
        return (*self.terrain.obstacles, *markers)

    @cached_property
    def expected(self) -> Expectation:
        """What error is to be expected, as registered and as planned."""
        rules = self.rules
        return expectation(self.fiducials, self.registration, rules.sigma_ct_mm, rules.sigma_ots_mm)

    @property
    def doubts(self) -> tuple[str, ...]:
        """Why all that is judged here should be doubted, a sentence each: the scan, the markers, the registration."""
        return (*scan_doubts(self.terrain.volume), *self.expected.remarks)

    def prepare(self) -> None:
        """Find head and obstacles, which takes seconds in a large scan; why there are none is told where they count."""
        with suppress(RonnaplanError):
            _ = self.obstacles

    def judge(self, trajectory: Trajectory, plan: Plan, *, rough: bool = False) -> Judgement:
        """Measure ``trajectory`` and hold it against the limits; ``rough``: as quickly as it can be done."""
        return self._held_against_limits(self._kept(trajectory, plan, rough), plan.trajectories)

    def glance(self, plan: Plan) -> tuple[Judgement | None, ...]:
        """Judge all trajectories of a plan, in its order, each beside those only that come near; None: unmeasured.

        What is broken, nearly broken and doubted is what `judge` finds, which takes and holds a hundred times as much
        of a plan of hundreds.
        """
        near = self._apart.near(plan.trajectories, self.rules.limits.near_trajectory_mm)
        found: list[Judgement | None] = []
        for one, beside in zip(plan.trajectories, near, strict=True):
            found.append(self._glanced(self._kept(one, plan, False), beside) if self.knows(one, plan) else None)
        return tuple(found)

    def _glanced(self, known: Measured, beside: tuple[Trajectory, ...]) -> Judgement:
        last, judged = known.glanced
        if last != beside:
            judged = self._held_against_limits(known, beside)
            known.glanced = beside, judged  # at once, for others may be judged in another thread
        return judged

    def _held_against_limits(self, known: Measured, beside: Sequence[Trajectory]) -> Judgement:
        if isinstance(known.result, RonnaplanError):
            return Judgement(problem=str(known.result))
        measured = replace(known.result, spacings=spacings(known.trajectory, beside))
        try:
            return Judgement(measured, judge(measured, self.rules.limits))
        except RonnaplanError as error:  # a limit on what is not known here
            return Judgement(measured, problem=str(error))

    def measures(self, trajectory: Trajectory, plan: Plan, *, rough: bool = False) -> Measures | None:
        """Return what is measured of ``trajectory`` by itself, None where it cannot be."""
        found = self._kept(trajectory, plan, rough).result
        return None if isinstance(found, RonnaplanError) else found

    def knows(self, trajectory: Trajectory, plan: Plan, *, rough: bool = False) -> bool:
        """Whether to `judge` ``trajectory`` takes no long time, for it was measured as it is now."""
        known = self._measured.get(trajectory.name)
        return known is not None and known.serves(trajectory, plan, rough)

    def judge_all(self, plan: Plan) -> tuple[Judgement, ...]:
        """Judge all trajectories of a plan, in its order; what was measured of each is kept."""
        return tuple(self.judge(one, plan) for one in plan.trajectories)

    def propose(
        self, target_mm: FloatArray, plan: Plan, *, name: str, instrument: Instrument, count: int = ENTRIES
    ) -> Proposals:
        """Propose entries for ``target_mm`` (3,) that keep all limits, beside the plan's others than ``name``."""
        return propose(
            target_mm,
            self.head,
            self.rules.limits,
            name=name,
            instrument=instrument,
            obstacles=self.obstacles,
            others=others(plan, name),
            expected=self.expected,
            landmarks=plan.landmarks,
            frame_axes=self.rules.frame_axes,
            count=count,
        )

    def place_markers(
        self,
        plan: Plan,
        count: int,
        rules: PlacementRules | None = None,
        targets_mm: Sequence[FloatArray] = (),
        progress: Progress = False,
    ) -> Placement:
        """Propose places for ``count`` markers, away from the plan's entries.

        They are for its targets and ``targets_mm``, (3,) each in LPS.
        """
        stated = rules or PlacementRules()
        stated = replace(stated, sigma_ct_mm=self.rules.sigma_ct_mm, sigma_ots_mm=self.rules.sigma_ots_mm)
        targets = [*(one.target_mm for one in plan.trajectories), *targets_mm]
        entries = [one.entry_mm for one in plan.trajectories]
        return place_markers(scalp_sites(self.head), targets, count, stated, entries, progress=progress)

    def _kept(self, trajectory: Trajectory, plan: Plan, rough: bool) -> Measured:
        """Return what does not depend on the other trajectories, measured anew only if something else changed."""
        known = self._measured.get(trajectory.name)
        if known is None or not known.serves(trajectory, plan, rough):
            known = Measured(trajectory, plan.landmarks, rough, self._measure(trajectory, plan, rough))
            self._measured[trajectory.name] = known
        known.trajectory, known.landmarks = trajectory, plan.landmarks  # the same, told by itself the next time
        return known

    def _measure(self, trajectory: Trajectory, plan: Plan, rough: bool) -> Measures | RonnaplanError:
        try:
            return measure(
                trajectory,
                self.head,
                obstacles=self.obstacles,
                landmarks=plan.landmarks,
                expected=self.expected,
                tolerance_mm=self.rules.limits.tolerance_mm,
                frame_axes=self.rules.frame_axes,
                rough=rough,
            )
        except RonnaplanError as error:
            return error


def scan_doubts(volume: CTVolume) -> tuple[str, ...]:
    """Return why a scan should be doubted, a sentence each."""
    return tuple(f"the scan: {flag}" for flag in volume.flags)


def others(plan: Plan, name: str) -> tuple[Trajectory, ...]:
    """Return the trajectories of a plan but for the one called ``name``."""
    return tuple(one for one in plan.trajectories if one.name != name)
