"""What scans of known markers add up to: recall, errors, and how honest the stated ones are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from benchmarks.cases import Case, Condition
from benchmarks.ideal import ideal_center
from ronnaplan.ct import CTVolume
from ronnaplan.geometry import FloatArray
from ronnaplan.localization.build import SOLID, Build
from ronnaplan.localization.examine import Examined, distinct, examine, examine_place
from ronnaplan.localization.scanner.scan import Scan, Slant
from ronnaplan.localization.scanwide.logarithm import summed_seen
from ronnaplan.localization.scanwide.moving import moved
from ronnaplan.localization.scanwide.slant import slant_seen
from ronnaplan.localization.scanwide.together import with_usual_errors
from ronnaplan.localization.scanwide.usual import by_the_usual, unlike_turned_down

FOUND_WITHIN_MM = 1.0
CHI2_95 = 7.815
"""95 % quantile of chi-square with three degrees of freedom."""

HEADING = (
    *("condition", "patients", "markers", "missed", "false", "mean um", "goal", "worst um", "goal"),
    *("ideal um", "nees", "in 95 %", "eff.", "moved", "or in"),
)


@dataclass
class Score:
    """What a condition's scans add up to."""

    pull_mm: float = 0.0
    """Centers are taken to be pulled so far, along the axis of the largest stated error, when that is judged."""
    patients: int = 0
    missed: int = 0
    false: int = 0
    errors_mm: list[float] = field(default_factory=list)
    ideal_mm: list[float] = field(default_factory=list)
    """Errors of a plain fit that is told where to look, on the same markers."""
    normalized: list[float] = field(default_factory=list)
    efficiencies: list[float] = field(default_factory=list)
    moved: list[bool] = field(default_factory=list)
    """Whether motion is suspected."""

    @property
    def markers(self) -> int:
        """Markers that should have been found so far."""
        return len(self.errors_mm) + self.missed

    def add(self, cases: Sequence[Case]) -> None:
        """Localize a patient's scans and compare with their truth; a marker cut by an edge may be found or not.

        They are parts of one scan: what its markers say together is taken from all of them.
        """
        self.patients += 1
        parts = markers_of(cases)
        markers = [one for part in parts for one in part]
        told = dict(zip(map(id, markers), moved(Scan(cases[0].volume), markers), strict=True))
        for case, found in zip(cases, parts, strict=True):
            known = np.concatenate([case.truth_mm, case.cut_mm])
            self.false += sum(_nearest(known, one.center_mm) > FOUND_WITHIN_MM for one in found)
            for center_mm in case.truth_mm:
                self._compare(case, center_mm, found, told)

    def _compare(
        self, case: Case, center_mm: FloatArray, found: Sequence[Examined], told: Mapping[int, bool]
    ) -> None:
        own = [one for one in found if np.linalg.norm(one.center_mm - center_mm) <= FOUND_WITHIN_MM]
        if not own:
            self.missed += 1
            return
        error = own[0].center_mm - center_mm
        pulled = error + self.pull_mm * np.linalg.eigh(own[0].covariance_mm2)[1][:, -1]
        self.errors_mm.append(float(np.linalg.norm(error)))
        ideal = ideal_center(case.volume, center_mm, case.diameter_mm)
        self.ideal_mm.append(float(np.linalg.norm(ideal - center_mm)))
        self.normalized.append(float(pulled @ np.linalg.solve(own[0].covariance_mm2, pulled)))
        self.efficiencies.append(float(np.trace(own[0].bound_mm2) / np.trace(own[0].covariance_mm2)))
        self.moved.append(told[id(own[0])])

    def row(self, condition: Condition) -> list[str]:
        """One line of the table."""
        counts = [condition.name, *map(str, (self.patients, self.markers, self.missed, self.false))]
        if not self.errors_mm:
            return [*counts, *["-"] * 10]
        normalized = np.array(self.normalized)
        return [
            *counts,
            f"{1e3 * np.mean(self.errors_mm):.1f}",
            f"{1e3 * condition.mean_mm:.0f}",
            f"{1e3 * np.max(self.errors_mm):.1f}",
            f"{1e3 * condition.worst_mm:.0f}",
            f"{1e3 * np.mean(self.ideal_mm):.1f}",
            f"{normalized.mean() / 3:.2f}",
            f"{np.mean(normalized <= CHI2_95):.0%}",
            f"{np.median(self.efficiencies):.1g}",
            f"{sum(self.moved)}",
            f"{np.mean((normalized <= CHI2_95) | self.moved):.0%}",
        ]


def markers_of(cases: Sequence[Case], build: Build = SOLID) -> list[list[Examined]]:
    """Return what `localize` finds in each part of one scan, its uncertainty as in the whole.

    But for what it takes a whole scan to tell: slices whose tag is far off (`thick`), metal that was cut off before
    the scan was resampled (`cut_before`), and another size of clipped markers (`together.with_doubted_sizes`).
    """
    scans = [Scan.of(case.volume) for case in cases]
    if any(scan.volume is case.volume for scan, case in zip(scans, cases, strict=True)):
        # a part has slices that are not recognized: so has the whole
        scans = [Scan(case.volume) for case in cases]
    seen = [examine(scan, (case.diameter_mm,), build) for case, scan in zip(cases, scans, strict=True)]
    summed = summed_seen(list(zip(scans, seen, strict=True)), build)
    if summed is not None:
        scans = [Scan(scan.volume, summed=summed) for scan in scans]
        if summed.first:
            seen = [examine(scan, (case.diameter_mm,), build) for case, scan in zip(cases, scans, strict=True)]

    def refit(slant: Slant, balls: Sequence[Examined]) -> list[Examined]:
        near = [min(scans, key=lambda scan: _from_middle_mm(scan.volume, one.center_mm)) for one in balls]
        return [
            examine_place(Scan(scan.volume, slant), one.center_mm, one.stated_mm, build)
            for scan, one in zip(near, balls, strict=True)
        ]

    slant = slant_seen(scans[0].axes, [one for part in seen for one in part], refit)
    if slant is not None:
        scans = [Scan(scan.volume, slant) for scan in scans]
        seen = [examine(scan, (case.diameter_mm,), build) for case, scan in zip(cases, scans, strict=True)]
    seen = by_the_usual(list(zip(scans, seen, strict=True)), build)
    parts = [distinct(one for one in part if one.is_marker) for part in seen]
    judged = unlike_turned_down([one for part in parts for one in part])
    stated = iter(with_usual_errors(scans[0], [one for one in judged if one.is_marker]))
    rest = iter(judged)
    return [[next(stated) for _ in part if next(rest).is_marker] for part in parts]


def _from_middle_mm(part: CTVolume, place_mm: FloatArray) -> float:
    middle = (np.array(part.voxels_hu.shape) - 1.0) / 2.0
    return float(np.linalg.norm(part.grid.positions_mm(middle) - place_mm))


def _nearest(truth_mm: FloatArray, center_mm: FloatArray) -> float:
    return float(np.linalg.norm(truth_mm - center_mm, axis=1).min(initial=np.inf))
