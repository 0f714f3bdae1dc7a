"""What the planning room says of a trajectory, ready to be shown while it is dragged."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ronnaplan.ct import CTVolume
from ronnaplan.documents.fiducials import FiducialsDocument
from ronnaplan.errors import RonnaplanError
from ronnaplan.geometry import FloatArray
from ronnaplan.planning import Head, Limits, Measures, Plan, Trajectory, Verdict, judge, measure
from ronnaplan.planning.measures import spacings
from ronnaplan.planning.obstacles import Kind, Obstacle, Voxels, markers_on, metal
from ronnaplan.planning.uncertainty import planned_pose_covariance
from ronnaplan.registration.markers import SIGMA_CT_MM
from ronnaplan.tracking.markers import ONE_READING_SD_MM

Labels = Mapping[str, NDArray[np.bool_]]
"""Named masks (K, J, I) of the scan."""


@dataclass(frozen=True, eq=False)
class Judgement:
    """Measures and verdicts of one trajectory; without them, ``problem`` says why."""

    measures: Measures | None = None
    verdicts: tuple[Verdict, ...] = ()
    problem: str = ""

    @property
    def broken(self) -> tuple[Verdict, ...]:
        """The verdicts that do not pass."""
        return tuple(verdict for verdict in self.verdicts if not verdict.passes)


class Surroundings:
    """The head, what to keep away from, and the error that the markers will give: found once, when first needed."""

    def __init__(self, volume: CTVolume, fiducials: FiducialsDocument | None, no_go: Labels) -> None:
        self.volume, self.fiducials, self.no_go = volume, fiducials, no_go
        self._measured: dict[str, tuple[tuple[Any, ...], bool, Measures | RonnaplanError]] = {}

    @cached_property
    def head(self) -> Head:
        """The head in the scan; raises `InputError` where there is none."""
        return Head.of(self.volume)

    @cached_property
    def obstacles(self) -> list[Obstacle]:
        """Metal, no-go regions and markers."""
        found: list[Obstacle] = [metal(self.head)]
        found += [Voxels.of(Kind.NO_GO, name, mask, self.head) for name, mask in self.no_go.items()]
        if self.fiducials is not None and self.fiducials.fiducials:
            points = self.fiducials.points
            found += markers_on(self.head, points.labels, points.positions_mm, self.fiducials.marker.diameter_mm)
        return found

    @cached_property
    def pose_mm2(self) -> FloatArray | None:
        """Covariance (6, 6) of the registration that the markers will give, None where they give none."""
        if self.fiducials is None:
            return None
        points = self.fiducials.points
        sigma_mm = float(np.hypot(SIGMA_CT_MM, ONE_READING_SD_MM))
        try:
            return planned_pose_covariance(points.positions_mm, points.covariances_mm2 + sigma_mm**2 * np.eye(3))
        except RonnaplanError:
            return None

    def judge(self, trajectory: Trajectory, plan: Plan, limits: Limits, *, rough: bool = False) -> Judgement:
        """Measure ``trajectory`` and hold it against ``limits``; ``rough``: as quickly as it can be done."""
        measured = self._kept(trajectory, plan, limits, rough)
        if isinstance(measured, RonnaplanError):
            return Judgement(problem=str(measured))
        measured = replace(measured, spacings=spacings(trajectory, plan.trajectories))
        try:
            return Judgement(measured, judge(measured, limits))
        except RonnaplanError as error:  # a limit on what is not known here
            return Judgement(measured, problem=str(error))

    def _kept(self, trajectory: Trajectory, plan: Plan, limits: Limits, rough: bool) -> Measures | RonnaplanError:
        """Return what does not depend on the other trajectories, measured anew only if something else changed."""
        known = (trajectory, plan.landmarks, limits.tolerance_mm)
        before, roughly, measured = self._measured.get(trajectory.name, ((), True, None))
        if (
            measured is None
            or (roughly and not rough)
            or any(now is not then for now, then in zip(known, before, strict=True))
        ):
            measured = self._measure(trajectory, plan, limits, rough)
            self._measured[trajectory.name] = known, rough, measured
        return measured

    def _measure(
        self, trajectory: Trajectory, plan: Plan, limits: Limits, rough: bool
    ) -> Measures | RonnaplanError:
        try:
            return measure(
                trajectory,
                self.head,
                obstacles=self.obstacles,
                landmarks=plan.landmarks,
                pose_mm2=self.pose_mm2,
                tolerance_mm=limits.tolerance_mm,
                rough=rough,
            )
        except RonnaplanError as error:
            return error
