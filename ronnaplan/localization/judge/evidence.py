"""What a candidate is judged by: its fit, and what is usual in the scan."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ronnaplan.ct.volume import CTVolume
from ronnaplan.geometry import FloatArray
from ronnaplan.localization.build import SIZE_TOLERANCE_MM
from ronnaplan.localization.fit.ball_fit import BallFit
from ronnaplan.localization.fit.directions import Verdict
from ronnaplan.localization.judge.crossed import is_beside_metal, untold_mm2
from ronnaplan.localization.judge.edge import Edge
from ronnaplan.localization.judge.held import held_by, what_touches
from ronnaplan.localization.judge.motion import Movement, movement
from ronnaplan.localization.judge.uncertainty import (
    by_panel,
    center_covariance,
    lag_mm,
    lagging_mm2,
    near_faces_mm2,
    pulled_mm2,
    streaked_mm2,
)

RAGGED, ALIKE_MISFIT = 0.03, 1.25
"""Where a scan's balls misfit usually by more than the first share of the contrast, the scan makes them ragged. There,
what is as large as they are, to `SIZE_TOLERANCE_MM` (of ten others of about a marker's size one is, by chance), may
misfit by so many times what is usual."""


@dataclass(frozen=True)
class Usual:
    """What the balls of a scan show in common: it is the scan's and says nothing against one of them."""

    misfit: float = 0.0
    """Their misfit, as a share of the contrast."""
    broadening_mm: float = 0.0
    """By how much their slice profiles are wider than the nominal thickness at most; 0 where too few tell."""
    diameter_mm: float = math.nan
    """The diameter they are fitted with; NaN where too few tell."""


@dataclass(frozen=True)
class Evidence:
    """All that the tests look at."""

    fit: BallFit
    diameter_mm: float
    thickness_mm: float
    gap_mm: float
    """Widest distance between the slices that the ball reaches into."""
    noise_hu: float
    unseen: float
    """Share of the ball's directions for which the scan has no voxels."""
    volume: CTVolume
    usual: Usual = Usual()

    @property
    def own_misfit(self) -> float:
        """The misfit beyond what the scan excuses."""
        return float(np.sqrt(max(self.fit.misfit**2 - self.excused_misfit**2, 0.0)))

    @property
    def excused_misfit(self) -> float:
        """The misfit that is the scan's."""
        return self.usual.misfit * (ALIKE_MISFIT if self.is_alike else 1.0)

    @property
    def is_alike(self) -> bool:
        """Whether it is as large as the balls of a scan that makes them ragged."""
        off_mm = abs(self.fit.diameter_mm - self.usual.diameter_mm)
        return self.usual.misfit > RAGGED and off_mm <= SIZE_TOLERANCE_MM

    @cached_property
    def verdict(self) -> Verdict:
        """What the ball's directions say in this noise."""
        return self.fit.verdict.in_noise(self.noise_hu)

    @cached_property
    def covariance_mm2(self) -> FloatArray:
        """Covariance (3, 3) of the center in LPS."""
        fit, whole = self.fit, self.fit.drawn or self.fit
        touching = what_touches(self.volume, fit)
        touching_whole = touching if whole is fit else what_touches(self.volume, whole)
        axis, is_metal = held_by(touching)
        pull_mm2 = pulled_mm2(fit, axis, is_metal=is_metal or fit.may_be_metal)
        pull_mm2 = pull_mm2 + untold_mm2(self.volume, whole, touching_whole) + near_faces_mm2(fit)
        pull_mm2 = pull_mm2 + lagging_mm2(by_panel(fit.theta), lag_mm(self.volume.grid), fit.neighbourhood.axes)
        if is_beside_metal(self.volume, fit):
            pull_mm2 = pull_mm2 + streaked_mm2(fit)
        return center_covariance(fit, self.movement, pull_mm2, self.excess_mm)

    @cached_property
    def edge(self) -> Edge:
        """Its edge, which tells its movement and its blur; all of it, also where a socket's rim shines into it.

        Of a ball that moved, the directions that are clear of such a rim may see one place alone.
        """
        return Edge(self.fit.drawn or self.fit)

    @cached_property
    def movement(self) -> Movement:
        """How far its edges seem to have moved."""
        return movement(self.edge)

    @property
    def excess_mm(self) -> float:
        """Fitted minus stated diameter; 0 where clipping hides it, so that the stated one was held."""
        return 0.0 if self.fit.is_clipped else self.fit.diameter_mm - self.diameter_mm
