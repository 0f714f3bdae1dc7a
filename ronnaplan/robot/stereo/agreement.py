"""How well the model of a sphere explains its outline, sector by sector, and whether that is a sphere's at all."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ronnaplan.geometry import FloatArray
from ronnaplan.robot.stereo.shading import ShadedSphere
from ronnaplan.robot.stereo.shading_compiled import Flags
from ronnaplan.robot.stereo.shading_steps import FLOOR_PX

LARGEST_SD_PX = 0.5
"""Sectors that know their edge worse are left out."""
SMALLEST_COVERAGE = 0.5
"""Share of the outline that must agree with the cone; the rest may be hidden or spoilt by a reflection."""
LARGEST_RMS_PX = 0.3
"""Points that scatter more about their outline are no sphere's."""
LARGEST_OVAL_PX = 0.15
"""Points of a flat disc's outline go in a wave about a cone: more than this, beyond its error, is no sphere's."""
WAVES = (2, 3, 4)
LARGEST_FIRST_WAVE = 4.0
"""Where the light is not in the model, the wave of one period, which moves the center, is larger than those of more,
by up to this factor (squared), as on balls lit from aside whose brightness does not fall off as the cosine."""
SHADOWED = 2.5
"""Where errors are larger than noise by this factor (squared), the light is not in the model: it moves the center more
than it waves the outline, and may end in the sphere's own shadow."""
RIM_EXCESS, MOST_UNSEEN = 8.0, 0.35
"""A part of a ball is believed where errors are larger than noise by less than the first (squared), which is counted,
and where so much of the outline in a row is seen at most by nothing: of half a ball it is more, of cables less."""
QUARTER = 0.26
"""The same of a limb that alone is believed, in a light of each sector's own: that fits a part of the cut of half a
ball, too, of which it left 0.30 of the outline."""


@dataclass(frozen=True, eq=False)
class Judged:
    """How well the model of a sphere explains its outline."""

    kept: Flags
    """Sectors (S) that know their edge."""
    excess: float
    """By so much their errors are larger than the noise alone makes them, squared; at least 1."""


def judge(found: ShadedSphere) -> Judged | None:
    """Return how well a sphere's model explains the outline, or None where this is no sphere's."""
    kept = found.kept & (found.sds_px < LARGEST_SD_PX)
    if kept.sum() < SMALLEST_COVERAGE * len(kept):
        return None
    turn, shifts, sds = found.angles[kept], found.shifts_px[kept], np.hypot(found.sds_px[kept], FLOOR_PX)
    rms_px = float(np.sqrt((shifts**2).mean()))
    waves, covariance = _waves(turn, shifts, sds)
    if rms_px > LARGEST_RMS_PX + 3 * float(np.sqrt((sds**2).mean())):
        return None
    if np.linalg.norm(waves[:2]) > LARGEST_OVAL_PX + 3 * np.sqrt(np.trace(covariance[:2, :2])):
        return None
    scatter = float(((shifts / sds) ** 2).sum()) / (kept.sum() - 3)
    excess = max(scatter, float(waves @ np.linalg.solve(covariance, waves)) / len(waves), 1.0)
    return Judged(kept, excess * min(max(excess / SHADOWED, 1.0), LARGEST_FIRST_WAVE))


def is_clean(told: Judged, most_unseen: float = MOST_UNSEEN) -> bool:
    """Tell whether a part of a ball shows hardly more than noise, all around it but for ``most_unseen`` in a row."""
    return told.excess < RIM_EXCESS and _unseen_in_a_row(told.kept) < most_unseen


def _unseen_in_a_row(kept: Flags) -> float:
    """Return the longest part of an outline in a row, as a share of it, of which no sector (S) is ``kept``."""
    seen = np.flatnonzero(kept)
    return float(np.diff(seen, append=seen[0] + len(kept)).max() - 1) / len(kept)


def _waves(turn: FloatArray, shifts: FloatArray, sds: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return how much ``shifts`` (N) go in waves of two, three and four periods about the axis (6), and the covariance.

    An error of the light shifts the edge slowly along the outline. What of it has one period shifts the center and is
    not seen; it is taken to be as large as those of more. On a part of the outline waves look like each other, so that
    by their covariance only it is told how large they are.
    """
    columns = [wave(k * turn) for k in WAVES for wave in (np.cos, np.sin)]
    design = np.column_stack([np.ones_like(turn), np.cos(turn), np.sin(turn), *columns]) / sds[:, None]
    covariance = np.asarray(np.linalg.inv(design.T @ design), dtype=np.float64)
    return (covariance @ design.T @ (shifts / sds))[3:], covariance[3:, 3:]
