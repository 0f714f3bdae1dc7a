"""What was measured of one trajectory, and how it was judged."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from ronnaplan.errors import RonnaplanError
from ronnaplan.planning import Landmarks, Measures, Plan, Trajectory, Verdict
from ronnaplan.planning.changes import unchanged


@dataclass(frozen=True, eq=False)
class Judgement:
    """Measures and verdicts of one trajectory; ``problem`` says why they are missing or not whole."""

    measures: Measures | None = None
    verdicts: tuple[Verdict, ...] = ()
    problem: str = ""

    @property
    def broken(self) -> tuple[Verdict, ...]:
        """The verdicts that do not pass."""
        return tuple(verdict for verdict in self.verdicts if not verdict.passes)

    @property
    def doubts(self) -> tuple[str, ...]:
        """Reasons to doubt the measures, one sentence each."""
        return self.measures.doubts if self.measures else ()


UNJUDGED: Final[tuple[tuple[Trajectory, ...] | None, Judgement]] = (None, Judgement())
"""Of what was measured and not held against limits yet."""


@dataclass(eq=False)
class Measured:
    """What was measured last of a trajectory, and of what; and how it was judged at a glance, beside which others."""

    trajectory: Trajectory
    landmarks: Landmarks | None
    rough: bool
    result: Measures | RonnaplanError
    glanced: tuple[tuple[Trajectory, ...] | None, Judgement] = UNJUDGED

    def serves(self, trajectory: Trajectory, plan: Plan, rough: bool) -> bool:
        """Whether it still holds, and is fine enough."""
        fine_enough = rough or not self.rough
        same = unchanged(self.trajectory, trajectory) and unchanged(self.landmarks, plan.landmarks)
        return fine_enough and same
